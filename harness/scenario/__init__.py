"""Scenario files: read, merged, checked."""
