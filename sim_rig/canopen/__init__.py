"""The slaves that put the rig on a CAN bus, and the bus hub for machines that have none."""
