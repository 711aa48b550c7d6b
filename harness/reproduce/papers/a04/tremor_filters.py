"""A04 figure 5.5, and tremor filters ranked: how much of a hand's tremor each of them finds."""

from __future__ import annotations

from typing import TYPE_CHECKING

from harness.common.figures import Figure
from harness.reproduce.item import Context, Item, ItemResult

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import numpy as np

    from harness.report.page import Plot
    from harness.reproduce.experiments.tremor import Column, Filter, Motion

    Columns = Mapping[str, Mapping[float, Column]]  # by filter and delay

SOURCE = "A04 figure 5.5"
HANDS = "hand_motion_m2s2"
PAPER = {"WflcFlc": 69.0}
"""Reduction of the rms a-posteriori in the experiment behind the figure (A04 5.2.1) [%]."""
SHOWN = (8.0, 10.0)
"""Of a recording [s]."""
DEFINITIONS = ("a-posteriori", "in-band")


def run(context: Context) -> ItemResult:
    """Run every filter on recorded and generated hands and on intent, and compute the ceilings."""
    from harness.recordings.motion import recordings
    from harness.reproduce.experiments.tremor import (
        DELAYS,
        Column,
        disturbance,
        filters,
        generated,
        intents,
        recorded,
        score,
    )  # fmt: skip

    context.progress(0.0, "motions")
    hands = [recorded(path) for path in recordings([context.recordings(HANDS)])]
    artificial = generated()
    without = list(intents())
    known = filters()

    todo = sum(len(each.delays) * (len(hands) + 1) + len(without) for each in known.values())
    ranks: dict[str, dict[float, Column]] = {name: {} for name in known}
    tones: dict[str, dict[float, Column]] = {name: {} for name in known}
    disturbances: dict[str, dict[str, float]] = {}
    shown: dict[str, np.ndarray] = {}
    done = 0

    def tremor(name: str, motion: Motion, delay: float = 0.0) -> np.ndarray:
        nonlocal done
        context.progress(0.75 * done / todo, f"{name}, {motion.name}, {1e3 * delay:g} ms")
        done += 1
        return known[name].tremor(motion, delay)

    for name, each in known.items():
        for delay in each.delays:
            scores = []
            for motion in hands:
                found = tremor(name, motion, delay)
                scores.append(score(motion, found))
                if delay == 0.0 and motion is hands[0]:
                    shown[name] = found
            ranks[name][delay] = Column(scores)
            tones[name][delay] = Column([score(artificial, tremor(name, artificial, delay))])
        disturbances[name] = {
            motion.name: disturbance(motion, tremor(name, motion)) for motion in without
        }
    ceilings = _ceilings(hands, DELAYS, lambda share, what: context.progress(share, what))
    context.progress(0.98, "plots")
    best = max(ranks, key=lambda name: ranks[name][0.0].mean.a_posteriori)
    return ItemResult(
        figures=(
            *_figures(known, ranks, len(hands)),
            *_ceiling_figures(ceilings),
            *_tone_figures(tones),
            *_intent_figures(disturbances),
        ),
        plots=(_bars(ranks, ceilings), _over_time(hands[0], best, shown[best])),
        notes=(
            "Reductions of tremor in per cent, in the signal alone: every filter sees the ideal "
            "position, raw and sample by sample, and nothing is cancelled. A-posteriori is "
            "against a target, the zero-phase band-pass of 6 to 15 Hz of the position: "
            "1 - std(target - output) / std(target). In-band is what is left between 6 and 16 Hz: "
            "1 - std(bp(position - output)) / std(bp(position)). Mean over the axes, from 3 s to "
            "0.5 s before the end of each recording.",
            "Each definition alone can be gamed. A filter that calls everything tremor leaves "
            "nothing in the band, and the instrument would not follow the surgeon; in-band does "
            "not see it, a-posteriori does. A-posteriori alone prefers a filter that says little "
            "where it is not sure. Only both make a rank, with the disturbance of intent: the rms "
            "of the output in a motion without tremor, over that of the motion about its mean.",
            "With a delay, the output that is compared has been computed that long ago, with the "
            "filter's horizon set to it. Filters without a horizon stand at no delay only. Flc "
            "and Wflc expect a prefiltered input and get none here: theirs is what a combiner "
            "does by itself.",
            "The ceilings, linear filters of 0.5 s, know what no filter in an instrument does: "
            "they are fitted to the data that are scored, or trained on the first 60 % of the "
            "same recording and scored on the rest, or trained on all other recordings. Their "
            "limit is the future of the hand. With lags of 1 ms, shorter than the 4 ms of "
            "the recordings, one finds the next sample in the spline between the samples: what it "
            "gains is no skill. A filter above the ceilings has to be looked at for that first.",
            "The thesis gives 69 % as the average of an experiment in one dimension, against a "
            "zero-phase low-pass, on recordings that are not public. The generator's tremor is a "
            "tone that wanders over 8 to 12 Hz, as these filters presume it; hands differ, and "
            "its figures are never to be quoted alone.",
        ),
    )


def _ceilings(
    hands: list[Motion], delays: tuple[float, ...], progress: Callable[[float, str], None]
) -> dict[str, dict[float, Column]]:
    from harness.reproduce.experiments.ceilings import (
        EAGER,
        OTHERS,
        SAME_DATA,
        SAME_RECORDING,
        eager,
        others,
        same_data,
        same_recording,
    )  # fmt: skip

    ways = {SAME_DATA: same_data, SAME_RECORDING: same_recording, OTHERS: others}
    if len(hands) < 2:
        del ways[OTHERS]
    found: dict[str, dict[float, Column]] = {}
    for index, (name, way) in enumerate(ways.items()):
        found[name] = {}
        for k, delay in enumerate(delays):
            share = 0.75 + 0.15 * (index + k / len(delays)) / len(ways)
            progress(share, f"{name}, {1e3 * delay:g} ms")
            found[name][delay] = way(hands, delay)
    progress(0.9, EAGER)
    found[EAGER] = {0.0: eager(hands)}
    return found


def _delayed(delay: float) -> str:
    return f"{1e3 * delay:g} ms of delay" if delay else "no delay"


def _figures(known: Mapping[str, Filter], ranks: Columns, count: int) -> list[Figure]:
    return [
        Figure(
            SOURCE,
            f"reduction {definition}, {which}: {name}",
            "%",
            PAPER.get(name)
            if (definition, which, delay) == ("a-posteriori", "mean", 0.0)
            else None,
            value,
            f"{count} recorded hands, {_delayed(delay)}",
        )
        for name in known
        for delay, column in ranks[name].items()
        for which, score in (("mean", column.mean), ("worst", column.worst))
        for definition, value in zip(DEFINITIONS, (score.a_posteriori, score.in_band), strict=True)
    ]


def _ceiling_figures(ceilings: Columns) -> list[Figure]:
    return [
        Figure(
            SOURCE,
            f"reduction {definition}, mean: {name}",
            "%",
            None,
            value,
            f"recorded hands, {_delayed(delay)}",
        )
        for name, columns in ceilings.items()
        for delay, column in columns.items()
        for definition, value in zip(
            DEFINITIONS, (column.mean.a_posteriori, column.mean.in_band), strict=True
        )
    ]


def _tone_figures(tones: Columns) -> list[Figure]:
    return [
        Figure(
            SOURCE,
            f"reduction {definition}: {name}",
            "%",
            None,
            value,
            f"generator, {_delayed(delay)}",
        )
        for name, columns in tones.items()
        for delay, column in columns.items()
        for definition, value in zip(
            DEFINITIONS, (column.mean.a_posteriori, column.mean.in_band), strict=True
        )
    ]


def _intent_figures(disturbances: Mapping[str, Mapping[str, float]]) -> list[Figure]:
    return [
        Figure(
            SOURCE,
            f"disturbance of intent: {name}",
            "%",
            None,
            value,
            motion,
        )
        for name, each in disturbances.items()
        for motion, value in each.items()
    ]


def _bars(ranks: Columns, ceilings: Columns) -> Plot:
    from harness.report.page import Plot
    from harness.reproduce.experiments.ceilings import EAGER
    from harness.reproduce.experiments.ranking import LOWEST, ranking

    ranked = dict(sorted(ranks.items(), key=lambda entry: entry[1][0.0].mean.a_posteriori))
    marks = {name: columns for name, columns in ceilings.items() if name != EAGER}
    rows = {
        name: [(s.a_posteriori, s.in_band) for s in (columns[0.0].mean, columns[0.0].worst)]
        for name, columns in {**ranked, **dict(reversed(list(marks.items())))}.items()
    }
    return Plot(
        "Filters and ceilings",
        "Reduction of recorded tremor without delay by both definitions: filters in colour, "
        f"ceilings in grey. What is below {LOWEST:g} % leaves the plot.",
        ranking(rows, DEFINITIONS, grey=marks),
    )


def _over_time(motion: Motion, name: str, found: np.ndarray) -> Plot:
    from plotly.subplots import make_subplots

    from harness.report.page import Plot
    from harness.report.plots import GREY, SERIES, layout, line
    from harness.reproduce.experiments.tremor import RATE

    plot = make_subplots(rows=3, cols=1, shared_xaxes=True, vertical_spacing=0.06)
    shown = slice(*(round(RATE * end) for end in SHOWN))
    time = motion.time[shown]
    for axis in range(3):
        wanted, given = 1e6 * motion.target[shown, axis], 1e6 * found[shown, axis]
        for curve in (
            line(time, wanted, GREY, "target", axis == 0, dash="dot"),
            line(time, given, SERIES[0], name, axis == 0),
            line(time, wanted - given, SERIES[1], "what is left", axis == 0),
        ):
            plot.add_trace(curve, row=axis + 1, col=1)
        plot.update_yaxes(title_text=f"{'xyz'[axis]}, µm", row=axis + 1, col=1)
    plot.update_xaxes(title_text="time, s", row=3, col=1)
    return Plot(
        f"{name} on {motion.name}",
        "The target of the a-posteriori definition, which knows the future, the output of the "
        "best filter, which does not, and the difference; no delay.",
        layout(plot, 560),
    )


ITEM = Item(
    name="tremor-filters",
    source=SOURCE,
    title="Tremor filters on recorded hands, against what a trained linear filter reaches",
    group="tremor",
    run=run,
    recordings=(HANDS,),
    aliases=("figure-5.5",),
)
