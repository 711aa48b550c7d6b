"""SSP files of others: read, flattened, converted, or refused by name."""

import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import steadytip
from fmu_src.errors import SteadytipError
from harness.scenario.load import load as load_scenario
from harness.ssp.load import Loaded, load
from harness.system.assembly import assemble
from tests.harness.conftest import PackProbe

SPACES = " ".join(
    f'xmlns:{prefix}="http://ssp-standard.org/SSP1/SystemStructure{name}"'
    for prefix, name in (
        ("ssc", "Common"),
        ("ssd", "Description"),
        ("ssv", "ParameterValues"),
        ("ssm", "ParameterMapping"),
    )
)
HEAD = f'<ssd:SystemStructureDescription {SPACES} version="1.0" name="other tool">'
SSV = (
    '<ssv:ParameterSet version="1.0" name="set"><ssv:Parameters>{}</ssv:Parameters>{}'
    "</ssv:ParameterSet>"
)
UNITS = (
    '<ssd:Units><ssc:Unit name="m"><ssc:BaseUnit m="1"/></ssc:Unit>'
    '<ssc:Unit name="mm"><ssc:BaseUnit m="1" factor="0.001"/></ssc:Unit></ssd:Units>'
)
MS = (
    '<ssv:Units><ssc:Unit name="ms"><ssc:BaseUnit s="1" factor="0.001"/></ssc:Unit>'
    '<ssc:Unit name="kg"><ssc:BaseUnit kg="1"/></ssc:Unit></ssv:Units>'
)


def connectors(*names: str) -> str:
    """Connectors of the probe: `u` and `add` are inputs, the others outputs."""
    rows = "".join(
        f'<ssd:Connector name="{n}" kind="{"input" if n in {"u", "add"} else "output"}"/>'
        for n in names
    )
    return f"<ssd:Connectors>{rows}</ssd:Connectors>"


def values(*parameters: tuple[str, str], units: str = "") -> str:
    rows = "".join(f'<ssv:Parameter name="{n}">{v}</ssv:Parameter>' for n, v in parameters)
    return SSV.format(rows, units)


def binding(content: str, mapping: str = "", attributes: str = "") -> str:
    return (
        f"<ssd:ParameterBindings><ssd:ParameterBinding {attributes}>"
        f"<ssd:ParameterValues>{content}</ssd:ParameterValues>{mapping}"
        "</ssd:ParameterBinding></ssd:ParameterBindings>"
    )


def component(name: str, inside: str = connectors("u", "y"), attributes: str = "") -> str:
    source = "" if "source=" in attributes else 'source="resources/probe.fmu"'
    return f'<ssd:Component name="{name}" {source} {attributes}>{inside}</ssd:Component>'


def connection(start: str, end: str, inside: str = "", attributes: str = "") -> str:
    """`element.connector` to `element.connector`; without an element, the system's own."""
    shown = []
    for side, text in (("start", start), ("end", end)):
        element, _, connector = text.rpartition(".")
        shown.append(f'{side}Element="{element}"' if element else "")
        shown.append(f'{side}Connector="{connector}"')
    return f"<ssd:Connection {' '.join(shown)} {attributes}>{inside}</ssd:Connection>"


def system(
    elements: str, wires: str = "", name: str = "top", rest: str = "", extra: str = ""
) -> str:
    section = f"<ssd:Connections>{wires}</ssd:Connections>" if wires else ""
    return (
        f'<ssd:System name="{name}" {extra}>{rest}<ssd:Elements>{elements}</ssd:Elements>{section}'
        "</ssd:System>"
    )


def document(top: str, after: str = "") -> str:
    return f"{HEAD}{top}{after}</ssd:SystemStructureDescription>"


STEP = ' stepSize="0.001"'
"""What the probe says about its step."""

Archive = Callable[..., Path]
Load = Callable[..., Loaded]


@pytest.fixture
def archive(tmp_path, probe) -> Archive:
    """Writes an SSP archive with the probe's FMU in it."""

    def write(ssd: str | bytes, files: dict[str, bytes | str] | None = None) -> Path:
        path = tmp_path / "other.ssp"
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as target:
            target.writestr("SystemStructure.ssd", ssd)
            target.write(probe, "resources/probe.fmu")
            for name, content in (files or {}).items():
                target.writestr(name, content)
        return path

    return write


@pytest.fixture
def load_ssd(archive: Archive, tmp_path) -> Load:
    def read(ssd: str, files: dict[str, bytes | str] | None = None) -> Loaded:
        return load(archive(ssd, files), tmp_path / "loaded")

    return read


def wires(loaded: Loaded) -> dict[tuple[str, str], int]:
    return {(w.source, w.target): w.delay for w in load_scenario(loaded.scenario).wires}


def start_values(loaded: Loaded, part: str) -> dict[str, object]:
    return dict(assemble(load_scenario(loaded.scenario)).parts[part].start_values)


def test_a_flat_system_runs(load_ssd: Load, tmp_path):
    loaded = load_ssd(
        document(
            system(
                component("a", connectors("u", "y", "count")) + component("b"),
                connection("a.y", "b.u"),
            ),
            UNITS + '<ssd:DefaultExperiment startTime="0" stopTime="1.5"/>',
        )
    )
    assert loaded.scenario.name == "other_tool.toml"
    scenario = load_scenario(loaded.scenario)
    assert scenario.seconds == 1.5
    result = steadytip.run(loaded.scenario, out=tmp_path / "out", report=False)
    assert len(result.time) == round(1.5 / scenario.step_size)
    np.testing.assert_array_equal(result.signals("b.y"), result.signals("a.y"))
    assert sorted(p.name for p in (loaded.scenario.parent / "fmus").iterdir()) == ["probe.fmu"]


def test_what_the_file_does_not_say_is_said(archive: Archive, pack_probe: PackProbe, tmp_path):
    stepless = pack_probe((STEP, "")).read_bytes()
    top = system(component("a", attributes='source="stepless.fmu"'))
    notes = load(archive(document(top), {"stepless.fmu": stepless}), tmp_path / "loaded").notes
    assert notes == (
        "the file does not say when to stop: the run is 10 s long",
        "no FMU states a step: the loop runs every 0.001 s",
    )


def test_the_loop_runs_at_the_longest_step_and_says_what_does_not_fit(
    archive: Archive, pack_probe: PackProbe, tmp_path
):
    files = {
        f"{step}.fmu": pack_probe((STEP, f' stepSize="{step}"')).read_bytes()
        for step in (4e-3, 2e-3, 3e-3)
    }
    top = system("".join(component(f"c{n}", attributes=f'source="{n}"') for n in files))
    path = archive(document(top, '<ssd:DefaultExperiment stopTime="1"/>'), files)
    loaded = load(path, tmp_path / "loaded")
    assert load_scenario(loaded.scenario).step_size == 4e-3
    assert loaded.notes == ("steps of 0.003 s do not fit into the loop's 0.004 s",)
    assert load_scenario(load(path, tmp_path / "again", 1e-3).scenario).step_size == 1e-3


def test_the_end_of_a_connection_does_not_tell_its_direction(load_ssd: Load):
    loaded = load_ssd(document(system(component("a") + component("b"), connection("b.u", "a.y"))))
    assert wires(loaded) == {("a.y", "b.u"): 0}


def test_nested_systems_are_flattened(load_ssd: Load):
    inner = system(
        component("x") + component("y.z"),
        connection("u", "x.u") + connection("x.y", "y.z.u") + connection("y.z.y", "y"),
        name="in",
        rest=connectors("u", "y"),
    )
    middle = system(
        inner,
        connection("u", "in.u") + connection("in.y", "y"),
        name="mid",
        rest=connectors("u", "y"),
    )
    outer = system(
        component("a") + middle + component("b"),
        connection("a.y", "mid.u") + connection("mid.y", "b.u"),
    )
    assert wires(load_ssd(document(outer))) == {
        ("mid_in_x.y", "mid_in_y_z.u"): 0,
        ("a.y", "mid_in_x.u"): 0,
        ("mid_in_y_z.y", "b.u"): 0,
    }


def test_values_of_a_systems_connectors_reach_the_components_behind(load_ssd: Load):
    parameter = '<ssd:Connector name="factor" kind="parameter"/></ssd:Connectors>'
    inner = system(
        component(
            "x", connectors("u").replace("</ssd:Connectors>", parameter.replace("factor", "gain"))
        ),
        connection("u", "x.u") + connection("factor", "x.gain"),
        name="in",
        rest=connectors("u").replace("</ssd:Connectors>", parameter)
        + binding(values(("u", '<ssv:Real value="0.5"/>'), ("factor", '<ssv:Real value="7"/>'))),
    )
    loaded = load_ssd(document(system(inner)))
    assert start_values(loaded, "in_x") == {"u": 0.5, "gain": 7.0, "seed": 0}


def test_inputs_of_the_whole_system_keep_their_start_value(load_ssd: Load):
    top = system(component("a"), connection("u", "a.u"), rest=connectors("u"))
    assert wires(load_ssd(document(top))) == {}


def test_parameters_are_converted_and_the_outer_value_holds(load_ssd: Load):
    a = component(
        "a",
        connectors("u")
        + binding(
            values(
                ("at", '<ssv:Real value="250" unit="ms"/>'),
                ("gain", '<ssv:Real value="2"/>'),
                ("mode", '<ssv:Integer value="0"/>'),
                ("w[2]", '<!-- of three --><ssv:Real value="0.5"/>'),
                units=MS,
            )
        ),
    )
    inner = system(a, name="in", rest=binding(values(("a.gain", '<ssv:Real value="3"/>'))))
    top = system(
        inner, rest=binding(values(("gain", '<ssv:Real value="4"/>')), "", 'prefix="in.a."')
    )
    assert start_values(load_ssd(document(top)), "in_a") == {
        "at": 0.25,
        "gain": 4.0,
        "mode": 0,
        "w[2]": 0.5,
        "seed": 0,
    }


def test_the_seed_stays_the_fmus_own_where_the_file_gives_none(load_ssd: Load):
    assert start_values(load_ssd(document(system(component("a")))), "a") == {"seed": 0}


def test_parameters_in_files_and_under_other_names(load_ssd: Load):
    names = '<ssd:ParameterBinding source="resources/p%20q.ssv"><ssd:ParameterMapping>{}'
    entry = (
        '<ssm:MappingEntry source="amplification" target="gain">'
        '<ssc:LinearTransformation factor="2" offset="-1"/></ssm:MappingEntry>'
    )
    mapping = f'<ssm:ParameterMapping version="1.0">{entry}</ssm:ParameterMapping>'
    bound = (
        f"<ssd:ParameterBindings>{names.format(mapping)}</ssd:ParameterMapping>"
        "</ssd:ParameterBinding></ssd:ParameterBindings>"
    )
    ssv = values(("amplification", '<ssv:Real value="5"/>'), ("mode", '<ssv:Integer value="2"/>'))
    ssv = ssv.replace("<ssv:ParameterSet ", f"<ssv:ParameterSet {SPACES} ", 1)
    loaded = load_ssd(
        document(system(component("a", connectors("u") + bound))), {"resources/p q.ssv": ssv}
    )
    assert start_values(loaded, "a") == {"gain": 9.0, "seed": 0}


def test_a_system_by_reference_in_the_same_file(load_ssd: Load):
    shared = system(
        component("x"),
        connection("u", "x.u") + connection("x.y", "y"),
        name="first",
        rest=connectors("u", "y"),
        extra='id="shared"',
    )
    again = component("second", "", 'type="application/x-ssp-definition" source="#shared"')
    loaded = load_ssd(document(system(shared + again, connection("first.y", "second.u"))))
    assert wires(loaded) == {("first_x.y", "second_x.u"): 0}


def test_a_system_in_another_file_and_in_another_archive(load_ssd: Load, archive: Archive):
    inner = document(system(component("x"), connection("x.y", "y"), rest=connectors("y")))
    package = archive(inner).read_bytes()
    beside = inner.replace("resources/probe.fmu", "probe.fmu")
    top = system(
        component("p", "", 'type="application/x-ssp-package" source="resources/sub.ssp"')
        + component("d", "", 'type="application/x-ssp-definition" source="resources/sub.ssd"')
        + component("sink", connectors("u")),
        connection("p.y", "sink.u"),
    )
    loaded = load_ssd(document(top), {"resources/sub.ssp": package, "resources/sub.ssd": beside})
    assert wires(loaded) == {("p_x.y", "sink.u"): 0}
    assert set(load_scenario(loaded.scenario).parts) == {"p_x", "d_x", "sink"}


def test_a_loop_gets_one_sample_of_delay_where_the_file_goes_back(load_ssd: Load):
    loaded = load_ssd(
        document(
            system(
                component("a") + component("b"),
                connection("a.y", "b.u") + connection("b.y", "a.u"),
            )
        )
    )
    assert wires(loaded) == {("a.y", "b.u"): 0, ("b.y", "a.u"): 1}
    assert "the loop is closed by one sample of delay from 'b' to 'a'" in loaded.notes


TWO = component("a") + component("b")
LINEAR = '<ssc:LinearTransformation factor="2"/>'
TABLE = (
    '<ssd:ParameterMapping><ssm:ParameterMapping version="1.0">'
    '<ssm:MappingEntry source="mode" target="mode"><ssc:IntegerMappingTransformation>'
    '<ssc:MapEntry source="1" target="2"/></ssc:IntegerMappingTransformation></ssm:MappingEntry>'
    "</ssm:ParameterMapping></ssd:ParameterMapping>"
)
AT = '<ssv:Real value="1" unit="kg"/>'
INSIDE = (
    '<ssd:ParameterBindings><ssd:ParameterBinding source="x.ssv" sourceBase="component"/>'
    "</ssd:ParameterBindings>"
)


def typed(declared: str) -> str:
    """A component whose connector `u` has a type."""
    return component("a", connectors("u").replace("/><", f">{declared}</ssd:Connector><"))


REFUSED = {
    r"a\.y -> b\.u changes the value \(2 x \+ 0\)": system(TWO, connection("a.y", "b.u", LINEAR)),
    "'a': there are two elements of this name": system(component("a") * 2),
    r"there is no connector 'c\.u'": system(TWO, connection("a.y", "c.u")),
    "both ends give a value": system(TWO, connection("a.y", "b.y")),
    r"'b\.u' is driven twice": system(TWO, connection("a.y", "b.u") * 2),
    "two connectors of this name": system(component("a", connectors("u", "u"))),
    "would be called 'a_b'": system(component("a_b") + component("a.b")),
    "model exchange": system(component("a", attributes='implementation="ModelExchange"')),
    "type text/x-modelica": system(component("a", attributes='type="text/x-modelica"')),
    "connectors of kind inout are not supported": system(
        TWO.replace('"input"', '"inout"'), connection("a.y", "b.u")
    ),
    "parameters that a component calculates cannot be used": system(
        TWO.replace('"output"', '"calculatedParameter"'), connection("a.y", "b.u")
    ),
    r"'a\.u': its value is changed on the way": system(
        component("a"),
        connection("u", "a.u", LINEAR),
        rest=connectors("u") + binding(values(("u", '<ssv:Real value="1"/>'))),
    ),
    "changes the value by IntegerMappingTransformation": system(
        component("a", binding(values(("mode", '<ssv:Integer value="1"/>')), TABLE))
    ),
    "declared as Integer, the FMU has Real": system(typed("<ssc:Integer/>")),
    "declared in mm, the FMU has m": system(typed('<ssc:Real unit="mm"/>')),
    r"'a\.at' is given in kg, which does not convert to the FMU's s": system(
        component("a", binding(values(("at", AT), units=MS)))
    ),
    "from inside the component": system(component("a", INSIDE)),
    r"'b\.at': neither a component nor the system has this parameter": system(
        component("a"), rest=binding(values(("b.at", '<ssv:Real value="1"/>')))
    ),
    "holds no FMU": '<ssd:System name="top"/>',
}


@pytest.mark.parametrize("said", REFUSED)
def test_what_a_scenario_cannot_express_is_refused_by_name(said, load_ssd: Load, tmp_path):
    with pytest.raises(SteadytipError, match=said):
        load_ssd(document(REFUSED[said], UNITS))
    assert not (tmp_path / "loaded").exists()


def test_a_conversion_of_units_is_refused_by_name(
    archive: Archive, pack_probe: PackProbe, tmp_path
):
    millimetres = pack_probe(
        (
            '<Unit name="m"><BaseUnit m="1"/></Unit>',
            '<Unit name="mm"><BaseUnit m="1" factor="1e-3"/></Unit>',
        ),
        ('<Real unit="m"', '<Real unit="mm"'),
    )
    top = system(
        component("a") + component("b", attributes='source="resources/mm.fmu"'),
        connection("a.y", "b.u"),
    )
    path = archive(document(top), {"resources/mm.fmu": millimetres.read_bytes()})
    with pytest.raises(SteadytipError, match=r"a\.y -> b\.u converts m to mm, which a wire cannot"):
        load(path, tmp_path / "loaded")
    path = archive(
        document(top.replace('endConnector="u"', 'endConnector="u" suppressUnitConversion="true"')),
        {"resources/mm.fmu": millimetres.read_bytes()},
    )
    with pytest.raises(SteadytipError, match=r"units differ \(m, mm\) and are not converted"):
        load(path, tmp_path / "loaded")


def test_an_unknown_parameter_is_told_when_the_scenario_is_run(load_ssd: Load):
    loaded = load_ssd(
        document(system(component("a", binding(values(("gian", '<ssv:Real value="1"/>'))))))
    )
    with pytest.raises(SteadytipError, match="did you mean 'gain'"):
        assemble(load_scenario(loaded.scenario))


ENTITY = '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]>'
SSD_TYPE = 'type="application/x-ssp-definition"'
ONE = document(system(component("a")))


def sourced(source: str, attributes: str = "") -> str:
    return document(system(component("a", attributes=f'source="{source}" {attributes}')))


WRONG = [
    ("<a/>", "not an SSP SystemStructureDescription"),
    ("no xml", "not well-formed XML"),
    (ENTITY + ONE, "document type declaration"),
    (ONE.replace(' version="1.0"', ' version="2.0"'), "of version '2.0'; versions 1.x are read"),
    (ONE.replace(' name="a"', ""), "breaks the SSP schema: line 1"),
    (sourced("../../x.fmu"), "leaves the archive"),
    (sourced("%2e%2e/x.fmu"), "leaves the archive"),
    (sourced("/etc/passwd"), "leaves the archive"),
    (sourced("file:///etc/passwd"), "leaves the archive"),
    (sourced("//host/x.fmu"), "leaves the archive"),
    (sourced("..\\x.fmu"), "leaves the archive"),
    (sourced("%00"), "missing in the archive"),
    (sourced("x" * 5000), "missing in the archive"),
    (sourced("resources/gone.fmu"), "missing in the archive"),
    (sourced("SystemStructure.ssd"), r"other\.ssp: SystemStructure\.ssd is not an FMU"),
    (sourced("SystemStructure.ssd", SSD_TYPE), "hold each other in a circle"),
    (
        document(
            system(component("b", "", f'{SSD_TYPE} source="#loop"'), name="s", extra='id="loop"')
        ),
        "hold each other in a circle",
    ),
]


@pytest.mark.parametrize(("ssd", "said"), WRONG)
def test_wrong_and_hostile_descriptions_are_refused(ssd, said, load_ssd: Load, tmp_path):
    with pytest.raises(SteadytipError, match=said) as error:
        load_ssd(ssd)
    assert "steadytip-" not in str(error.value)  # no name of a workspace that is gone
    assert not (tmp_path / "loaded").exists()


def test_references_that_multiply_are_stopped(load_ssd: Load, monkeypatch):
    monkeypatch.setattr("harness.ssp.flatten._MOST_ELEMENTS", 1000)
    levels = [
        system(
            "".join(
                component(f"c{k}", "", f'type="application/x-ssp-definition" source="#l{n + 1}"')
                for k in range(20)
            ),
            name=f"s{n}",
            extra=f'id="l{n}"',
        )
        for n in range(8)
    ]
    last = system(component("x"), name="last", extra='id="l8"')
    with pytest.raises(SteadytipError, match="more than 1000 elements"):
        load_ssd(document(system("".join(levels) + last)))


def test_deep_nesting_is_stopped(load_ssd: Load):
    nested = component("x")
    for n in range(30):
        nested = system(nested, name=f"s{n}")
    with pytest.raises(SteadytipError, match="deeper than 16 levels"):
        load_ssd(document(system(nested)))


@pytest.mark.parametrize("name", ["../evil.ssv", "/evil.ssv", "resources/../../evil.ssv"])
def test_archives_that_write_elsewhere_are_refused(name, load_ssd: Load, tmp_path):
    with pytest.raises(SteadytipError, match="is not unpacked"):
        load_ssd(document(system(component("a"))), {name: "x"})
    assert not list(tmp_path.rglob("evil*"))


def test_no_archive_no_ssd_no_folder(archive: Archive, tmp_path):
    with pytest.raises(SteadytipError, match="does not exist"):
        load(tmp_path / "gone.ssp", tmp_path / "loaded")
    (tmp_path / "text.ssp").write_text("text")
    with pytest.raises(SteadytipError, match="cannot be unpacked"):
        load(tmp_path / "text.ssp", tmp_path / "loaded")
    with zipfile.ZipFile(tmp_path / "empty.ssp", "w") as empty:
        empty.writestr("readme.txt", "nothing")
    with pytest.raises(SteadytipError, match=r"SystemStructure\.ssd is missing"):
        load(tmp_path / "empty.ssp", tmp_path / "loaded")
    with pytest.raises(SteadytipError, match="is not an empty folder"):
        load(archive(document(system(component("a")))), tmp_path)


def test_a_value_given_twice_or_of_another_type(load_ssd: Load):
    for parameters, said in (
        ([("gain", '<ssv:Real value="1"/>')] * 2, "'gain' is given twice"),
        ([("mode", '<ssv:Enumeration value="fast"/>')], "give the number of the item"),
    ):
        with pytest.raises(SteadytipError, match=said):
            load_ssd(document(system(component("a", binding(values(*parameters))))))


def test_archives_in_an_archive_share_one_budget(load_ssd: Load, archive: Archive, monkeypatch):
    """Each unpacks to less than the limit, all of them to more."""
    package = archive(ONE, {"padding": bytes(2**20)}).read_bytes()
    elements = "".join(
        component(f"c{k}", "", f'type="application/x-ssp-package" source="sub{k}.ssp"')
        for k in range(4)
    )
    monkeypatch.setattr("harness.common.archives.MOST_BYTES", 3 * 2**20)
    with pytest.raises(SteadytipError, match=r"other\.ssp: sub\d\.ssp unpacks to more than"):
        load_ssd(document(system(elements)), {f"sub{k}.ssp": package for k in range(4)})


@settings(max_examples=200)
@given(data=st.data())
def test_damage_gives_a_scenario_or_a_sentence(data, probe, tmp_path_factory):
    """Flipped, lost and doubled bytes in the description or in the archive around it."""
    tmp_path = tmp_path_factory.mktemp("damaged")
    text = document(
        system(
            component(
                "a", connectors("u", "y") + binding(values(("gain", '<ssv:Real value="2"/>')))
            )
            + component("b"),
            connection("a.y", "b.u"),
        ),
        UNITS + '<ssd:DefaultExperiment startTime="0" stopTime="1.5"/>',
    ).encode()
    in_text = data.draw(st.booleans())
    path = tmp_path / "damaged.ssp"

    def damaged(content: bytes) -> bytes:
        start = data.draw(st.integers(0, len(content) - 1))
        stop = data.draw(st.integers(start, min(len(content), start + 40)))
        return content[:start] + data.draw(st.binary(max_size=8)) + content[stop:]

    with zipfile.ZipFile(path, "w") as target:
        target.writestr("SystemStructure.ssd", damaged(text) if in_text else text)
        target.write(probe, "resources/probe.fmu")
    if not in_text:
        path.write_bytes(damaged(path.read_bytes()))
    try:
        loaded = load(path, tmp_path / "loaded")
    except SteadytipError:
        assert not (tmp_path / "loaded").exists()
    else:
        assert load_scenario(loaded.scenario).parts
