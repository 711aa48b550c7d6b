"""Files of an FMU, native and Python."""
