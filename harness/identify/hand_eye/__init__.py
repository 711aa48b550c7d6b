"""Rotation and delay between an inertial unit and a tracker's sensor."""
