"""Long runs of a model: the recorded step as C; see `fmu_src.pack.compiled_runner`."""

from fmu_src.pack.compiled_runner import CompiledRunner

__all__ = ["CompiledRunner"]
