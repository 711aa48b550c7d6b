"""Operators that describe a piezo stack's hysteresis, and their inverses."""
