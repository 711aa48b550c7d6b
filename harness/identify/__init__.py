"""Parameters of models from recordings."""
