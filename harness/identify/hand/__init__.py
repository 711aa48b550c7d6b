"""Parameters of the hand's motion generator from recordings."""
