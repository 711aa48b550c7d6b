"""Documents inside an FMU: the page, figures in it against theory, the icon, the archive."""

import struct
import zlib
from functools import partial
from html.parser import HTMLParser

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmu_src.controller.interface import FORECASTER
from fmu_src.device import design
from fmu_src.errors import SteadytipError
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Inputs, Scalar, real
from fmu_src.kit.runner import Runner
from fmu_src.pack import compiled_runner as compiled
from fmu_src.pack.discovery import load_model
from fmu_src.pack.docs import documents, icon, page, response
from fmu_src.pack.fmu import archive, description, reference
from tests.conftest import by_model

T = 1e-3
_VOID = {"meta", "link", "img", "br", "hr"}


class _Reader(HTMLParser):
    """Checks nesting and rectangular tables; collects text, links and resources."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text: list[str] = []
        self.links: list[str] = []
        self.widths: list[set[int]] = []
        self.cells = 0

    def handle_starttag(self, tag, attrs) -> None:
        self.links += [v for k, v in attrs if k in ("href", "src")]
        if tag not in _VOID:
            self.open.append(tag)
        if tag == "table":
            self.widths.append(set())
        elif tag == "tr":
            self.cells = 0
        elif tag in ("td", "th"):
            self.cells += 1

    def handle_endtag(self, tag) -> None:
        assert self.open.pop() == tag
        if tag == "tr":
            self.widths[-1].add(self.cells)

    def handle_data(self, data) -> None:
        self.text.append(data)


@pytest.fixture(scope="module", params=by_model())
def model(request) -> Model:
    return load_model(request.param)


@pytest.fixture
def pages(model) -> dict[str, tuple[str, _Reader]]:
    found = {}
    for flavour in ("native", "python"):
        text = page.html(model, flavour)
        reader = _Reader()
        reader.feed(text)
        reader.close()
        assert not reader.open
        found[flavour] = (text, reader)
    return found


def test_page_is_well_formed_and_its_tables_rectangular(pages) -> None:
    for _, reader in pages.values():
        assert len(reader.widths) >= 3
        assert all(len(widths) == 1 for widths in reader.widths)


def test_page_stands_alone(model, pages) -> None:
    """Nothing from elsewhere is loaded, and its links lead to files of the FMU."""
    for flavour, (_, reader) in pages.items():
        beside = documents.files(model, flavour)
        for link in reader.links:
            if not link.startswith("data:image/png;base64,"):
                assert f"documentation/{link}" in beside


def test_page_names_every_field_with_its_unit_and_limits(model, pages) -> None:
    _, reader = pages["native"]
    text = "".join(reader.text)
    assert model.summary in text
    for record in (model.inputs, model.outputs, model.parameters, model.derived, model.state):
        for scalar in record.scalars():
            base = scalar.name.split("[")[0]
            known = [base] if not record.flat else [base, base.rpartition("_")[0]]
            assert any(name in text for name in known), scalar.name
            assert scalar.field.description in text
            for limit in (scalar.field.min, scalar.field.max):
                assert np.isinf(limit) or f"{limit:.6g}" in text
    for equation in [line for line in model.documentation.split("\n") if line.startswith("    ")]:
        assert equation.strip() in text


def test_page_tells_sample_period_cost_and_sources(model, pages) -> None:
    text = "".join(pages["native"][1].text)
    assert f"{model.sample_period * 1e3:g} ms" in text
    kind = "matrix operations" if model.matrix else "operations"
    assert f"{model.step_function.n_instructions()} {kind} a sample" in text
    for key in page.PAPERS:
        cited = f"({key} " in model.documentation or f" {key} " in model.documentation
        assert not cited or page.PAPERS[key] in text


def test_flavours_differ_in_what_they_need(pages) -> None:
    assert "externalDependencies.txt" in pages["python"][0]
    assert "externalDependencies.txt" not in pages["native"][0]
    assert "sources/fmu.c" in pages["native"][0]


def test_a_package_without_its_licence_is_refused_with_the_cure(monkeypatch) -> None:
    monkeypatch.setattr(documents, "_PACKED", "no-such-package")
    with pytest.raises(SteadytipError, match="pip install --force-reinstall no-such-package"):
        documents.files(load_model("Flc"), "python")


def test_documents_hold_nothing_of_this_machine(model) -> None:
    for flavour in ("native", "python"):
        for name, content in documents.files(model, flavour).items():
            assert not any(word in content for word in (b"/tmp", b"/home", b"/root", b"/work")), (
                name
            )


# Figures: the response against theory


class _Params(Parameters):
    """None."""


class _In(Inputs):
    u = real("m", "input", min=-1.0, max=1.0)


class _X(State):
    past = real("m", "inputs of the samples before", shape=7)


class _Out(Outputs):
    delayed = real("m", "three times the input of seven samples ago")
    now = real("m", "the input")
    steps = real("m", "the input in steps of a hundredth of its reach")
    square = real("m2", "no tone at the input's frequency")


def _delay(p, u, x, T) -> tuple[_X, _Out]:
    step = reference.REACH["m"] / 100
    outputs = _Out(
        delayed=3 * x.past[6],
        now=u.u,
        steps=step * ca.floor(u.u / step + 0.5),
        square=(u.u - reference.REACH["m"]) ** 2,
    )
    return _X(past=ca.vertcat(u.u, x.past[:6])), outputs


def test_response_of_a_pure_delay_a_wire_and_a_converter() -> None:
    known = Model("Delay", _delay, _Params, _In, _X, _Out, T)
    found = {r.output: r for r in response.responses(known)}
    assert set(found) == {"delayed", "now", "steps"}
    delayed, now, steps = found["delayed"], found["now"], found["steps"]
    assert delayed.gain == pytest.approx(3, rel=1e-9)
    assert delayed.phase == pytest.approx(-360 * reference.TONE * 7 * T, rel=1e-9)
    assert delayed.group_delay == pytest.approx(7 * T, rel=1e-9)
    assert (now.gain, now.phase, now.group_delay) == pytest.approx((1, 0, 0), abs=1e-12)
    assert steps.gain == pytest.approx(1, rel=1e-3)
    assert steps.group_delay == pytest.approx(0, abs=1e-5)


def test_response_of_the_sensors_is_that_of_their_output_filter() -> None:
    """A first-order lag: gain 1 / sqrt(1 + a^2), phase -atan a, group delay tau / (1 + a^2)."""
    a = 2 * np.pi * reference.TONE * design.SENSOR_LAG
    found = {r.output: r for r in response.responses(load_model("InertialSensors"))}
    for channel in ("a1x", "a1z", "a2y", "a2z", "a3x", "a3y"):
        measured = found[f"volts_{channel}"]
        assert measured.source == f"force{channel[1]}_{channel[2]}"
        gain = design.ACCELEROMETER_SCALE / np.hypot(1, a)
        assert measured.gain == pytest.approx(gain, rel=0.005)
        assert measured.phase == pytest.approx(-np.degrees(np.arctan(a)), abs=0.2)
        assert measured.group_delay == pytest.approx(design.SENSOR_LAG / (1 + a * a), abs=5e-5)


def test_responses_need_no_compiler(monkeypatch) -> None:
    """The page of a Python FMU is made on platforms for which no binary can be built, too."""
    monkeypatch.setattr(response, "_LONG", 0)
    monkeypatch.setattr("platform.machine", lambda: "abacus")
    compiled._compiled.cache_clear()
    model = load_model("Shelving")
    with pytest.raises(SteadytipError, match="no native FMU can be built for"):
        compiled.CompiledRunner(model)
    found = response.responses.__wrapped__(model)
    assert found == response.responses(model) != []


def test_tremor_filters_put_the_tone_where_it_will_be(monkeypatch) -> None:
    """The filter that hears the position looks ahead, so the tone it puts out is not late."""
    chosen = {"tremor_filter": FORECASTER}
    monkeypatch.setattr(response, "Runner", partial(Runner, parameters=chosen))

    def reach(scalar: Scalar) -> float:
        return reference.reach(scalar) if scalar.name.startswith("tip_displacement") else 0.0

    monkeypatch.setattr(response, "reach", reach)
    # Computed anew: what is kept is that of the starts.
    answered = response.responses.__wrapped__(load_model("TremorCanceller"))
    found = {r.output: r for r in answered}
    for axis in "xyz":
        measured = found[f"tremor_{axis}"]
        assert measured.source == f"tip_displacement_{axis}"
        assert measured.gain == pytest.approx(1, abs=0.05)
        assert abs(measured.phase) < 10
        assert measured.group_delay < 0


# Reference, icon, archive


def test_reference_is_on_a_grid_that_ends_with_the_run() -> None:
    assert description.DEFAULT_SAMPLES % reference.EVERY == 0


def test_reference_prefers_first_elements() -> None:
    names = reference.compared_outputs(load_model("MicronEstimator"))
    assert len(names) == reference.OUTPUTS
    assert {"attitude_w", "rate_x", "tip_displacement_x", "valid"} <= set(names)


def test_reference_inputs_stay_inside_their_limits(model) -> None:
    u = reference.stimulus(model)
    scalars = model.variables["input"]
    assert u.shape == (description.DEFAULT_SAMPLES // reference.EVERY + 1, len(scalars))
    for column, scalar in zip(u.T, scalars, strict=True):
        assert scalar.field.min <= column.min()
        assert column.max() <= scalar.field.max


def test_icon_is_a_png_that_decodes_to_its_size() -> None:
    content = icon.png()
    assert content[:8] == b"\x89PNG\r\n\x1a\n"
    chunks, at = {}, 8
    while at < len(content):
        (length,) = struct.unpack(">I", content[at : at + 4])
        kind, body = content[at + 4 : at + 8], content[at + 8 : at + 8 + length]
        (checksum,) = struct.unpack(">I", content[at + 8 + length : at + 12 + length])
        assert checksum == zlib.crc32(kind + body)
        chunks[kind] = body
        at += 12 + length
    assert list(chunks) == [b"IHDR", b"IDAT", b"IEND"]
    assert struct.unpack(">IIBBBBB", chunks[b"IHDR"]) == (icon.SIZE, icon.SIZE, 8, 6, 0, 0, 0)
    rows = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8).reshape(icon.SIZE, -1)
    assert not rows[:, 0].any()
    pixels = rows[:, 1:].reshape(icon.SIZE, icon.SIZE, 4)
    assert pixels[0, 0, 3] == 0
    assert pixels[icon.SIZE // 2, icon.SIZE // 2, 3] == 255
    # Tremor on the left, a steady line on the right, in two colours.
    inner = pixels[20:-20, :, :3].astype(int).min(axis=2) < 230
    spread = [np.ptp(np.flatnonzero(inner[:, x])) for x in (icon.SIZE // 4, 3 * icon.SIZE // 4)]
    assert spread[0] > 3 * spread[1] > 0


@settings(max_examples=30)
@given(
    files=st.dictionaries(
        st.from_regex(r"[a-z]{1,6}(/[a-z]{1,6}){0,2}\.[a-z]", fullmatch=True),
        st.binary(max_size=300),
        min_size=1,
        max_size=6,
    )
)
def test_archives_depend_on_their_content_only(tmp_path_factory, files) -> None:
    folder = tmp_path_factory.mktemp("archives")
    archive.write(folder / "a.fmu", files)
    archive.write(folder / "b.fmu", dict(reversed(files.items())))
    assert (folder / "a.fmu").read_bytes() == (folder / "b.fmu").read_bytes()
    assert archive.read(folder / "a.fmu") == files
