"""Kinematics of the manipulator that moves the tip against the handle."""
