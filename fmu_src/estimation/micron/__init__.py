"""Attitude and tip motion from six accelerometers and a magnetometer."""
