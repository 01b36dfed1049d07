"""A third servo axis, by another hand than `sim_rig` and `tests.truth`, with equations of its own.

What two hands agree on may still be what both took for granted. Here friction is LuGre's, faces
are Hunt and Crossley's, and what `tests.truth` never varies does: encoders of 12 to 20 bits, drives
that tick every 62.5 to 250 us and tell a torque, a current or both, slots that are asked late, and
rigs whose file has a coupling or friction of its own.

    plant.c, plant.py   the axis: equations, and how they are compiled and played
    rigs.py             seven rigs: what their files say, and how they are built
    commands.py         what their operators play
    recorded.py         a run as the bench records it
    hiding.py           what can be hidden, how large, and how a verdict tells it
    asked.py            a trial from a seed: which rig, and what is hidden in it
    told.py             the diagnosis in another process, and what its verdict is worth
    __main__.py         python -m tests.third --seed 0 --count 10 --json OUT.jsonl

It imports numpy, the standard library, and of the product only the values that a bench hands over:
`servo_bench.recording`, `servo_bench.excitation`, `servo_bench.rig`, `servo_bench.errors`. Nothing
of `sim_rig`, of the other hand's `tests.truth` and `tests.trials`, or of the diagnosis
(tests/test_third_plant.py sees to it).
"""
