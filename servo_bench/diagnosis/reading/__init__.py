"""What stands in a recording itself, before any cause is tried.

times      an even clock under stamps that stray, and commands for rows that are missing
hygiene    commands that were lost, wild samples, a coarse encoder's lattice
crossing   when samples begin to see the next command
orders     what repeats with a shaft, in torque and angle, and tones from outside
"""
