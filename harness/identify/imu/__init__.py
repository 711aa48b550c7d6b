"""Measurement model of the inertial sensors from rests on a turntable."""
