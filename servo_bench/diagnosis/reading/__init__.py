"""What stands in a recording itself, before any cause is tried.

times         an even clock under stamps that stray, and commands for rows that are missing
lost          commands that were lost
hygiene       wild samples, a coarse encoder's lattice
crossing      when samples begin to see the next command
orders        what repeats with the motor's shaft
tone          what shakes the load from outside of the rig
subdivision   what repeats with the lines of the load encoder's disc
resting       rows in which the load rests on a face, and what is regular in its angle there
revolution    what the load's encoder says wrong once or twice in a revolution
creep         what the load's angle gives way to the torque slowly
reading       a cause that is read off the data
"""
