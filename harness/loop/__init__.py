"""The loop: ticks in Python or many in one native call, from event to event."""
