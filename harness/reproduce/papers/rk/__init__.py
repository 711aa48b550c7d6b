"""RK's tables and figures."""
