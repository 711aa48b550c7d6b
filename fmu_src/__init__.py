"""Models of the instrument's algorithms, and the way from a model to an FMU."""

__version__ = "0.1.0"
RELEASED = "2026-11-22T00:00:00Z"
"""Date of this version; stamped into every FMU so that a build repeats to the byte."""
