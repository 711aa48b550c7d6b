"""Long runs of a model: the recorded step as C, compiled with a loop around it.

The same bits as a `Runner`'s, ten times as fast or so, for a second or more of compiling at first;
the library is kept in the build folder, under a name that its sources determine.
"""

import ctypes
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from fmu_src.kit.model import Model
from fmu_src.kit.runner import Runner
from fmu_src.pack.codegen import c_source
from fmu_src.pack.compiler import compile_library

_LOOP = """
#include <math.h>
#define casadi_real double
#include "model.h"
#include "functions.c"
__attribute__((visibility("default")))
void run(int n, const double* p, const double* d, const double* u, const double* r, double* x,
         double* y) {
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


@cache
def _compiled(model: Model) -> Any:
    """Return the function `run` of a model's library."""
    texts = {
        "run.c": _LOOP,
        "functions.c": c_source.functions(model),
        "model.h": c_source.header(model, ""),
    }
    return ctypes.CDLL(str(compile_library(model.name, texts, entry="run.c"))).run


class CompiledRunner(Runner):
    """A `Runner` for long runs of one model.

    Args:
        model: what to run.
        parameters: values other than the declared starts.

    Raises:
        SteadytipError: as a `Runner`; or the compiler is missing or refuses the sources.
    """

    def __init__(self, model: Model, parameters: Mapping[str, Any] | None = None) -> None:
        super().__init__(model, parameters)
        self._run = _compiled(model)

    def _evaluated(self, table: np.ndarray, draws: np.ndarray) -> np.ndarray:
        results = np.empty((len(table), self.model.outputs.size()))
        u, r = np.ascontiguousarray(table), np.ascontiguousarray(draws, dtype=float)
        arrays = (self.p, self.d, u, r, self.x, results)
        self._run(len(table), *(ctypes.c_void_p(array.ctypes.data) for array in arrays))
        return results
