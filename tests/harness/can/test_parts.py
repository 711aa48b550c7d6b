"""Parts on a bus, and recorded ones, as the harness sees them."""

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

import steadytip as st
from fmu_src.errors import SteadytipError
from harness.common.errors import FaultError
from harness.hil.board import BUS, board_scenario, world_scenario
from harness.scenario.load import load
from harness.system.assembly import assemble


def links(system) -> set[tuple[str, int]]:
    return {(str(link), link.delay) for link in system.wiring.links}


def test_a_part_on_the_bus_has_the_ports_of_the_fmu_that_it_replaces() -> None:
    """Names, types and units, so that whatever was wired to it can stay."""
    fmu = assemble(load("closed_loop")).parts["sensors"]
    board = assemble(load("closed_loop_can")).parts["sensors"]
    theirs = {port.name: port for port in board.outputs}
    for port in fmu.outputs:
        if port.name == "clipped":
            continue
        other = theirs[port.name]
        assert other.type == port.type
        if port.type == "Real":
            assert port.unit.same_as(other.unit), port.name


def test_the_world_leaves_the_loop_and_the_command_goes_over_the_bus() -> None:
    system = assemble(load("closed_loop_can"))
    assert set(system.parts) == {"sensors", "sensors.command", "estimator", "controller"}
    assert ("controller.volts_2 -> sensors.command.volts_2", 0) in links(system)
    assert ("sensors.volts_a2y -> estimator.volts_a2y", 0) in links(system)
    assert ("sensors.valid -> estimator.inertial_valid", 0) in links(system)
    assert system.wiring.order[-1] == "sensors.command"
    assert set(system.roles) == {"actuator_voltage", "attitude_estimated", "saturated"}


def test_a_wire_to_the_command_itself_is_taken_as_it_is(tmp_path) -> None:
    path = tmp_path / "crossed.toml"
    wires = "".join(
        f'[[wire]]\nfrom = "controller.volts_{i}"\nto = "sensors.command.volts_{4 - i}"\n'
        for i in (1, 2, 3)
    )
    path.write_text(f'extends = "closed_loop_can"\n{wires}')
    found = links(assemble(load(path)))
    assert ("controller.volts_1 -> sensors.command.volts_3", 0) in found
    assert ("controller.volts_1 -> sensors.command.volts_1", 0) not in found


def test_a_mistyped_wire_is_still_a_mistake(tmp_path) -> None:
    path = tmp_path / "typo.toml"
    path.write_text(
        'extends = "closed_loop_can"\n[[wire]]\nfrom = "estimator.vlid"\nto = "controller.hold"\n'
    )
    with pytest.raises(SteadytipError, match="did you mean 'valid'"):
        assemble(load(path))


def test_the_sensors_alone_can_be_on_the_bus() -> None:
    """One changed part: everything else stays, and nothing is sent to stacks that are FMUs."""
    scenario = load(
        "closed_loop",
        {"part.sensors.can": "instrument", "part.sensors.interface": "virtual"},
    )
    system = assemble(scenario)
    assert set(system.parts) == {*load("closed_loop").parts, "sensors.command"}
    assert not [target for target, _ in links(system) if "sensors.command" in target]
    assert ("controller.volts_1 -> piezo_1.volts", 1) in links(system)
    assert any("instrument.force*" in note for note in system.notes)


def test_the_board_sees_the_same_scenario_from_the_other_end() -> None:
    system = assemble(board_scenario(load("closed_loop_can"), None, "nowhere"))
    assert {"hand", "instrument", "sensors", "piezo_1", BUS, f"{BUS}.samples"} <= set(system.parts)
    assert not {"estimator", "controller"} & set(system.parts)
    assert (f"{BUS}.volts_3 -> piezo_3.volts", 0) in links(system)
    assert (f"sensors.volts_mx -> {BUS}.samples.volts_mx", 0) in links(system)
    # No wire of the scenario brings the temperature; the message has it, and the sensors give it.
    assert (f"sensors.temperature -> {BUS}.samples.temperature", 0) in links(system)
    order = system.wiring.order
    assert order.index(BUS) < order.index("piezo_1") < order.index(f"{BUS}.samples")


def test_the_world_with_the_commands_of_a_run_is_where_the_tip_was(tmp_path) -> None:
    """What is computed for a board that keeps no world of its own."""
    overrides = {"seconds": 1.0, "warm_up": 0.0}
    run = st.run("closed_loop", overrides=overrides, out=tmp_path / "run", report=False)
    names = [f"controller.volts_{i}" for i in (1, 2, 3)]
    acts = [np.concatenate([[run.signals(n)[0]], run.signals(n)[:-1]]) for n in names]
    fields = [pa.field("time", pa.float64(), metadata={"unit": "s"})]
    fields += [
        pa.field(f"{BUS}.volts_{i}", pa.float64(), metadata={"unit": "V"}) for i in (1, 2, 3)
    ]
    table = pa.table([run.time, *acts], schema=pa.schema(fields))
    parquet.write_table(table, tmp_path / "command.parquet")
    from harness.running import perform

    scenario = load("closed_loop_can", overrides)
    world = assemble(world_scenario(scenario, tmp_path / "command.parquet"))
    result = perform(world, tmp_path / "world", report=False)
    np.testing.assert_array_equal(
        result.signals("instrument.tip_*"), run.signals("instrument.tip_*")
    )


def test_a_scenario_that_does_not_say_what_the_board_stands_for(tmp_path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(
        "seconds = 1.0\nstep_size = 1e-3\n"
        '[part.sensors]\ncan = "instrument"\ninterface = "unixbus"\n'
    )
    with pytest.raises(SteadytipError, match=r"part\.sensors\.stands_for"):
        board_scenario(load(path), None, None)


@pytest.fixture
def recorded(write_scenario, tmp_path):
    """A run, and a scenario that plays a part of it."""
    text = "[part.a]\nfmu = PROBE\n"
    run = st.run(
        write_scenario(text, head="seconds = 0.05\nstep_size = 1e-3\n"), out=tmp_path / "r"
    )

    def play(extra: str = "", step: str = "1e-3"):
        more = f'[part.b]\nrecorded = "{run.file.as_posix()}"\n{extra}'
        head = f"seconds = 9.0\nstep_size = {step}\n"
        return run, write_scenario(more, name="play.toml", head=head)

    return play


def test_a_recorded_part_gives_what_was_recorded_to_the_bit(recorded, tmp_path) -> None:
    run, scenario = recorded('of = "a"\n')
    again = st.run(scenario, out=tmp_path / "again", report=False)
    assert len(again.time) == len(run.time)
    for name in run.table.column_names[1:]:
        other = name.replace("a.", "b.", 1)
        np.testing.assert_array_equal(again.signals(other), run.signals(name))
        assert again.units[other] == run.units[name]


def test_a_recorded_part_that_is_not_there(recorded) -> None:
    _, scenario = recorded('of = "c"\n')
    with pytest.raises(SteadytipError, match="no signals of 'c'"):
        assemble(load(scenario))


def test_another_step_is_refused(recorded, tmp_path) -> None:
    _, scenario = recorded('of = "a"\n', step="2e-3")
    with pytest.raises((FaultError, SteadytipError), match="another step"):
        st.run(scenario, out=tmp_path / "x", report=False)


def test_a_setting_that_there_is_not(recorded) -> None:
    _, scenario = recorded('off = "a"\n')
    with pytest.raises(SteadytipError, match="'off'"):
        assemble(load(scenario))
