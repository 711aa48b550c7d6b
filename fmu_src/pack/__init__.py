"""Model to FMU: description, C code, FMI 2.0 shell in C, compiler, Python slave, archive."""

from fmu_src.pack.build import build
from fmu_src.pack.discovery import load_model, model_names

__all__ = ["build", "load_model", "model_names"]
