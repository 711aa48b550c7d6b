"""`steadytip validate` on FMUs that are right, and on FMUs that are wrong in known ways."""

import json
import re
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest

from fmu_src import pack
from fmu_src.errors import SteadytipError
from harness.cli.main import app
from harness.parts.description import platform_folders
from harness.validation.checks import FILES, ITEMS, PROBES
from harness.validation.reports import write_json, write_junit
from harness.validation.validate import Validation, validate
from tests.harness.conftest import HERE, PackProbe, compile_probe

QUICK = 4.0  # s that a hanging probe is waited for


@pytest.fixture(scope="session")
def pack_defect(pack_probe: PackProbe) -> Callable[..., Path]:
    """Compiles the probe FMU with a defect."""

    def defective(*macros: str) -> Path:
        return pack_probe(binary=compile_probe(*macros).read_bytes())

    return defective


@pytest.fixture(scope="session")
def verdict_on_probe(probe: Path) -> Validation:
    """All checks of the probe that is right."""
    return validate(probe)


def test_an_fmu_that_is_right_has_no_error(verdict_on_probe):
    assert verdict_on_probe.good, [o for o in verdict_on_probe.outcomes if o.verdict == "error"]
    assert verdict_on_probe.counts["ok"] > 90
    # Documents and other platforms it does not have; a sampled model would not drift in count.
    warned = {o.item for o in verdict_on_probe.outcomes if o.verdict == "warning"}
    assert warned <= {"A3", "A4", "C13"}
    assert [o.id for o in verdict_on_probe.outcomes if o.id not in FILES | PROBES] == []
    assert {o.item for o in verdict_on_probe.outcomes} == set(ITEMS)


@pytest.mark.parametrize(
    ("defect", "check", "level", "text"),
    [
        ("ACCEPTS_ANY_GUID", "D1.guid_wrong", "error", "accepts a wrong GUID"),
        ("ACCEPTS_ANY_GUID", "D1.guid_null", "error", "accepts NULL as GUID"),
        ("CRASHES_ON_NULL_NAME", "D1.name_null", "error", "crashes: .* in fmi2Instantiate"),
        ("CRASHES_WITHOUT_LOGGER", "D1.logger_null", "error", "crashes"),
        ("KEEPS_POINTERS", "D2.copies", "error", "crashes|componentEnvironment|instance name"),
        ("USES_TEXT_AS_FORMAT", "D4.format", "error", "crashes"),
        ("INVENTS_A_CATEGORY", "D4.categories", "warning", "category 'chatter'"),
        ("REFUSES_LEGAL_CALLS", "D5.legal", "error", "fmi2Terminate returned Error"),
        (
            "NO_STATE_MACHINE",
            "D5.illegal",
            "warning",
            "fmi2SetupExperiment when step mode returned OK",
        ),
        ("SETS_HALF", "D6.atomic", "warning", "yet 'u' in the same call went from"),
        ("SETS_OUTPUTS", "D6.computed", "warning", "output 'y' can be set"),
        ("PASSES_NAN", "D7.nan", "warning", "'u' = nan goes through to the outputs y"),
        ("PASSES_NAN", "D7.range", "warning", "'gain' = -10.00001.* is accepted"),
        ("SETS_FIXED", "D10.fixed", "error", "fixed parameter 'gain'"),
        ("ANOTHER_START", "C10.starts", "error", "'gain' starts at 1.0 in the XML, at 2.0"),
        ("HANGS_ON_NAN_STEP", "D8.step_nan", "error", "hangs: .* in fmi2DoStep with a step of nan"),
        ("ACCEPTS_ANY_TIME", "D8.wrong_time", "warning", r"\(NaN\) is taken"),
        ("STEPS_PAST_STOP", "D8.stop", "error", "past the stop time"),
        ("ONLY_FROM_ZERO", "D8.start", "error", "start time of -3.25 s: .*not from -3.25 s"),
        ("DRIFTS_IN_TIME", "D8.rounding", "error", "the product with .* steps, returned Error"),
        ("KEEPS_ON_RESET", "D12.reset", "error", "after fmi2Reset in the midst of a run"),
        ("FORGETS_A_MEMBER", "D11.replay", "error", "from a restored state: not the same"),
        ("ACCEPTS_DAMAGE", "D11.damaged", "warning", "flipped bits are accepted"),
        ("CRASHES_ON_DAMAGE", "D11.damaged", "error", "crashes: .* with bit 0 of byte 0 flipped"),
        ("LEAKS_STATES", "D11.growth", "warning", "KiB behind"),
        ("LEAKS_INSTANCES", "D15.lives", "warning", "KiB behind"),
        ("ONE_FOR_ALL", "D14.interleaved", "error", "interleaved instances: not the same"),
        ("ONE_FOR_ALL", "D14.threads", "error", "in threads: not the same"),
        ("PRINTS", "B5.surroundings", "warning", "bytes were written to the standard output"),
        ("ROUNDS_UP", "B5.surroundings", "warning", "floating-point environment changed"),
        (
            "WRONG_DERIVATIVE",
            "C3.derivatives",
            "error",
            "d y / d u = 1.5, finite diff.* give (1|0.99)",
        ),
        ("ANOTHER_VERSION", "B3.version", "error", "fmi2GetVersion returned b'2.0.5'"),
    ],
)
def test_a_defect_of_the_binary_is_found(defect, check, level, text, pack_defect):
    outcome = validate(pack_defect(f"DEFECT={defect}"), timeout=QUICK, only={check})[check]
    if outcome.skipped and "Linux only" in outcome.skipped:
        pytest.skip(outcome.skipped)
    assert outcome.verdict == level, outcome
    assert_found(outcome.problems, text)


def assert_found(problems: tuple[str, ...], text: str) -> None:
    assert any(re.search(text, problem) for problem in problems), problems


@pytest.mark.parametrize(
    ("macro", "check", "text"),
    [
        ("WITH_MORE_SYMBOLS", "B1.nothing_else", "exports 1 more symbols, step among them"),
        ("WITH_FEWER_SYMBOLS", "B1.exported", "does not export fmi2CancelStep"),
    ],
)
def test_symbols_are_counted(macro, check, text, pack_defect):
    pytest.importorskip("lief")
    outcome = validate(pack_defect(macro), only={check})[check]
    assert_found(outcome.problems, text)


def test_a_binary_in_the_folder_of_another_machine_is_found(pack_probe: PackProbe):
    pytest.importorskip("lief")
    other = "aarch64-linux" if platform_folders()[0] != "aarch64-linux" else "linux64"
    outcome = validate(pack_probe(folder=other), only={"B2.machine"})["B2.machine"]
    assert outcome.verdict == ("error" if sys.platform.startswith("linux") else "skipped")


Y = '<Unknown index="2" dependencies="1"/>'
COUNT = '<Unknown index="6" dependencies=""/>'
U = 'name="u" valueReference="0" causality="input" variability="discrete"'
START = '<Real unit="m" start="0"/>'


@pytest.mark.parametrize(
    ("replacement", "check", "level", "text"),
    [
        (('causality="output"', 'causality="outpt"'), "C1.schema", "error", "outpt"),
        ((' copyright="none"', ""), "C2.identity", "warning", "copyright is missing"),
        (("12:00:00Z", "12:00:00+01:00"), "C2.identity", "warning", "generationDateAndTime"),
        (
            ('guid="probe-1"', 'guid="probe-1" numberOfEventIndicators="1"'),
            *("C2.event_indicators", "warning", "= 1; leave it out"),
        ),
        (
            ('canGetAndSetFMUstate="true" ', ""),
            *("C3.capabilities", "error", "needs canGetAndSetFMUstate"),
        ),
        (('unit="m" start', 'unit="ft" start'), "C4.units", "error", "unit 'ft' of 'u'"),
        (
            ('<Unit name="s"><BaseUnit s="1"/>', '<Unit name="s">'),
            "C4.base_units",
            "warning",
            "'s'",
        ),
        ((START, START[:-2] + ' declaredType="T"/>'), "C5.types", "error", "'T' of 'u'"),
        (('"logStatusDiscard"', '"logStatusError"'), "C6.categories", "error", "declared 2 times"),
        (('"logStatusDiscard"', '"chatter"'), "C6.standard", "warning", "'chatter'"),
        (('stopTime="1"', 'stopTime="-1"'), "C7.experiment", "warning", "not after startTime"),
        (('name="count"', 'name="y"'), "C8.unique", "error", "2 variables are called 'y'"),
        (('name="y"', 'name="y.z"'), "C8.ports", "warning", "output 'y.z'"),
        (('name="w[2]"', 'name="w[4]"'), "C8.arrays", "warning", "'w' has the indices"),
        ((START, START.replace(' start="0"', "")), "C9.legal", "error", "'u' needs a start value"),
        (('initial="calculated"><Real', 'initial="exact"><Real'), "C9.legal", "error", "'y' needs"),
        ((U, U.replace("discrete", "fixed")), "C9.legal", "error", "'u': input, fixed"),
        (
            (U, U + ' canHandleMultipleSetPerTimeInstant="true"'),
            *("C9.model_exchange_only", "warning", "'u' has canHandle"),
        ),
        (('start="1" min="-10"', 'start="1" min="2"'), "C10.limits", "error", "'gain' starts at 1"),
        (('max="10"', 'max="-20"'), "C10.limits", "error", "min = -10, max = -20"),
        (('valueReference="4"', 'valueReference="2"'), "C11.aliases", "error", "more than once"),
        ((COUNT, ""), "C12.outputs", "error", "lacks 'count' .index 6."),
        ((f"{Y}\n      {COUNT}", f"{COUNT}\n      {Y}"), "C12.ascending", "error", "not ascending"),
        (
            (COUNT, '<Unknown index="6" dependencies="99"/>'),
            *("C12.dependencies", "error", "not among 1 to 13"),
        ),
        (
            (COUNT, '<Unknown index="6" dependencies="1" dependenciesKind="fixed fixed"/>'),
            *("C12.dependencies", "error", "1 dependencies, 2 kinds"),
        ),
        ((COUNT, '<Unknown index="6"/>'), "C12.stated", "warning", "indices 6 state no"),
        (
            ('initial="calculated"><Real unit="m"/>', 'initial="calculated"><Real min="1"/>'),
            *("D7.outputs", "error", "output 'y' = "),
        ),
        (('Identifier="probe"', 'Identifier="a-b"'), "C3.identifier", "error", "'a-b'"),
    ],
)
def test_a_defect_of_the_description_is_found(replacement, check, level, text, pack_probe):
    outcome = validate(pack_probe(replacement), only={check})[check]
    assert outcome.verdict == level, outcome
    assert_found(outcome.problems, text)


def test_initial_unknowns_without_one_are_found(pack_probe: PackProbe):
    both = f"{Y}\n      {COUNT}\n"
    path = pack_probe(("<InitialUnknowns>\n      " + both, f"<InitialUnknowns>\n      {Y}\n"))
    outcome = validate(path, only={"C12.initial_unknowns"})["C12.initial_unknowns"]
    assert_found(outcome.problems, "InitialUnknowns lacks 'count'")


def test_another_version_of_the_standard_is_named_and_not_judged(pack_probe: PackProbe):
    verdict = validate(pack_probe(('fmiVersion="2.0"', 'fmiVersion="3.0"')))
    assert_found(verdict["C1.schema"].problems, r"fmiVersion is 3\.0")
    judged = {o.item for o in verdict.outcomes if o.verdict != "skipped"}
    assert judged <= {"A1", "A2", "A3", "A7", "C1"}


def test_an_fmu_for_model_exchange_only_is_not_run(pack_probe: PackProbe):
    flags = 'canHandleVariableCommunicationStepSize="true"'
    path = pack_probe(("CoSimulation modelId", "ModelExchange modelId"), (flags, ""))
    verdict = validate(path)
    assert {o.skipped for o in verdict.outcomes if o.id in PROBES} == {
        "the FMU is not for co-simulation"
    }


# ---- Archives -----------------------------------------------------------------------------------


def repacked(probe: Path, path: Path, rename: Callable[[str], str], more: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(probe) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            new.writestr(rename(name), old.read(name))
        for name, content in more.items():
            new.writestr(name, content)
    return path


DOCTYPE = b"""<?xml version="1.0" encoding="UTF-8"?>
<!DOCTYPE lolz [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;">]><fmiModelDescription guid="&b;"/>"""


@pytest.mark.parametrize(
    ("rename", "more", "check", "level", "text"),
    [
        ("Probe/{}", {}, "A2.prefix", "error", "zip the content of the folder"),
        ("Probe/{}", {}, "A3.description", "error", "modelDescription.xml is missing"),
        ("{}", {"../evil": b""}, "A1.archive", "error", r"'\.\./evil' has an empty, '\.'"),
        ("{}", {"MODELDESCRIPTION.XML": b""}, "A1.archive", "error", "one file where case"),
        ("{}", {"r/\u00e9.txt": b""}, "A2.names", "warning", "is not ASCII"),
        ("{}", {"binaries/linux64/other.so": b""}, "A4.binaries", "error", ""),
        ("{}", {"binaries/vax/probe.so": b""}, "A4.binaries", "error", "in no folder"),
        ("{}", {"sources/a.c": b'#include "b.h"\n'}, "A5.sources", "warning", "includes b.h"),
        ("{}", {"sources/fmi2Functions.h": b""}, "A5.sources", "warning", "part of the standard"),
        ("{}", {"extra/notes/a.txt": b""}, "A7.extra", "warning", "not named by a reverse domain"),
        ("{}", {"model.png": b"GIF89a"}, "A3.documents", "warning", "no PNG"),
        ("{}", {"x" * 200: b""}, "A6.lengths", "warning", "has 200 characters"),
    ],
)
def test_a_defect_of_the_archive_is_found(rename, more, check, level, text, probe, tmp_path):
    path = repacked(probe, tmp_path / "probe.fmu", lambda name: rename.format(name), more)
    if "other.so" in str(more):
        with zipfile.ZipFile(path, "w") as archive:
            for name, content in more.items():
                archive.writestr(name, content)
            archive.writestr("modelDescription.xml", (HERE / "probe.xml").read_text())
    outcome = validate(path, only={check})[check]
    assert outcome.verdict == level, outcome
    assert_found(outcome.problems, text)


def test_entities_are_not_expanded_and_all_else_is_skipped(tmp_path):
    path = tmp_path / "lol.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", DOCTYPE)
    verdict = validate(path)
    assert_found(verdict["A3.description"].problems, "document type declaration")
    assert {o.verdict for o in verdict.outcomes if o.id in PROBES} == {"skipped"}


@pytest.mark.parametrize("content", [b"", b"no zip", b"PK\x03\x04" + bytes(100)])
def test_a_file_that_is_no_archive_is_an_error_and_no_traceback(content, tmp_path):
    path = tmp_path / "broken.fmu"
    path.write_bytes(content)
    verdict = validate(path)
    assert verdict["A1.archive"].verdict == "error"
    assert not verdict.good


REFERENCE = "extra/org.fmi-standard.fmi-ls-ref/probe"
INPUTS = b"time,u\n0,1\n0.01,2\n"
OPTIONS = b"StartTime,0.0\nStopTime,0.02\nStepSize,0.001\nRelTol,1e-6\n"


@pytest.mark.parametrize(("last", "verdict"), [(2.0, "ok"), (2.1, "error")])
def test_reference_results_are_reproduced_or_not(last, verdict, probe, tmp_path):
    files = {
        "_in.csv": INPUTS,
        "_ref.opt": OPTIONS,
        "_ref.csv": f"time,y\n0,1\n0.01,1\n0.02,{last}\n".encode(),
    }
    more = {REFERENCE + ending: content for ending, content in files.items()}
    path = repacked(probe, tmp_path / "probe.fmu", str, more)
    outcome = validate(path, only={"A7.reference"})["A7.reference"]
    assert outcome.verdict == verdict, outcome
    if verdict == "error":
        assert_found(outcome.problems, "'y' at t = 0.02 s is off by 0.0476")


# ---- Ours, reports, command ---------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("model", pack.model_names())
def test_every_native_fmu_of_ours_has_no_error(model):
    verdict = validate(pack.build([model])[model])
    assert verdict.good, [o for o in verdict.outcomes if o.verdict == "error"]


def test_what_pythonfmu_does_wrong_is_named():
    """The README sends people who need more than this to the native flavour."""
    pytest.importorskip("pythonfmu")
    checks = {"D1.plain", "D1.guid_wrong", "D1.name_null", "D8.stop", "D11.replay", "D12.reset"}
    verdict = validate(pack.build(["Wflc"], "python")["Wflc"], only=checks)
    assert {o.id for o in verdict.outcomes if o.verdict == "ok"} == {
        *("D1.plain", "D11.replay", "D12.reset")
    }
    assert {o.id for o in verdict.outcomes if o.verdict == "error"} == {
        *("D1.guid_wrong", "D1.name_null", "D8.stop")
    }


def test_reports_hold_every_check(verdict_on_probe, pack_defect, tmp_path):
    bad = validate(pack_defect("DEFECT=CRASHES_ON_NULL_NAME"), only={"D1.name_null", "D10.tunable"})
    write_junit(tmp_path / "sub" / "junit.xml", [verdict_on_probe, bad])
    suites = ElementTree.parse(tmp_path / "sub" / "junit.xml").getroot()
    first, second = suites
    assert len(first.findall("testcase")) == len(verdict_on_probe.outcomes)
    assert (first.get("failures"), second.get("failures")) == ("0", "1")
    assert (second.get("tests"), second.get("skipped")) == ("2", "1")
    failure = second.find("testcase/failure")
    assert failure is not None
    assert failure.get("message", "").startswith("crashes: the process ")
    write_json(tmp_path / "all.json", [verdict_on_probe, bad])
    content = json.loads((tmp_path / "all.json").read_text())
    assert content[1]["checks"][0]["id"] == "D1.name_null"
    assert content[1]["checks"][0]["verdict"] == "error"


def test_the_command_prints_a_table_and_ends_with_1(pack_probe: PackProbe, tmp_path):
    from typer.testing import CliRunner

    bad = pack_probe(('guid="probe-1"', 'guid="other"'), folder="vax64")
    files = ["--junit", str(tmp_path / "j.xml"), "--json", str(tmp_path / "j.json")]
    result = CliRunner().invoke(app, ["validate", str(bad), *files], env={"COLUMNS": "150"})
    assert result.exit_code == 1
    assert "error A4.binaries" in result.output
    assert "probe.fmu: " in result.output
    assert ElementTree.parse(tmp_path / "j.xml").getroot().tag == "testsuites"
    assert json.loads((tmp_path / "j.json").read_text())[0]["counts"]["error"] >= 1


def test_a_missing_file_is_named():
    with pytest.raises(SteadytipError, match=r"gone\.fmu does not exist"):
        validate(Path("gone.fmu"))
