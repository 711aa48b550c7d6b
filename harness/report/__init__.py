"""Pages: the report of a run, and what all pages are made of."""
