"""Write the table of detection power into `docs/recordings.md`.

    python -m tests.harness.recordings.detection_power

For each defect, the least of some sizes that is found in 95 of 100 recordings drawn from seeds, and
how many recordings without a defect get a finding.
"""

from pathlib import Path

import numpy as np

from harness.recordings.motion_quality import assess_motion
from tests.harness.recordings import hands

PAGE = Path(__file__).parents[3] / "docs" / "recordings.md"
BEGIN, END = "<!-- detection power -->", "<!-- end of detection power -->"
TRIALS, WANTED = 100, 95

SIZES = {
    "noisy-clock": ("rms of the stamps' noise", "us", 1e6, [10, 20, 30, 40, 50, 100]),
    "uneven-clock": ("rms of the unevenness", "us", 1e6, [10, 20, 30, 40, 50, 100]),
    "glitch": ("one sample off", "um", 1e6, [2, 3, 4, 5, 6, 8]),
    "jump": ("all later samples off", "um", 1e6, [3, 4, 5, 6, 8, 10, 12]),
    "stuck-axis": ("an axis keeps its value", "ms", 1e3, [50, 100, 150, 200, 210, 250]),
    "clipped": ("cut off at either end of an axis", "% of its range", 1e2, [0.1, 0.2, 0.5, 1, 2]),
    "held-samples": ("rows for each sample", "rows", 1, [2, 3, 4]),
    "lost-samples": ("lost at random", "samples", 1, [1, 2, 5]),
}
"""What is measured, its unit, units in one of the generator's, and sizes in that unit."""


def found(name: str, size: float, seed: int) -> bool:
    """Return whether a defect of some size is found in the recording of a seed."""
    insert = hands.DEFECTS[name][0]
    time, position = insert(*hands.draw_hand(seed), size, np.random.default_rng(1000 + seed))
    return name in {finding.name for finding in assess_motion(time, position, str).findings}


def least_size(name: str) -> tuple[float, int]:
    """Return the least size that is found often enough, and how often."""
    _, _, factor, sizes = SIZES[name]
    for size in sizes:
        hits = sum(found(name, size / factor, seed) for seed in range(TRIALS))
        if hits >= WANTED:
            return size, hits
    raise AssertionError(f"{name}: no size up to {sizes[-1]} is found {WANTED} times")


def false_alarms() -> int:
    """Return how many recordings without a defect get a finding."""
    return sum(
        bool(assess_motion(*hands.draw_hand(seed, rate=rate), str).findings)
        for seed in range(TRIALS)
        for rate in (62.5, 250.0, 1000.0)
    )


def table() -> str:
    """Return the table as Markdown."""
    rows = ["| finding | defect | least size found | of 100 |", "| --- | --- | --- | --- |"]
    for name, (what, unit, _, _) in SIZES.items():
        size, hits = least_size(name)
        rows.append(f"| `{name}` | {what} | {size:g} {unit} | {hits} |")
    alarms = f"Of {3 * TRIALS} recordings without a defect, {false_alarms()} have a finding."
    return "\n".join([*rows, "", alarms])


def main() -> None:
    """Write the table into the page."""
    text = PAGE.read_text(encoding="utf-8")
    head, rest = text.split(BEGIN)
    tail = rest.split(END)[1]
    PAGE.write_text(f"{head}{BEGIN}\n{table()}\n{END}{tail}", encoding="utf-8")


if __name__ == "__main__":
    main()
