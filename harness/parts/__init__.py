"""Parts of a loop: FMUs, recordings, boards on a CAN bus. The loop cannot tell them apart."""
