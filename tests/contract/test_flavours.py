"""Native and Python flavour are the same model, and both are well-formed FMUs."""

import json
import zipfile

import numpy as np
from lxml import etree

from fmu_src.kit.runner import Runner


def test_both_flavours_declare_the_same_variables_and_guid(paths) -> None:
    described = []
    for path in paths.values():
        root = etree.fromstring(zipfile.ZipFile(path).read("modelDescription.xml"))
        root.remove(root.find("CoSimulation"))
        described.append(etree.tostring(root))
    assert described[0] == described[1]


def everything(instance, model) -> np.ndarray:
    """Values of all variables, also of those that the description does not name."""
    kinds = [s.field.kind for group in model.variables.values() for s in group]
    result = np.empty(len(kinds))
    for kind in set(kinds):
        references = [i for i, other in enumerate(kinds) if other == kind]
        result[references] = getattr(instance.fmu, "get" + kind)(references)
    return result


def test_flavours_agree_step_by_step_from_equal_state(model, start, inputs) -> None:
    """The Python slave gets the native state before every step; then both make one."""
    native, python = start("native"), start("python")
    every = 7
    scale = np.zeros(len(native.variables))
    pairs = []
    for k in range(300):
        native.apply(inputs(k))
        if k % every == 0:
            state = {
                "values": [value.hex() for value in everything(native, model).tolist()],
                "times": [(0.0).hex(), native.time.hex()],
                "samples": round(native.time / model.sample_period),
                "mode": "stepping",
                "stale": False,
            }
            blob = json.dumps(state).encode()
            handle = python.fmu.deSerializeFMUstate(blob)
            python.fmu.setFMUState(handle)
            python.fmu.freeFMUState(handle)
            python.time = native.time
            python.apply(inputs(k))
            python.step()
        native.step()
        values = native.values()
        scale = np.maximum(scale, np.abs(values))
        if k % every == 0:
            pairs.append((values, python.values()))
    for values, others in pairs:
        # Relative to a variable's size over the run: a difference of large numbers may be small.
        gap = np.abs(values - others)
        worst = int(np.argmax(gap / np.maximum(scale, 1e-300)))
        assert (gap <= 1e-12 * scale).all(), (native.variables[worst].name, gap[worst])


def test_native_fmu_equals_the_recorded_function(model, start, inputs) -> None:
    """The compiled C gives what CasADi gives, noise included, over a run of its own."""
    instance = start("native")
    table = [inputs(k) for k in range(100)]
    flat = {name: np.array([row[name] for row in table]) for name in table[0]}
    expected = Runner(model).run(100, flat)
    outputs = []
    for row in table:
        instance.apply(row)
        instance.step()
        outputs.append(instance.outputs())
    found = np.array(outputs)
    stacked = np.column_stack([values.T.reshape(-1, 100).T for values in expected.values()])
    scale = np.abs(stacked).max(axis=0)
    assert (np.abs(found - stacked) <= 1e-9 * scale).all()
