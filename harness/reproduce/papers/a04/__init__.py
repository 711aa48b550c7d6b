"""A04's tables and figures."""
