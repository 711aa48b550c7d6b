"""Hardware in the loop: the wall clock, boards on a bus, logs of frames and their replay."""
