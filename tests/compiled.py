"""Long runs of a model: the recorded step as C; see `fmu_src.pack.compiled`."""

from fmu_src.pack.compiled import CompiledRunner

__all__ = ["CompiledRunner"]
