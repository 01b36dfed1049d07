"""From recordings to causes: `find_causes(recordings, model) -> Finding`.

unknowns, stepping, seeking     open numbers with their bands, and searches among them
scales                          how large things are on this rig under this excitation
hypotheses, screening           what can be tried on this rig, and how much of it promises what
approaching, rounds, contenders where a steep search starts; one round of fits, and who is first
refining                        whether what a law of friction adds to the plain one is seen
classes, gate                   what nobody can tell apart; when a cause is beyond chance and large
                                enough for a name
readying, accepting, forking    what is known before the first round; who is accepted in each; and
                                where another one might have been
finding                         all stages in order
joint, runoff, late, gap        all causes together, and what only all of a recording tells
coasting, bounces               a light load that goes on in its gap, and its faces
reading_off, as_a_torque        what the load's encoder says wrong by itself, and what would say so
"""
