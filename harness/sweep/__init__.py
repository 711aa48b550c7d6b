"""Sweeps: many runs of a scenario, over parameters, seeds, recordings and faults."""
