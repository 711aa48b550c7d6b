"""Many ticks in one native call: the same bits as tick by tick in Python, or not at all."""

import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import steadytip
from fmu_src.pack import compiler
from harness.bench import other_hosts
from harness.common.errors import PartError
from harness.loop import native as native_loop
from harness.loop.loop import Loop
from harness.parts.protocols import RunContext
from harness.scenario.load import load
from harness.system.assembly import assemble

PORTS = {"u": "y", "add": "count", "on": "off"}
"""Inputs of the probe, and the output of the same type."""


class Memory:
    """A record that keeps all ticks in an array; `most` rows of room at a time."""

    def __init__(self, ticks: int, width: int, most: int) -> None:
        self.rows = np.full((ticks, width), np.nan)
        self.filled, self.most = 0, most

    def append(self, signals) -> None:
        self.rows[self.filled] = signals
        self.filled += 1

    def buffer(self):
        return self.rows[self.filled : self.filled + self.most]

    def commit(self, rows: int) -> None:
        assert 0 < rows <= self.most
        self.filled += rows

    def flush_idle(self) -> None:
        raise AssertionError("not on the wall clock")


def wired(wires: list[tuple[int, str, int]], parts: int, probe: Path) -> str:
    """A ring of probes: of each wire its target, input and delay; the source is the part before."""
    text = "".join(
        f'[part.p{i}]\nfmu = "{probe.as_posix()}"\ngain = {0.3 + 0.2 * i}\nu = {i + 1.0}\n'
        for i in range(parts)
    )
    for target, port, delay in wires:
        source = (target - 1) % parts
        text += f'[[wire]]\nfrom = "p{source}.{PORTS[port]}"\nto = "p{target}.{port}"\n'
        text += f"delay = {delay or int(target == 0)}\n"
    return text


@settings(max_examples=15)
@given(data=st.data(), parts=st.integers(1, 4), most=st.integers(1, 60))
def test_any_ring_of_parts_gives_the_same_bits(probe, data, parts, most):
    ends = st.tuples(st.integers(0, parts - 1), st.sampled_from([*PORTS]))
    wires = [
        (target, port, data.draw(st.integers(0, 4)))
        for target, port in data.draw(st.lists(ends, unique=True))
    ]
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        path = Path(folder) / "ring.toml"
        path.write_text("seconds = 0.05\nstep_size = 1e-3\n" + wired(wires, parts, probe))
        system = assemble(load(str(path)))
        records = []
        for library in (native_loop.library, lambda: None):
            patch.setattr(native_loop, "library", library)
            record = Memory(system.steps, len(system.columns), most)
            outcome = Loop(system, RunContext(1e-3, system.steps, Path(folder)), record).go()
            assert (outcome.error, outcome.ticks) == (None, 50)
            records.append(record.rows)
    assert np.array_equal(*records)


def test_what_is_known_beforehand_runs_natively_too(write_scenario, recording, tmp_path, tick):
    """Parts that play a recording, and a record, are tables to the native call."""
    plan = native_loop.native_steps
    planned = []
    text = '[part.hand]\nreplay = "hand.csv"\n[part.probe]\nfmu = PROBE\n'
    text += '[[wire]]\nfrom = "hand.recorded_x"\nto = "probe.u"\n'
    first = steadytip.run(write_scenario(text), out=tmp_path / "first", report=False)
    again = f'[part.hand]\nrecorded = "{(tmp_path / "first" / "results.parquet").as_posix()}"\n'
    path = write_scenario(again + text.partition("\n")[2].partition("\n")[2])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "harness.loop.loop.native_steps", lambda p: planned.append(plan(p)) or planned[-1]
        )
        second = steadytip.run(path, out=tmp_path / "second", report=False)
    assert (planned[0] is not None) == (tick == "native")
    assert np.ptp(first.signals("probe.y")) > 5e-5
    assert np.array_equal(first.signals("probe.y"), first.signals("hand.recorded_x"))
    assert np.array_equal(first.signals("*.*"), second.signals("*.*"))


def test_a_part_that_comes_back_after_all_changes_nothing(write_scenario, tmp_path):
    """The run has ended without it; its thread still has the loop's memory, but not the record."""
    text = "[part.bad]\nfmu = PROBE\nmode = 4\nat = 0.5\nstep_limit = 1.0\n"
    before = threading.enumerate()
    with pytest.raises(PartError, match=r"not come back from its step at t = 0\.5 s") as caught:
        steadytip.run(write_scenario(text), out=tmp_path / "out", report=False)
    late = [thread for thread in threading.enumerate() if thread not in before]
    assert late
    for thread in late:
        thread.join(60.0)
        assert not thread.is_alive()
    assert np.array_equal(caught.value.result.signals("bad.count"), np.arange(1, 501))


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """A folder without a compiled library."""
    original, own_files = compiler._compile, compiler.FOLDER.resolve()

    def compile_here(*arguments):
        with monkeypatch.context() as patch:
            patch.setattr(compiler, "FOLDER", own_files)
            return original(*arguments)

    monkeypatch.setattr(compiler, "FOLDER", tmp_path)
    monkeypatch.setattr(compiler, "_compile", compile_here)
    native_loop.library.cache_clear()
    yield tmp_path / "compiled"
    native_loop.library.cache_clear()


def test_it_is_compiled_once_and_again_when_damaged(elsewhere, monkeypatch):
    assert native_loop.library() is not None
    (kept,) = elsewhere.iterdir()
    native_loop.library.cache_clear()
    with monkeypatch.context() as patch:
        patch.setattr(compiler, "_compile", lambda *_: pytest.fail("it is there already"))
        assert native_loop.library() is not None
    # In another folder: the system gives a library that is loaded already by its name.
    other = elsewhere.parent / "other" / "compiled"
    other.mkdir(parents=True)
    (other / kept.name).write_bytes(b"no library")
    monkeypatch.setattr(compiler, "FOLDER", other.parent)
    native_loop.library.cache_clear()
    assert native_loop.library() is not None
    assert (other / kept.name).read_bytes() == kept.read_bytes()


@pytest.mark.parametrize("folder", compiler.TARGETS)
def test_it_compiles_for_every_platform_without_a_warning(folder):
    for target in compiler.TARGETS[folder]:
        warnings = ("-Wall", "-Wextra", "-Werror", "-pedantic", "-Wno-unused-parameter")
        library = native_loop.compiled(target, *warnings).read_bytes()
        assert library[:4] in (b"\x7fELF", b"MZ\x90\0", b"MZx\0", b"\xcf\xfa\xed\xfe")


def test_without_a_compiler_the_loop_goes_tick_by_tick(
    elsewhere, write_scenario, tmp_path, monkeypatch
):
    def refuse(*_):
        raise steadytip.SteadytipError("no compiler")

    monkeypatch.setattr(compiler, "_compile", refuse)
    result = steadytip.run(write_scenario("[part.p]\nfmu = PROBE\n"), out=tmp_path, report=False)
    assert native_loop.library() is None
    assert np.array_equal(result.signals("p.count"), np.arange(1, 1001))


@pytest.mark.slow
def test_a_tick_is_faster_than_that_of_a_plain_loop(tmp_path):
    """Each recorded, in turns: 9 to 12 times on two cores that are shared; libcosim's, 2 to 3."""
    loop = other_hosts.PlainLoop("closed_loop", tmp_path / "plain")
    ticks, plain, own = 1000, [], []
    overrides = {"seconds": ticks * loop.step, "warm_up": 0.0}
    for _ in range(3):
        begun = time.perf_counter()
        loop.run(ticks)
        plain.append(time.perf_counter() - begun)
        result = steadytip.run("closed_loop", overrides=overrides, out=tmp_path, report=False)
        own.append(result.metadata.wall)
    assert min(plain) > 3 * min(own)
