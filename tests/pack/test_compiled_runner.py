"""Compiled runs are those of the recorded step, to the same bits."""

import numpy as np
import pytest

from fmu_src.kit.runner import Runner
from fmu_src.pack import compiled_runner as compiled
from fmu_src.pack import compiler
from fmu_src.pack.compiled_runner import CompiledRunner
from fmu_src.pack.discovery import load_model

# With noise and without, of elements and of whole matrices, with memory and with none.
MODELS = ("DisplacementSensor", "Hand", "VarForecaster", "Parallel3Dof")


@pytest.mark.parametrize("name", MODELS)
def test_a_run_cut_in_two_equals_the_recorded_steps(name):
    model = load_model(name)
    rng = np.random.default_rng(4)
    inputs = {
        scalar.name: scalar.start + rng.uniform(0.0, 1e-6, 90)
        for scalar in model.variables["input"]
        if scalar.field.kind == "Real"
    }
    found = []
    for kind in (Runner, CompiledRunner):
        runner = kind(model)
        parts = [slice(0, 50), slice(50, 90)]
        rows = [
            runner.run(40 + 10 * (k == 0), {name: u[part] for name, u in inputs.items()})
            for k, part in enumerate(parts)
        ]
        found.append([*(np.concatenate([row[name] for row in rows]) for name in rows[0]), runner.x])
    for expected, got in zip(*found, strict=True):
        np.testing.assert_array_equal(got, expected)


def test_the_library_is_compiled_once_and_found_by_its_sources(tmp_path, monkeypatch):
    original, own_files = compiler._compile, compiler.FOLDER.resolve()
    built = []

    def compile_here(texts, arguments, product):
        built.append(product.partition(".")[0])
        with monkeypatch.context() as patch:
            patch.setattr(compiler, "FOLDER", own_files)
            return original(texts, arguments, product)

    monkeypatch.setattr(compiler, "FOLDER", tmp_path)
    monkeypatch.setattr(compiler, "_compile", compile_here)
    model = load_model("DisplacementSensor")
    for _ in range(2):
        compiled._compiled.__wrapped__(model)
    assert built == ["DisplacementSensor"]
    compiled._compiled.__wrapped__(load_model("Flc"))
    assert built == ["DisplacementSensor", "Flc"]
