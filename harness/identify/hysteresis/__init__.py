"""Hysteresis operators of a piezo stack from voltage and stroke."""
