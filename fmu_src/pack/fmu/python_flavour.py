"""The python flavour: the recorded functions and the one slave, packed by PythonFMU."""

import importlib.util
import inspect
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from fmu_src.errors import SteadytipError
from fmu_src.kit import noise
from fmu_src.kit.model import Model
from fmu_src.pack.fmu import archive
from fmu_src.pack.fmu.description import describe

_NOISE_IMPORT = "from fmu_src.kit.noise import uniforms\n"


def files(model: Model, guid: str) -> dict[str, bytes]:
    """Return every file of the FMU, by its path in it.

    Args:
        model: what to pack.
        guid: makes the script's module name unique: Python keeps one module per name, and two
            FMUs in one process would share the first one loaded.

    Raises:
        SteadytipError: PythonFMU is not installed, or does not build.
    """
    if importlib.util.find_spec("pythonfmu") is None:
        raise SteadytipError(
            "the python flavour needs PythonFMU: pip install 'steadytip[python-fmu]'"
        )
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        script = work / f"{model.name}_{guid[1:9]}.py"
        script.write_text(_script(model.name), encoding="utf-8")
        table = work / "model.json"
        table.write_text(json.dumps(_table(model), indent=1), encoding="utf-8")
        recorded = []
        for name, function in (("step", model.step_function), ("derive", model.derive_function)):
            path = work / f"{name}.casadi"
            function.save(str(path))
            recorded.append(path)
        _build(script, [table, *recorded])
        contents = archive.read(work / f"{model.name}.fmu")
    # PythonFMU's own description has no units, limits or initial unknowns, and a GUID of the hour.
    # Its Python must be there already, hence needsExecutionTool.
    capabilities = {"needsExecutionTool": "true", "canNotUseMemoryManagementFunctions": "true"}
    contents["modelDescription.xml"] = describe(model, guid, capabilities, [])
    return contents


def _build(script: Path, project_files: list[Path]) -> None:
    """Run PythonFMU in a process of its own.

    An FMU loaded into this process puts its copy of the package, which has no binaries, before the
    installed one on the path.
    """
    command = [sys.executable, "-P", "-m", "pythonfmu", "build", "-f", str(script)]
    command += ["-d", str(script.parent), *map(str, project_files)]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode:
        raise SteadytipError(f"PythonFMU could not build {script.name}: {done.stderr.strip()}")


def _script(name: str) -> str:
    from fmu_src.pack.fmu import python_slave as slave

    text = inspect.getsource(slave)
    constants = (
        f"WORD_SHIFT = {noise.WORD_SHIFT}\nUNIFORM_SCALE = {noise.UNIFORM_SCALE!r}\n\n\n"
        + inspect.getsource(noise.uniforms)
    )
    return text.replace(_NOISE_IMPORT, constants).replace("class Slave(", f"class {name}(")


def _table(model: Model) -> dict[str, object]:
    groups = model.variables
    names = [scalar.name for scalar in groups["parameter"]]
    return {
        "sample_period": model.sample_period,
        "draws": model.draws,
        "seed_at": names.index("seed") if model.draws else -1,
        "sizes": dict(zip("pduyx", (len(scalars) for scalars in groups.values()), strict=True)),
        "variables": [
            {
                "name": scalar.name,
                "type": scalar.field.kind,
                "causality": causality,
                "tunable": scalar.field.tunable,
                "start": scalar.start,
                "min": scalar.field.min,
                "max": scalar.field.max,
                "warning": scalar.field.warning,
            }
            for causality, scalars in groups.items()
            for scalar in scalars
        ],
    }
