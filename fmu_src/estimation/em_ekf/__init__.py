"""Attitude from an electromagnetic tracker and an inertial unit."""
