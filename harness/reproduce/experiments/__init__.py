"""Experiments that several items share."""
