"""Estimators of the instrument's pose from its sensors."""
