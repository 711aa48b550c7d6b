"""Documentation of models: the page inside an FMU, its icon, and the table of all models."""
