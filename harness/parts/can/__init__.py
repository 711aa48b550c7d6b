"""Parts that stand for a board on a CAN bus, or for the loop at the board's end."""
