"""What can be identified: one module with a function `command` for each kind."""
