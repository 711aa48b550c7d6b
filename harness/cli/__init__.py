"""The command `steadytip`."""
