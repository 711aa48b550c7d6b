"""The monitor: what it computes, what it serves, and how it begins and ends."""

import base64
import json
import os
import re
import select
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.parse
import urllib.request

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmu_src.errors import SteadytipError
from harness.bench.monitor_load import (
    BOARD,
    LOOP,
    ROLES,
    STEP,
    TONE,
    board_rows,
    columns,
    get,
    loop_rows,
    motion,
    refresh,
)
from harness.hil.monitor import _parser, _serve, start_monitor
from harness.hil.monitor_view import (
    MonitorState,
    Rows,
    Watchdog,
    fresh,
    histogram,
    joined,
    tip_of,
    view_of,
)
from harness.hil.ring import Ring
from tests.waiting import wait_until

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
PATIENCE = 200.0
"""With a process that steps aside for all others, beside a busy machine [s]."""


def rings(folder):
    """Writers of a loop's and a board's ring."""
    return (
        Ring.create(folder / "loop.ring", columns(LOOP), STEP),
        Ring.create(folder / "board.ring", columns(BOARD), STEP),
    )


# ---- Data ---------------------------------------------------------------------------------------


def rows_of(table, values, begin: int = 0) -> Rows:
    """The last rows of a ring, `begin` the number of the first."""
    return Rows(STEP, np.arange(begin, begin + len(values)), tuple(columns(table)), values)


NAMES = {
    role: tuple(f"{ROLES[role][0][:-1]}{axis}" for axis in "xyz")
    for role in ("tip_uncompensated", "tip", "intent")
}


@given(st.lists(st.one_of(st.integers(-1, 6), st.just(float("nan"))), max_size=30))
def test_fresh_samples_are_the_first_of_each_since_the_last_restart(column) -> None:
    expected: list = []
    for row, number in enumerate(column):
        if not number >= 0:
            continue
        if expected and number < expected[-1][0]:
            expected = []
        if not expected or number > expected[-1][0]:
            expected.append((int(number), row))
    numbers, rows = fresh(np.array(column, dtype=float))
    assert list(zip(numbers.tolist(), rows.tolist(), strict=True)) == expected


_NUMBERS = st.sets(st.integers(0, 20)).map(lambda s: np.array(sorted(s), dtype=np.int64))


@given(st.lists(_NUMBERS, min_size=1, max_size=3))
def test_joined_samples_are_those_that_all_have(numbers) -> None:
    common, places = joined(numbers)
    assert set(common.tolist()) == set.intersection(*(set(each.tolist()) for each in numbers))
    for each, place in zip(numbers, places, strict=True):
        np.testing.assert_array_equal(each[place], common)


@given(st.lists(st.floats(0.0, 2.0), max_size=200))
def test_a_histogram_counts_every_latency(latency) -> None:
    edges, counts = histogram(np.array(latency))
    assert counts.sum() == len(latency)
    assert edges[-1] >= 1e-3
    assert len(counts) <= 80
    np.testing.assert_allclose(np.diff(edges), edges[1] - edges[0])


def test_a_histogram_keeps_what_lies_beyond_in_its_last_bin() -> None:
    edges, counts = histogram(np.concatenate([np.full(1000, 2.1e-4), [0.5]]))
    assert edges[-1] == pytest.approx(1e-3)
    assert counts[-1] == 1
    assert counts[np.searchsorted(edges, 2.1e-4) - 1] == 1000


def test_the_tip_error_of_a_known_tone() -> None:
    """30 % of a tone of 38 µm rms is left, and 2 µm of noise on each axis."""
    tip = tip_of([rows_of(BOARD, board_rows(8000))], NAMES)
    assert tip.metrics["reduction_in_band"].value == pytest.approx(70.0, abs=0.5)
    left = np.sqrt((0.3 * tip.metrics["tip_rms_uncompensated"].value) ** 2 + 3 * 2e-6**2)
    assert tip.metrics["tip_rms"].value == pytest.approx(left, rel=0.02)
    moved, _, intent = motion(8000)
    np.testing.assert_allclose(tip.without.std(axis=0), (moved - intent).std(axis=0), rtol=1e-9)
    frequency, before, after = tip.spectra
    assert frequency[before.argmax()] == TONE == frequency[after.argmax()]
    assert after.max() / before.max() == pytest.approx(0.3, rel=0.02)


def test_no_spectrum_before_there_is_enough() -> None:
    assert tip_of([rows_of(BOARD, board_rows(1500))], NAMES).spectra is None
    assert tip_of([rows_of(BOARD, board_rows(1))], NAMES) is None


def test_a_real_board_does_not_know_its_tip() -> None:
    loop = rows_of(LOOP, loop_rows(3000))
    assert tip_of([loop], NAMES) is None
    view, _ = view_of([loop], {})
    assert view.tip is None
    assert view.volts[0] == ("sensors.volts_sent_1", "sensors.volts_sent_2", "sensors.volts_sent_3")


def test_without_an_intent_it_is_made_from_the_motion() -> None:
    names = {role: NAMES[role] for role in ("tip_uncompensated", "tip")}
    tip = tip_of([rows_of(BOARD, board_rows(8000))], names)
    assert tip.metrics["reduction_in_band"].value == pytest.approx(70.0, abs=0.5)
    assert tip.metrics["tip_rms_uncompensated"].value == pytest.approx(38e-6, rel=0.1)


def test_signals_of_two_rings_meet_by_sample() -> None:
    """The intent comes from a ring that lost 40 samples and began 300 ticks earlier.

    Expected: every sample in its place, the lost ones on the line between their neighbours.
    """
    count = 4000
    table = board_rows(count)
    lossy = np.column_stack([loop_rows(count, begin=300)[:, :3], np.zeros((count + 300, 3))])
    held = np.concatenate([np.zeros(300), lossy[300:, 0]]).astype(int)
    lossy[:, 3:] = table[held, 6:9]
    names = [*LOOP[:3], *BOARD[6:9]]
    rings = [rows_of(BOARD[:6], table[:, :6]), rows_of(names, lossy, begin=7000)]
    tip = tip_of(rings, NAMES)
    whole = tip_of([rows_of(BOARD, table)], NAMES)
    np.testing.assert_array_equal(tip.samples, np.arange(count))
    known = np.r_[0 : count // 2, count // 2 + 40 : count]
    apart = (tip.error - whole.error)[known]
    np.testing.assert_allclose(apart - apart.mean(axis=0), 0.0, atol=1e-12)
    lost = slice(count // 2, count // 2 + 40)
    np.testing.assert_allclose(np.diff(tip.without[lost], 2, axis=0), 0.0, atol=1e-15)
    assert np.abs(np.diff(whole.without[lost], 2, axis=0)).max() > 1e-8


def test_rings_are_drawn_on_the_time_of_the_loop() -> None:
    """The loop takes sample k at tick 300 + k and is shown to tick 8299, sample 7999."""
    rings = [rows_of(LOOP, loop_rows(8000, begin=300)), rows_of(BOARD, board_rows(8005))]
    view, shift = view_of(rings, NAMES)
    assert shift == pytest.approx(0.3)
    assert view.seconds == pytest.approx(8.299)
    assert view.time[-1] == 0.0
    assert view.tip_time[7999] == pytest.approx(0.0, abs=1e-9)
    assert view.tip_time[-1] == pytest.approx(5 * STEP)


def test_a_deaf_loop_does_not_stop_the_board_s_time() -> None:
    """The loop has had no sample for longer than is shown; the board goes on."""
    loop = loop_rows(9000, begin=300)[-8000:]
    loop[:, 0] = 500
    rings = [rows_of(LOOP, loop, begin=1300), rows_of(BOARD, board_rows(8000), begin=1000)]
    view, shift = view_of(rings, NAMES, shift=0.3)
    assert shift == 0.3
    assert view.tip_time[-1] == pytest.approx(0.0, abs=1e-9)


def test_what_a_feed_says() -> None:
    view, _ = view_of([rows_of(LOOP, loop_rows(8000, begin=300)[-6000:], begin=2300)], {})
    (feed,) = view.feeds  # `estimator.valid` is no feed's
    assert (feed.name, feed.sample) == ("sensors", 7999)
    assert [(c.name, c.total, c.recent) for c in feed.counts] == [
        ("lost", 40, 40),
        ("crc", 1, 1),
        ("timeouts", 1, 1),
        ("overruns", 0, 0),
    ]
    assert feed.counts[0].description == "what sensors.lost says"
    assert int((feed.valid == 0.0).sum()) == 40
    assert feed.age.max() == pytest.approx(0.041, abs=1e-3)
    assert len(view.latency) == 6000 - 40
    assert set(view.mode) == {1.0, 2.0}


def test_before_the_first_sample() -> None:
    loop = loop_rows(10, begin=300)[:300]
    view, _ = view_of([rows_of(LOOP, loop), rows_of(BOARD, np.empty((0, 9)))], NAMES)
    assert view.tip is None
    assert view.feeds[0].sample is None
    empty, _ = view_of([rows_of(LOOP, loop[:0]), rows_of(BOARD, np.empty((0, 9)))], NAMES)
    assert empty.seconds == 0.0


def test_a_pulse(tmp_path) -> None:
    watchdog, writer = Watchdog(), rings(tmp_path)[0]
    row = loop_rows(1)[0]
    assert watchdog.look(None, 0.0) == (MonitorState.WAITING, 0.0)
    ring = Ring.open(writer.path)
    assert watchdog.look(ring, 1.0)[0] is MonitorState.WAITING
    assert watchdog.look(ring, 9.0)[0] is MonitorState.WAITING  # a loop that waits for its board
    writer.append(row)
    assert watchdog.look(ring, 9.25)[0] is MonitorState.RUNNING
    assert watchdog.look(ring, 10.25)[0] is MonitorState.RUNNING
    assert watchdog.look(ring, 10.5) == (MonitorState.SILENT, 1.25)
    writer.append(row)
    assert watchdog.look(ring, 10.75)[0] is MonitorState.RUNNING
    writer.close()
    assert watchdog.look(ring, 11.0)[0] is MonitorState.STOPPED


def test_a_ring_whose_writer_died_before_is_never_taken_for_running(tmp_path) -> None:
    watchdog, writer = Watchdog(), rings(tmp_path)[0]
    writer.append(loop_rows(1)[0])
    states = [watchdog.look(writer, now)[0] for now in (5.0, 5.5, 6.0, 6.5)]
    assert states == [
        MonitorState.WAITING,
        MonitorState.WAITING,
        MonitorState.WAITING,
        MonitorState.SILENT,
    ]


# ---- Server -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """Rings of a loop that has stopped after 20 s."""
    loop, board = rings(tmp_path_factory.mktemp("rings"))
    for row in loop_rows(20000, begin=300):
        loop.append(row)
    for row in board_rows(20000):
        board.append(row)
    loop.close()
    board.close()
    return loop.path, board.path


@pytest.fixture(scope="module")
def monitor(filled):
    with start_monitor(filled, ROLES) as running:
        yield running


def test_the_page_needs_no_other_host(monitor) -> None:
    page = get(monitor.url).decode()
    assert "Steadytip: live" in page
    addresses = re.findall(r"(?:src|href)=\"([^\"]+)", page)
    assert len(addresses) > 5
    assert all(address.startswith("/_") for address in addresses)
    for address in addresses:
        assert get(urllib.parse.urljoin(monitor.url, address))


def test_only_this_machine_is_served(monitor) -> None:
    port = urllib.parse.urlsplit(monitor.url).port
    with socket.create_connection(("127.0.0.1", port)):
        pass
    # Every address 127.x is this machine's; a server on all of them would answer here.
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", port))


def test_a_refresh_has_the_numbers_of_the_rings(monitor, filled) -> None:
    answer = refresh(monitor.url)
    assert answer["banner"] == {"children": "Stopped at 20.3 s", "className": "banner stopped"}
    tiles = json.dumps(answer["tiles"], ensure_ascii=False)
    tip = tip_of([rows_of(BOARD, board_rows(20000)[-8000:])], NAMES)
    reduction = f"{tip.metrics['reduction_in_band'].value:.4g} %"
    for text in (reduction, "µm", "sample 19999", "valid", "run"):
        assert text in tiles
    assert "what sensors.overruns says" in json.dumps(answer["counters"])
    x, y = (decoded(answer["volts"]["figure"]["data"][1][axis]) for axis in "xy")
    sent = loop_rows(20000)[:, -3]
    np.testing.assert_allclose(y, sent[len(sent) - 1 + np.round(x / STEP).astype(int)], rtol=1e-6)
    assert (y.min(), y.max()) == pytest.approx((sent[-2000:].min(), sent[-2000:].max()), rel=1e-6)
    assert (x[0], x[-1]) == pytest.approx((-2.0, 0.0), abs=0.01)


def test_a_page_that_has_its_figures_gets_curves_only(monitor) -> None:
    first = refresh(monitor.url)
    again = refresh(monitor.url, first["drawn"]["data"])
    assert first["drawn"]["data"] == [6, 2, 3, 3, 1] == again["drawn"]["data"]
    assert "layout" in first["tip"]["figure"]
    operations = again["tip"]["figure"]["operations"]
    assert [o["location"] for o in operations[:2]] == [["data", 0, "x"], ["data", 0, "y"]]
    assert len(operations) == 12
    assert len(json.dumps(again)) < 200_000


def decoded(array):
    return np.frombuffer(base64.b64decode(array["bdata"]), f"<{array['dtype']}")


def options(*arguments):
    return _parser().parse_args([*map(str, arguments)])


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["missing.ring"], r"there is no ring missing.ring; is its writer running\?"),
        (["RING", "--role", "tip"], r"--role tip: write ROLE=COLUMN"),
        (["RING", "--role", "tipp=a.b"], r"no role 'tipp'; did you mean 'tip'\?"),
        (["RING", "--port", "70000"], r"--port 70000: a port is 1 to 65535, or 0 for a free"),
        (["RING", "--port", "TAKEN"], r"127.0.0.1 does not give it \(Address already in use\)"),
        (["FILE"], r"FILE is not a ring: it does not begin as one"),
    ],
)
def test_mistakes_are_one_sentence(filled, tmp_path, monkeypatch, arguments, text) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "FILE").write_text("hello")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        known = {"RING": filled[0], "TAKEN": taken.getsockname()[1]}
        with pytest.raises(SteadytipError, match=text) as caught:
            _serve(options(*(known.get(a, a) for a in arguments)), threading.Event())
    assert "\n" not in str(caught.value)


def test_mistakes_end_with_code_2(tmp_path) -> None:
    command = [sys.executable, "-m", "harness.hil.monitor", str(tmp_path / "missing.ring")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "there is no ring" in done.stderr
    assert done.stdout == ""


def test_a_monitor_that_does_not_start_says_why(tmp_path) -> None:
    (tmp_path / "FILE").write_text("hello")
    with pytest.raises(SteadytipError, match=r"monitor does not start: .*FILE is not a ring"):
        start_monitor([tmp_path / "FILE"], {})


def started(*arguments):
    process = subprocess.Popen(
        [sys.executable, "-m", "harness.hil.monitor", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline().startswith("http://127.0.0.1:")
    return process


def test_it_ends_with_the_loop_when_its_parent_is_gone(tmp_path) -> None:
    """Another process's number as the parent's looks as if that were gone."""
    writer, _ = rings(tmp_path)
    row = loop_rows(1)[0]
    stop = threading.Event()

    def write() -> None:
        while not stop.wait(0.05):
            writer.append(row)

    thread = threading.Thread(target=write, daemon=True)
    thread.start()
    process = started(writer.path, "--parent", "1" if os.getppid() != 1 else "2")
    try:
        with pytest.raises(subprocess.TimeoutExpired):
            process.communicate(timeout=2.5)
        usual = os.getpriority(os.PRIO_PROCESS, 0)
        assert os.getpriority(os.PRIO_PROCESS, process.pid) == min(19, usual + 10)
    finally:
        stop.set()
        thread.join()
        writer.close()
    _, errors = process.communicate(timeout=PATIENCE)
    assert (process.returncode, errors) == (0, "")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signals_end_it_without_a_word(filled, number) -> None:
    process = started(*filled)
    process.send_signal(number)
    _, errors = process.communicate(timeout=PATIENCE)
    assert (process.returncode, errors) == (0, "")


# ---- Browser ------------------------------------------------------------------------------------


class Browser:
    """Headless Chromium, spoken to over a pair of pipes; it can reach 127.0.0.1 alone."""

    OPTIONS = (
        "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-sync"
        " --disable-background-networking --disable-component-update --disable-dev-shm-usage"
        " --window-size=1200,1600 --remote-debugging-pipe"
    )

    def __init__(self, folder) -> None:
        theirs_in, self._out = os.pipe()
        self._in, theirs_out = os.pipe()
        self._process = subprocess.Popen(
            # The pipes have to be 3 and 4.
            [
                "bash",
                "-c",
                f'exec "$@" 3<&{theirs_in} 4>&{theirs_out}',
                "bash",
                CHROMIUM,
                *self.OPTIONS.split(),
                f"--user-data-dir={folder}",
                "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1",
                "about:blank",
            ],
            pass_fds=[theirs_in, theirs_out],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(theirs_in)
        os.close(theirs_out)
        self._buffer = b""
        self._count = 0
        self._session = None
        self.events: list = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)[
            "sessionId"
        ]
        for domain in ("Network", "Runtime", "Page"):
            self.call(f"{domain}.enable")

    def call(self, method, **params):
        self._count += 1
        message = {"id": self._count, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._count:
                assert "error" not in answer, answer
                return answer["result"]
            self.events.append(answer)

    def _next(self):
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._in], [], [], 30.0)
            data = os.read(self._in, 1 << 20) if ready else b""
            assert data, "the browser has ended, or does not answer"
            self._buffer += data
        message, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(message)

    def value(self, expression):
        """What a JavaScript expression is on the page."""
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True)[
            "result"
        ].get("value")

    def until(self, expression, wanted, each=lambda: None):
        """Wait until an expression is so; the last value.

        Args:
            expression: JavaScript.
            wanted: told its value.
            each: called before each look.
        """

        def is_so():
            each()
            value = self.value(expression)
            return (value,) if wanted(value) else None

        return wait_until(is_so, 20.0, f"{expression} as wanted", pause=0.05)[0]

    def asked(self):
        """Addresses of all requests."""
        asked = [e for e in self.events if e["method"] == "Network.requestWillBeSent"]
        return {e["params"]["request"]["url"] for e in asked}

    def errors(self):
        """Exceptions, and what the console was told."""
        wrong = ("Runtime.exceptionThrown", "Runtime.consoleAPICalled")
        return [e["params"] for e in self.events if e["method"] in wrong]

    def screenshot(self, path) -> None:
        shot = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=True)
        path.write_bytes(base64.b64decode(shot["data"]))

    def close(self) -> None:
        os.close(self._out)
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._in)


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
def test_the_page_in_a_browser(tmp_path) -> None:
    """A loop that waits, runs, falls silent and stops; then the monitor itself goes.

    Expected: the page says each, draws all plots and moves them, asks nobody but this machine, and
    has no error.
    """
    loop, board = rings(tmp_path)
    loop_table, board_table = loop_rows(20000, begin=300), board_rows(20000)
    browser = Browser(tmp_path / "profile")
    begun, written = time.monotonic(), 0

    def write() -> None:
        nonlocal written
        due = min(5000 + round(1e3 * (time.monotonic() - begun)), len(board_table))
        for k in range(written, due):
            board.append(board_table[k])
            loop.append(loop_table[300 + k])
        written = due

    def text(id):
        return f"document.getElementById('{id}').textContent"

    def plot(id):
        return f"document.querySelector('#{id} .js-plotly-plot')"

    try:
        with start_monitor([loop.path, board.path], ROLES) as monitor:
            browser.call("Page.navigate", url=monitor.url)
            browser.until(text("banner"), lambda t: t == "Waiting for the loop (loop.ring)")
            begun = time.monotonic()
            seen = ""
            for _ in range(4):  # the first has whole figures, the next patch them
                seen = browser.until(
                    text("banner"),
                    lambda t, last=seen: t.startswith("Running") and t != last,
                    each=write,
                )
            tiles = browser.value(text("tiles"))
            assert re.search(r"(69|70)(\.\d+)? %reduction in band", tiles), tiles
            assert "validsensors, sample" in tiles
            assert "what sensors.lost says" in browser.value(text("counters"))
            assert browser.value("document.querySelectorAll('section:not([hidden])').length") == 5
            # Curves of patched figures are what the ring has, as drawn.
            written_to = browser.value(f"{plot('volts')}.calcdata[0].length")
            assert written_to > 500
            largest = browser.value(f"Math.max(...{plot('volts')}._fullData[0].y)")
            assert largest == pytest.approx(70.0, abs=0.1)
            assert (
                browser.value(
                    f"{plot('tip')}.querySelectorAll('.scatterlayer path.js-line').length"
                )
                == 6
            )
            assert browser.value(f"{plot('latency')}.querySelectorAll('.point path').length") > 20
            browser.until(
                text("banner"), lambda t: re.match(r"No data for \d+ s: the loop hangs", t)
            )
            loop.close()
            browser.until(text("banner"), lambda t: re.fullmatch(r"Stopped at \d+\.\d s", t))
            assert browser.value(text("no-answer")) == ""
            assert not browser.errors()
        browser.until(text("no-answer"), lambda t: t.startswith("The monitor no longer answers"))
    finally:
        browser.close()
    hosts = {urllib.parse.urlsplit(url).netloc for url in browser.asked() if "://" in url}
    assert hosts == {urllib.parse.urlsplit(monitor.url).netloc}
