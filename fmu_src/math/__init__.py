"""Rotations, sums, phasors and linear filters that models are written with."""
