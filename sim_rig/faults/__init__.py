"""Faults to order: what goes wrong on a bus, in a node, and in an encoder, on demand.

A fault is one line, `kind name=value ...`; `sim_rig.faults.catalogue` is the table of kinds. They
stand between the nodes and the bus, and reach into a node only where no frame could show the
fault. What is random in them comes from the rig's seed and starts anew with every run, so the
same run sees the same faults.
"""
