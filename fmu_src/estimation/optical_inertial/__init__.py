"""Pose from an optical tracker and an inertial unit, by either filter."""
