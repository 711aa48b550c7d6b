"""Checks of the running FMU; each is carried out in a process of its own (`__main__`)."""

from harness.validation.probes import (  # noqa: F401 - each registers its checks
    arguments,
    clock,
    crowd,
    memory,
    results,
    states,
    values,
)
