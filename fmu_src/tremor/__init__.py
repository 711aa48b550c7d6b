"""Tremor filters: motion of the tip in, its tremor out."""
