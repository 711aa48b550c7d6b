"""The cascade neural tremor filter, trained on recordings."""
