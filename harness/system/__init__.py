"""From a scenario to parts that are wired and ready to start."""
