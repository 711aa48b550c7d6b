"""Fused parts give the numbers of separate ones, bit for bit, and say when they cannot be fused."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from typer.testing import CliRunner

import steadytip as st
from fmu_src.errors import SteadytipError
from harness.cli.main import app, main
from harness.parts.fmu import FmuPart
from harness.scenario import load as scenario
from harness.system import container as fused
from harness.system.assembly import assemble
from harness.validation.validate import validate

pytestmark = pytest.mark.xdist_group("fused")  # its tests share what takes long

SHORT = {"seconds": 1.5, "warm_up": 0.0}
STACKS = ["piezo_1", "piezo_2", "piezo_3", "instrument"]


def recorded(table, but: tuple[str, ...] = ()) -> dict[str, np.ndarray]:
    return {
        name: table.column(name).to_numpy(zero_copy_only=False)
        for name in table.column_names
        if not name.startswith(but)
    }


def assert_same(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> None:
    assert sorted(one) == sorted(other)
    for name, values in one.items():
        np.testing.assert_array_equal(values, other[name], err_msg=name)


@pytest.fixture(scope="module")
def unfused(tmp_path_factory):
    return st.run(
        "closed_loop", overrides=SHORT, out=tmp_path_factory.mktemp("unfused"), report=False
    )


@pytest.fixture(scope="module")
def block(tmp_path_factory) -> Path:
    """Stacks and instrument in one FMU: ten samples of the stacks in a tick, volts a tick late."""
    system = assemble(scenario.load("closed_loop"))
    return fused.build(system, STACKS, "Block", tmp_path_factory.mktemp("block"))


def test_the_whole_loop_fused_is_the_loop_bit_for_bit(unfused, tmp_path) -> None:
    whole = st.run("closed_loop", overrides=SHORT, out=tmp_path, report=False, fuse=True)
    assert_same(recorded(whole.table), recorded(unfused.table))
    assert whole.units == {name: unfused.units[name] for name in whole.units}
    for name, metric in unfused.metrics.items():
        if name != "real_time_factor":
            assert whole.metrics[name] == metric
    assert whole.metadata.fused
    assert whole.metadata.parts == unfused.metadata.parts


def test_values_of_the_scenario_reach_the_members(tmp_path) -> None:
    changed = SHORT | {
        "seed": 7,
        "part.sensors.accelerometer_noise": 5e-3,
        "part.controller.filter.horizon": 3e-3,
    }
    runs = [
        st.run("closed_loop", overrides=changed, out=tmp_path / str(fuse), report=False,
                    fuse=fuse)
        for fuse in (False, True)
    ]  # fmt: skip
    assert_same(*(recorded(run.table) for run in runs))


def test_a_recording_stays_beside_the_container(tmp_path) -> None:
    t = np.arange(0, 3, 4e-3)
    motion = tmp_path / "hand.csv"
    rows = np.column_stack([t, *(5e-5 * np.sin(2 * np.pi * f * t) for f in (9.0, 10.0, 11.0))])
    header = "time [s], x [m], y [m], z [m]"
    np.savetxt(motion, rows, delimiter=",", header=header, comments="")
    runs = [
        st.run("closed_loop", motion=motion, overrides=SHORT, out=tmp_path / str(fuse),
                    report=False, fuse=fuse)
        for fuse in (False, True)
    ]  # fmt: skip
    assert_same(*(recorded(run.table) for run in runs))


def test_a_container_takes_the_place_of_its_parts(unfused, block, tmp_path) -> None:
    """As in another tool: one block, wired by its flat ports."""
    loaded = scenario.load("closed_loop")
    system = assemble(loaded)
    parts = {n: t.settings.table for n, t in loaded.parts.items() if n not in STACKS}
    parts["block"] = {"fmu": str(block)}

    def port(part: str, name: str) -> str:
        return f"block.{part}_{name}" if part in STACKS else f"{part}.{name}"

    wires = [
        {
            "from": port(*link.source),
            "to": port(*link.target),
            "delay": link.delay,
        }
        for link in system.wiring.links
        if not {link.source.part, link.target.part} <= set(STACKS)
    ]
    table = {"seconds": SHORT["seconds"], "step_size": loaded.step_size, "seed": loaded.seed}
    file = tmp_path / "blocks.toml"
    file.write_text(tomli_w.dumps(table | {"part": parts, "wire": wires}))
    run = st.run(file, out=tmp_path / "out", report=False)
    inside = tuple(f"{part}." for part in STACKS)
    assert_same(recorded(run.table, ("block.",)), recorded(unfused.table, inside))
    for name in ("piezo_2.stroke", "instrument.tip_x"):
        held = run.table.column(f"block.{name.replace('.', '_')}").to_numpy()
        np.testing.assert_array_equal(held, unfused.table.column(name).to_numpy())


@pytest.mark.slow
def test_a_container_stands_in_a_hostile_host(block) -> None:
    assert validate(block, timeout=120.0).good


@pytest.mark.usefixtures("nothing_kept")
def test_a_container_is_built_once(block) -> None:
    said = []
    system = assemble(scenario.load("closed_loop"))
    assert fused.build(system, STACKS, "Block", block.parent, progress=said.append) == block
    assert said == []
    other = scenario.load("closed_loop", {"part.piezo_1.gain_error": 0.1})
    fused.build(assemble(other), STACKS, "Block", block.parent / "other", progress=said.append)
    assert said == ["Block"]


def test_start_values_are_those_of_the_scenario(block) -> None:
    from harness.parts.description import describe

    changed = scenario.load("closed_loop", {"part.piezo_2.slip_threshold[3]": 17.0})
    path = fused.build(assemble(changed), STACKS, "Changed", block.parent)
    starts = {name: v.start for name, v in describe(path).variables.items()}
    assert starts["piezo_2.slip_threshold[3]"] == 17.0
    assert starts["piezo_1.slip_threshold[3]"] == 15.0


def test_what_cannot_be_fused_is_refused_by_name(tmp_path) -> None:
    system = assemble(scenario.load("closed_loop"))
    with pytest.raises(SteadytipError, match="no part 'estimtor'; did you mean 'estimator'"):
        fused.build(system, ["estimtor"])
    with pytest.raises(SteadytipError, match="'estimator' stands between its parts"):
        fused.build(system, ["sensors", "controller"])
    built = FmuPart.prepare({"hand": {"fmu": "Hand"}}, lambda _: None)
    elsewhere = tmp_path / "Elsewhere.fmu"
    shutil.copy(built["hand"]["fmu"], elsewhere)
    changed = {"part.hand.fmu": str(elsewhere), "part.sensors.isolate": True}
    system = assemble(scenario.load("closed_loop", changed))
    with pytest.raises(SteadytipError) as refused:
        fused.build(system)
    assert "part 'hand' cannot be fused: its FMU is a file" in str(refused.value)
    assert "part 'sensors' cannot be fused: it is isolated" in str(refused.value)


@pytest.mark.slow
def test_what_cannot_be_fused_stays_outside(unfused, tmp_path) -> None:
    changed = SHORT | {"part.hand.isolate": True}
    run = st.run("closed_loop", overrides=changed, out=tmp_path, report=False, fuse=True)
    assert_same(recorded(run.table), recorded(unfused.table))


def test_nothing_to_fuse_is_said(tmp_path) -> None:
    isolated = {f"part.{name}.isolate": True for name in scenario.load("closed_loop").parts}
    with pytest.raises(SteadytipError, match="nothing of closed_loop can be fused: 'hand': it is"):
        st.run("closed_loop", overrides=isolated, out=tmp_path, fuse=True)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--parts", "hand"], "--parts, --name and --set are for a container"),
        (["Hand", "--container", "closed_loop"], "leave models and --flavour out"),
        (["--container", "closed_loop", "--flavour", "python"], "leave models and --flavour out"),
        (["--container", "closed_loop", "--name", "1st"], "'1st' must be a C identifier"),
    ],
)
def test_mistakes_on_the_command_line(arguments, words, monkeypatch, capsys) -> None:
    monkeypatch.setattr("sys.argv", ["steadytip", "build", *arguments])
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code == 2
    assert words in capsys.readouterr().err


def test_the_command_builds_a_container(tmp_path) -> None:
    done = CliRunner().invoke(
        app,
        ["build", "--container", "closed_loop", "--parts", "piezo_1", "--out", str(tmp_path)],
    )
    assert done.exit_code == 0
    assert (tmp_path / "closed_loop_piezo_1.fmu").is_file()
