"""The lanes of the race: a shuffled grid over the box, which begins with the lanes whose errors are judged."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from peers._peer import Points
from vibrojax.lanes.run import LaneRun
from vibrojax.maps.read import read_sweep
from vibrojax.studies.accuracy_programs import REFERENCE, SECOND_REFERENCE

BOX = {"beta": (0.25, 0.6), "gamma": (0.6, 0.8), "v": (0.5, 2.0), "delta": (-0.005, 0.01)}
AXIS = 8
"""Number of values of each parameter: 4096 points."""

SETTLED = 1e-9
"""Largest relative difference between the observation and the next one at which a lane counts as settled."""


@dataclass(frozen=True)
class Judged:
    """Lanes with their reference values.

    `points` are all lanes, the judged ones first; `period` and `impact_velocity` (judged,) are the reference's.
    `spread` is the largest difference between two references. `settled` is the share of candidates that had settled.
    """

    points: Points
    period: np.ndarray
    impact_velocity: np.ndarray
    spread: float
    settled: float

    def errors(self, period: np.ndarray, impact_velocity: np.ndarray) -> np.ndarray:
        """Return the larger of both relative errors (judged,), infinite for missing values."""
        pairs = ((period, self.period), (impact_velocity, self.impact_velocity))
        both = [np.abs(found[: len(known)] / known - 1) for found, known in pairs]
        return np.nan_to_num(np.maximum(*both), nan=np.inf)


def box() -> Points:
    """Return the box's grid in a fixed random order."""
    grid = np.array(list(product(*(np.linspace(*ends, AXIS) for ends in BOX.values()))))
    return Points(*np.random.default_rng(1).permutation(grid).T)


def columns(points: Points) -> dict[str, list]:
    """Return the points in the form of a sweep."""
    names = zip(BOX, points.columns, strict=True)
    return {name: column.tolist() for name, column in names} | {"start": ["stuck"] * len(points)}


def judged(candidates: int, number: int, settle: float, observe: float, settled: float = SETTLED) -> Judged:
    """Return the lanes, and the reference values of the first `number`.

    These are the first of the `candidates` that repeat after one return and impact. They have settled long before the
    observation (to `settled`), and two references agree on them.
    """
    points = box()
    some = points[np.arange(candidates)]
    first, second, later = (
        _fine(some, accuracy, begin, observe)
        for accuracy, begin in ((REFERENCE, settle), (SECOND_REFERENCE, settle), (REFERENCE, settle + observe))
    )
    names = ("period", "impact_velocity")
    with np.errstate(invalid="ignore"):
        after = np.max([np.abs(later[name] / first[name] - 1) for name in names], axis=0)
        spread = np.max([np.abs(second[name] / first[name] - 1) for name in names], axis=0)
    good = (first["cycles"] == 1) & (later["cycles"] == 1) & (first["impacts"] == later["impacts"])
    good &= (first["settling_time"] < settle / 2) & (after < settled) & (spread < settled)
    chosen = np.flatnonzero(good)[:number]
    others = np.setdiff1d(np.arange(len(points)), chosen)
    ordered = points[np.concatenate([chosen, others])]
    return Judged(ordered, *(first[name][chosen] for name in names), float(spread[chosen].max()), float(good.mean()))


def _fine(points: Points, accuracy, settle: float, observe: float) -> dict:
    run = {"settle": settle, "observe": observe, "end_early": False, "chunk": len(points)}
    sweep = read_sweep({"scene": "vibro-impact", "points": columns(points), "run": run})
    return LaneRun(sweep.inputs(), sweep.plan).at(sweep.inputs(), accuracy)
