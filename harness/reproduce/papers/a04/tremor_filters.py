"""A04 figure 5.5, and tremor filters ranked: how much of a hand's tremor each of them finds."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import astuple

import numpy as np

from harness.common.figures import Figure
from harness.recordings.motion import recordings
from harness.report.page import Plot
from harness.report.plots import GREY, SERIES, grid, line
from harness.reproduce.experiments.ceilings import (
    EAGER,
    OTHERS,
    SAME_DATA,
    SAME_RECORDING,
    eager,
    others,
    same_data,
    same_recording,
)
from harness.reproduce.experiments.ranking import LOWEST, ranking
from harness.reproduce.experiments.tremor import (
    DELAYS,
    RATE,
    FilterScores,
    TipMotion,
    disturbance,
    filters,
    generated,
    intents,
    recorded,
    score,
)
from harness.reproduce.item import Context, Item, ItemResult, Row, figures_of

ScoresByDelay = Mapping[str, Mapping[float, FilterScores]]
"""Scores by filter and delay [s]."""
SOURCE = "A04 figure 5.5"
HANDS = "hand_motion_m2s2"
PAPER = {"WflcFlc": 69.0}
"""Reduction of the rms a-posteriori in the experiment behind the figure (A04 5.2.1) [%]."""
SHOWN = (8.0, 10.0)
"""Of a recording [s]."""
DEFINITIONS = ("a-posteriori", "in-band")


def run(context: Context) -> ItemResult:
    """Run every filter on recorded and generated hands and on intent, and compute the ceilings."""
    context.progress(0.0, "motions")
    hands = [recorded(path) for path in recordings([context.recordings(HANDS)])]
    artificial = generated()
    without = list(intents())
    known = filters()

    todo = sum(len(each.delays) * (len(hands) + 1) + len(without) for each in known.values())
    ranks: dict[str, dict[float, FilterScores]] = {name: {} for name in known}
    tones: dict[str, dict[float, FilterScores]] = {name: {} for name in known}
    disturbances: dict[str, dict[str, float]] = {}
    shown: dict[str, np.ndarray] = {}
    done = 0

    def tremor(name: str, motion: TipMotion, delay: float = 0.0) -> np.ndarray:
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
            ranks[name][delay] = FilterScores(scores)
            tones[name][delay] = FilterScores([score(artificial, tremor(name, artificial, delay))])
        disturbances[name] = {
            motion.name: disturbance(motion, tremor(name, motion)) for motion in without
        }
    ceilings = _ceilings(hands, context)
    context.progress(0.98, "plots")
    best = max(ranks, key=lambda name: ranks[name][0.0].mean.a_posteriori)
    return ItemResult(
        figures=(
            *_figures(ranks, f"{len(hands)} recorded hands", ("mean", "worst")),
            *_figures(ceilings, "recorded hands"),
            *_figures(tones, "generator", ("",)),
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


def _ceilings(hands: list[TipMotion], context: Context) -> dict[str, dict[float, FilterScores]]:
    ways = {SAME_DATA: same_data, SAME_RECORDING: same_recording, OTHERS: others}
    if len(hands) < 2:
        del ways[OTHERS]
    found: dict[str, dict[float, FilterScores]] = {}
    for index, (name, way) in enumerate(ways.items()):
        found[name] = {}
        for k, delay in enumerate(DELAYS):
            share = 0.75 + 0.15 * (index + k / len(DELAYS)) / len(ways)
            context.progress(share, f"{name}, {1e3 * delay:g} ms")
            found[name][delay] = way(hands, delay)
    context.progress(0.9, EAGER)
    found[EAGER] = {0.0: eager(hands)}
    return found


def _figures(
    found: ScoresByDelay, setting: str, statistics: Iterable[str] = ("mean",)
) -> list[Figure]:
    """Return reductions by both definitions, at each delay; no statistic is named for one motion.

    Args:
        found: scores by filter or ceiling.
        setting: motions that they are of.
        statistics: `mean` and `worst` over the motions; empty text for a single motion.
    """
    figures: list[Figure] = []
    for name, by_delay in found.items():
        for delay, column in by_delay.items():
            delayed = f"{1e3 * delay:g} ms of delay" if delay else "no delay"
            rows: list[Row] = []
            for statistic in statistics:
                score = getattr(column, statistic or "mean")
                beside = f", {statistic}" if statistic else ""
                for definition, value in zip(DEFINITIONS, astuple(score), strict=True):
                    quoted = (definition, statistic, delay) == (DEFINITIONS[0], "mean", 0.0)
                    paper = PAPER.get(name) if quoted else None
                    rows.append((f"reduction {definition}{beside}: {name}", "%", paper, value))
            figures += figures_of(SOURCE, f"{setting}, {delayed}", rows)
    return figures


def _intent_figures(disturbances: Mapping[str, Mapping[str, float]]) -> Iterator[Figure]:
    for name, each in disturbances.items():
        row = f"disturbance of intent: {name}"
        for motion, value in each.items():
            yield from figures_of(SOURCE, motion, [(row, "%", None, value)])


def _bars(ranks: ScoresByDelay, ceilings: ScoresByDelay) -> Plot:
    ranked = dict(sorted(ranks.items(), key=lambda entry: entry[1][0.0].mean.a_posteriori))
    marks = {name: columns for name, columns in ceilings.items() if name != EAGER}
    rows = {
        name: [astuple(columns[0.0].mean), astuple(columns[0.0].worst)]
        for name, columns in {**ranked, **dict(reversed(list(marks.items())))}.items()
    }
    return Plot(
        "Filters and ceilings",
        "Reduction of recorded tremor without delay by both definitions: filters in colour, "
        f"ceilings in grey. What is below {LOWEST:g} % leaves the plot.",
        ranking(rows, DEFINITIONS, grey=marks),
    )


def _over_time(motion: TipMotion, name: str, found: np.ndarray) -> Plot:
    shown = slice(*(round(RATE * end) for end in SHOWN))
    time = motion.time[shown]
    panels = []
    for wanted, given in zip(1e6 * motion.target[shown].T, 1e6 * found[shown].T, strict=True):
        curves = (
            line(time, wanted, GREY, "target", dash="dot"),
            line(time, given, SERIES[0], name),
            line(time, wanted - given, SERIES[1], "what is left"),
        )
        panels.append([curves])
    plot = grid(panels, "time, s", ["x, µm", "y, µm", "z, µm"], 560)
    return Plot(
        f"{name} on {motion.name}",
        "The target of the a-posteriori definition, which knows the future, the output of the "
        "best filter, which does not, and the difference; no delay.",
        plot,
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
