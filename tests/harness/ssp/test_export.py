"""Scenarios as SSP files."""

import zipfile
from pathlib import Path

import numpy as np
import pytest
from lxml import etree

import steadytip as st
from fmu_src.errors import SteadytipError
from harness.parts import ssp_markup as markup
from harness.parts.ssv import read_ssv
from harness.scenario.load import load as load_scenario
from harness.ssp.export import export
from harness.ssp.load import load
from harness.system.assembly import assemble
from tests.harness.conftest import WriteScenario

SECONDS = {"seconds": 3.0}
TWO = "[part.a]\nfmu = PROBE\ngain = 2\n[part.b]\nfmu = PROBE\n"
FORTH = '[[wire]]\nfrom = "a.y"\nto = "b.u"\n'
BACK = '[[wire]]\nfrom = "b.y"\nto = "a.u"\ndelay = 1\n'


@pytest.fixture(scope="module")
def exported(tmp_path_factory) -> Path:
    """The shipped loop with two values changed, one of them without a base unit."""
    return export(
        "closed_loop",
        tmp_path_factory.mktemp("ssp") / "loop.ssp",
        SECONDS
        | {
            "part.controller.filter.horizon": 2e-3,
            "part.sensors.accelerometer_noise": 2e-3,
        },
    )


def contents(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_holds_each_fmu_once_and_keeps_to_the_schemas(exported):
    files = contents(exported)
    assert sorted(files) == [
        "SystemStructure.ssd",
        *(
            f"resources/{name}.fmu"
            for name in (
                *("Hand", "InertialSensors", "Instrument"),
                *("MicronEstimator", "PiezoStack", "TremorCanceller"),
            )
        ),
        *(f"resources/{name}.ssv" for name in ("controller", "hand", "sensors")),
    ]
    for name, content in files.items():
        if name.endswith((".ssd", ".ssv")):
            markup.read(content, name[-3:], name)
            assert b"Annotation" not in content


def test_every_port_is_a_connector_with_type_and_unit(exported):
    root = etree.fromstring(contents(exported)["SystemStructure.ssd"])
    units = markup.find_units(root, "ssd")
    system = assemble(load_scenario("closed_loop"))
    components = list(root.iter(markup.tag("ssd", "Component")))
    assert [c.get("name") for c in components] == list(system.wiring.order)
    for component in components:
        part = system.parts[component.get("name")]
        shown = {
            (c.get("kind"), c.get("name")): next(c.iterchildren())
            for c in component.iter(markup.tag("ssd", "Connector"))
        }
        ports = {("input", p.name): p for p in part.inputs}
        ports |= {("output", p.name): p for p in part.outputs}
        assert set(shown) == set(ports)
        for key, port in ports.items():
            assert shown[key].tag == markup.tag("ssc", port.type)
            unit = shown[key].get("unit")
            if port.type == "Real" and unit is None:
                assert port.unit_name == "1"
            elif port.type == "Real":
                assert units[unit].same_as(port.unit)
                assert unit == port.unit_name


def test_every_wire_is_a_connection(exported):
    root = etree.fromstring(contents(exported)["SystemStructure.ssd"])
    keys = ("startElement", "startConnector", "endElement", "endConnector")
    shown = {tuple(c.get(k) for k in keys) for c in root.iter(markup.tag("ssd", "Connection"))}
    links = assemble(load_scenario("closed_loop")).wiring.links
    assert shown == {(*k.source, *k.target) for k in links}


def test_parameter_sets_carry_values_seeds_and_units(exported, tmp_path):
    with zipfile.ZipFile(exported) as archive:
        archive.extractall(tmp_path)
    controller = read_ssv(tmp_path / "resources/controller.ssv")
    assert controller["filter.horizon"].value == 2e-3
    assert controller["filter.horizon"].definition == markup.Unit("s", (0, 0, 1, 0, 0, 0, 0, 0))
    sensors = read_ssv(tmp_path / "resources/sensors.ssv")
    assert sensors["accelerometer_noise"].value == 2e-3
    assert sensors["accelerometer_noise"].unit is None  # m/s2/Hz0.5 has no base unit
    parts = assemble(load_scenario("closed_loop")).parts
    assert sensors["seed"].value == parts["sensors"].start_values["seed"]


def test_equal_scenarios_give_equal_bytes(exported, tmp_path, write_scenario: WriteScenario):
    path = write_scenario(TWO + FORTH)
    first, second = export(path, tmp_path / "1.ssp"), export(path, tmp_path / "2.ssp")
    assert first.read_bytes() == second.read_bytes()


def test_run_of_the_imported_file_equals_the_scenario_to_the_bit(exported, tmp_path):
    loaded = load(exported, tmp_path / "loaded")
    assert loaded.notes == tuple(
        f"the loop is closed by one sample of delay from 'controller' to 'piezo_{i}'"
        for i in (1, 2, 3)
    )
    overrides = {
        "part.controller.filter.horizon": 2e-3,
        "part.sensors.accelerometer_noise": 2e-3,
    }
    own = st.run("closed_loop", overrides=SECONDS | overrides, out=tmp_path / "own", report=False)
    other = st.run(loaded.scenario, out=tmp_path / "other", report=False)
    assert own.units == other.units
    for name in own.table.column_names:
        np.testing.assert_array_equal(own.signals(name), other.signals(name), err_msg=name)


def test_the_description_says_what_a_jacobi_master_changes(exported):
    root = etree.fromstring(contents(exported)["SystemStructure.ssd"])
    text = root.get("description")
    assert "every 1 ms" in text
    assert "communicate every 0.1 ms" in text
    assert "instrument by 1 ms, sensors by 2 ms, estimator by 3 ms, controller by 4 ms" in text


def test_a_recording_is_refused(write_scenario: WriteScenario, recording, tmp_path):
    path = write_scenario(f'[part.a]\nreplay = "{recording.as_posix()}"\n')
    with pytest.raises(SteadytipError, match="part 'a' is no FMU, and SSP holds FMUs only"):
        export(path, tmp_path / "a.ssp")


@pytest.mark.parametrize(
    ("wires", "said"),
    [
        (FORTH + "delay = 1\n", r"a\.y -> b\.u has delay = 1.*would take 0"),
        (FORTH + BACK.replace("1", "2"), r"b\.y -> a\.u has delay = 2.*would take 1"),
    ],
)
def test_delays_that_ssp_cannot_say_are_refused(
    wires, said, write_scenario: WriteScenario, tmp_path
):
    with pytest.raises(SteadytipError, match=said):
        export(write_scenario(TWO + wires), tmp_path / "a.ssp")
    assert not (tmp_path / "a.ssp").exists()


def test_a_loop_closed_by_one_sample_is_exported(write_scenario: WriteScenario, tmp_path):
    loaded = load(
        export(write_scenario(TWO + FORTH + BACK), tmp_path / "a.ssp"), tmp_path / "loaded"
    )
    wires = {(w.source, w.target): w.delay for w in load_scenario(loaded.scenario).wires}
    assert wires == {("a.y", "b.u"): 0, ("b.y", "a.u"): 1}


def test_names_that_are_no_file_names(write_scenario: WriteScenario, tmp_path):
    path = write_scenario('[part."../a b"]\nfmu = PROBE\ngain = 3\n'.replace("..", "&"))
    exported = export(path, tmp_path / "a.ssp")
    assert "resources/_a_b.ssv" in contents(exported)
    loaded = load(exported, tmp_path / "loaded")
    part = assemble(load_scenario(loaded.scenario)).parts["&/a b"]
    assert part.start_values["gain"] == 3.0


def test_a_place_that_cannot_be_written(write_scenario: WriteScenario, tmp_path):
    scenario = write_scenario(TWO)
    (tmp_path / "taken").write_text("")
    with pytest.raises(SteadytipError, match=r"taken.* cannot be written"):
        export(scenario, tmp_path / "taken" / "a.ssp")
