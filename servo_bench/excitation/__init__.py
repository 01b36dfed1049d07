"""What is played into the rig: sequences, and the experiment that strings them together."""
