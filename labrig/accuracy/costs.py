"""What was measured of the cost of accuracy: runs, their front, and the verdict on choices."""

from __future__ import annotations

import csv
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Literal


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One method at one setting: the worst order's relative rms error, and what it cost.

    Attributes
    ----------
    worst_order : the one whose error it is
    tolerance, stated : of an automatic choice, what was asked for and the error it claims
    """

    method: str
    setting: str
    cpu_s: float
    error: float
    worst_order: int = 0
    tolerance: float | None = None
    stated: float | None = None
    on_front: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Witness:
    """One order of the truth beside the Monte Carlo: rms difference, rms standard error."""

    order: int
    difference: float
    noise: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """An automatic choice beside the cheapest setting tried that meets its tolerance.

    Undecided is what differs from the tolerance by less than the truth is known to.
    """

    tolerance: float
    outcome: Literal["met", "missed", "undecided"]
    cheapest: Run | None
    ratio: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Costs:
    """Everything measured on one scene.

    Attributes
    ----------
    truth_error : relative, of orders from the third, which no closed form gives
    notes : what was left out and why
    """

    scene: str
    orders: int
    truth_error: float
    runs: list[Run]
    witnesses: list[Witness]
    notes: list[str]

    def verdicts(self) -> list[Verdict]:
        """Return the automatic choices, loose to tight, each against the cheapest good enough."""
        tried = [run for run in self.runs if run.tolerance is None]
        found = []
        chosen = [(run.tolerance, run) for run in self.runs if run.tolerance is not None]
        for tolerance, run in sorted(chosen, key=lambda pair: -pair[0]):
            enough = [other for other in tried if other.error <= tolerance]
            least = min(enough, key=lambda other: other.cpu_s, default=None)
            found.append(
                Verdict(
                    tolerance=tolerance,
                    outcome=self._outcome(run.error, tolerance),
                    cheapest=least,
                    ratio=run.cpu_s / least.cpu_s if least else None,
                )
            )
        return found

    def _outcome(self, error: float, tolerance: float) -> Literal["met", "missed", "undecided"]:
        if abs(error - tolerance) < self.truth_error:
            return "undecided"
        return "met" if error < tolerance else "missed"


def with_front(runs: list[Run]) -> list[Run]:
    """Mark the runs that no other beats in both error and time."""
    marked, least = [], float("inf")
    for run in sorted(runs, key=lambda run: (run.cpu_s, run.error)):
        marked.append(replace(run, on_front=run.error < least))
        least = min(least, run.error)
    return marked


def write_csv(costs: Costs, path: Path) -> None:
    """Write every run as a line."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Run)])
        writer.writeheader()
        writer.writerows(asdict(run) for run in costs.runs)
