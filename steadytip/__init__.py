"""Steadytip: the tremor-cancelling handheld instrument as FMUs, and a harness that closes the loop.

    import steadytip as st

    result = st.run("closed_loop", motion="hand.csv", overrides={"seconds": 5.0})
    result.metrics["reduction_in_band"].value
    result.signals("instrument.tip_*")          # (n, 3) [m]

    st.sweep("closed_loop_sweep", runs=100).summary["reduction_in_band"].median
    st.build(["MicronEstimator"])               # FMUs of models, by name
    st.build("lowpass.py")                      # of your own, by file, or the Model itself
    st.validate("anybodys.fmu").good            # an FMU against the checklist

| name | what it is |
| --- | --- |
| `run`, `sweep` | simulate a scenario once, or many times |
| `scenarios`, `load` | names of the scenarios that come along; read and check one |
| `models`, `build` | names of the models that come along; build their FMUs |
| `validate` | check an FMU, anybody's |
| `Result`, `read` | signals and figures of merit of a run; those of an earlier run |
| `SweepResult` | table, summary and failed runs of a sweep |
| `Scenario`, `Metric`, `Validation` | what `load`, `Result.metrics` and `validate` give |
| `SteadytipError` and its kinds | a mistake that its reader can mend, with its place and cure |
| `kit` | what a model is written with |
| `testing` | laws that a model's FMU keeps: `testing.check_model(MODEL)` |

Nothing else is public: `harness`, `fmu_src` and `plants` may change in any release.
"""

from fmu_src import __version__
from fmu_src.errors import SteadytipError
from fmu_src.pack.build import build
from fmu_src.pack.discovery import model_names as models
from harness.common.errors import (
    FaultError,
    PartError,
    ProblemsError,
    RecordError,
    RunError,
    StoppedError,
)
from harness.results.metrics import Metric
from harness.results.result import Result, read
from harness.running import run
from harness.scenario.load import available as scenarios
from harness.scenario.load import load
from harness.scenario.schema import Scenario
from harness.sweep.execution import sweep
from harness.sweep.outcome import SweepResult as SweepResult
from harness.validation.validate import Validation as Validation
from harness.validation.validate import validate
from steadytip import kit, testing

__all__ = [
    "FaultError",
    "Metric",
    "PartError",
    "ProblemsError",
    "RecordError",
    "Result",
    "RunError",
    "Scenario",
    "SteadytipError",
    "StoppedError",
    "SweepResult",
    "Validation",
    "__version__",
    "build",
    "kit",
    "load",
    "models",
    "read",
    "run",
    "scenarios",
    "sweep",
    "testing",
    "validate",
]
