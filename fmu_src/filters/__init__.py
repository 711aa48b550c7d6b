"""Kalman filters on the error of a state that holds rotations, and TRIAD."""
