"""Long runs of a model: the recorded step as C, compiled with a loop around it."""

import ctypes
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from fmu_src.kit import Model, Runner
from fmu_src.pack import csource, native

_LOOP = """
#include <math.h>
#define casadi_real double
#include "model.h"
#include "functions.c"
__attribute__((visibility("default")))
void run(int n, const double* p, const double* d, const double* u,
         const double* r, double* x, double* y) {
    static const double* arg[SZ_ARG + 1];
    static double *res[SZ_RES + 1], w[SZ_W + 1], next[N_X + 1];
    static int iw[SZ_IW + 1];
    for (long k = 0; k < n; ++k) {
        arg[0] = p; arg[1] = d; arg[2] = u + k * N_U; arg[3] = x; arg[4] = r + k * N_R;
        res[0] = next; res[1] = y + k * N_Y;
        MODEL_STEP(arg, res, iw, w, 0);
        for (int i = 0; i < N_X; ++i) x[i] = next[i];
    }
}
"""
_CACHE = Path("build") / "c"


@cache
def _compiled(model: Model) -> Any:
    texts = {
        csource.ENTRY: _LOOP,
        "functions.c": csource.functions(model),
        "model.h": csource.header(model, ""),
    }
    (part,) = native.TARGETS[native.host()]
    content = native.compile_library(model.name, texts, part, _CACHE)
    # The loader needs a file; it may go once it is loaded.
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        path = Path(folder) / f"{model.name}{part.suffix}"
        path.write_bytes(content)
        return ctypes.CDLL(str(path)).run


class CompiledRunner(Runner):
    """A `Runner` that is ten times as fast or more, to the same bits."""

    def __init__(self, model: Model, parameters: Mapping[str, Any] | None = None) -> None:
        super().__init__(model, parameters)
        self._run = _compiled(model)

    def _evaluated(self, table: np.ndarray, draws: np.ndarray) -> np.ndarray:
        results = np.empty((len(table), self.model.outputs.size()))
        inputs = (np.ascontiguousarray(table), np.ascontiguousarray(draws))
        arrays = (self.p, self.d, *inputs, self.x, results)
        self._run(len(table), *(ctypes.c_void_p(array.ctypes.data) for array in arrays))
        return results
