"""Noise terms of sensors at rest, by their Allan deviation."""
