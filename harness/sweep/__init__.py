"""Sweeps: many runs of a scenario, over parameters, seeds, recordings and faults."""

import sys
from types import ModuleType
from typing import Any, NoReturn


class _Package(ModuleType):
    """The package, which hides the message of `harness.__getattr__` once it is loaded."""

    def __call__(self, *_: Any, **__: Any) -> NoReturn:
        raise TypeError("'harness.sweep' is 'steadytip.sweep' now: import steadytip as st")


sys.modules[__name__].__class__ = _Package
