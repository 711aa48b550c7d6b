"""BROAD's tables and figures."""
