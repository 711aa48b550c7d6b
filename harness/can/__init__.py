"""Boards on a CAN bus in the place of FMUs: messages, protection, samples, time, transports."""
