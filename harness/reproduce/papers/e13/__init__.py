"""E13's tables and figures."""
