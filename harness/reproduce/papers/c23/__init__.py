"""C23's tables and figures."""
