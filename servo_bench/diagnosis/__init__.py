"""What the rig's simulation gets wrong, why, and by how much.

diagnose, concluding   from files to a verdict; beside it the picture, and what is not decided
judging                named, none, or unknown; how sure; what else a verdict tells
searching              rounds of hypotheses that compete, until nothing more is accepted
reading                what stands in a recording itself: its clock, lost commands, lattices, lines
fitting                chosen numbers of a model fitted to a recording
comparing              measured minus simulated, and what a right simulation may miss
design, candidates     the next run
elsewhere              recordings of other benches, whose model is not known

Each imports what stands below it, never what stands above.
"""
