"""Variants of a scenario compared: mean and worst of each over its runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from harness.common.figures import Figure

if TYPE_CHECKING:
    from harness.results.metrics import Metric

__all__ = ["RANKED", "VariantSummary", "summarise_variants"]

RANKED = ("reduction_a_posteriori", "reduction_in_band")
"""What variants are ranked by: the first, with the others beside it."""


@dataclass(frozen=True)
class VariantSummary:
    """One variant.

    Attributes:
        variant: its name.
        runs: how many there are.
        mean: of each figure of RANKED [%].
        worst: the least [%].
    """

    variant: str
    runs: int
    mean: Mapping[str, float]
    worst: Mapping[str, float]

    def figures(self, source: str, setting: str = "") -> list[Figure]:
        """Mean and worst of each figure, as a list that JSON holds.

        Args:
            source: where they come from.
            setting: what the runs were, beside their number.
        """
        runs = f"{self.runs} run{'s' if self.runs > 1 else ''}"
        return [
            Figure(
                source,
                f"{name.replace('_', ' ')}, {which}: {self.variant}",
                "%",
                None,
                values[name],
                f"{setting}, {runs}" if setting else runs,
            )
            for which, values in (("mean", self.mean), ("worst", self.worst))
            for name in RANKED
        ]


def summarise_variants(
    variants: Mapping[str, Sequence[Mapping[str, Metric]]],
) -> list[VariantSummary]:
    """Ranks of the variants, the best mean first; runs without all figures are left out.

    Args:
        variants: metrics of the runs of each variant.
    """
    found = []
    for variant, runs in variants.items():
        whole = [run for run in runs if all(name in run for name in RANKED)]
        if not whole:
            continue
        values = {name: [run[name].value for run in whole] for name in RANKED}
        mean = {name: sum(each) / len(each) for name, each in values.items()}
        worst = {name: min(each) for name, each in values.items()}
        found.append(VariantSummary(variant, len(whole), mean, worst))
    return sorted(found, key=lambda rank: -rank.mean[RANKED[0]])
