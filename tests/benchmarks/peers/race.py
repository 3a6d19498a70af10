"""The race: run each peer's ladders, then repeat the best setting for each error."""

import statistics
import sys
from dataclasses import dataclass, field

import numpy as np

from peers._peer import Peer
from peers.lanes import Judged

TARGETS = (1e-3, 1e-4, 1e-6)
"""Targets for the larger relative error of period and impact velocity in the worst judged lane."""

REPEATS = 3
LONG = 8.0  # s: longer runs are not repeated
TOO_LONG = 40.0  # s: a ladder is not climbed further after a longer run


@dataclass
class Run:
    """A run of a peer at one setting.

    It has `times` [s per lane-second], the errors of the judged lanes, and the number of timed lanes.
    """

    setting: object
    lanes: int
    worst: float
    median: float
    times: list[float] = field(default_factory=list)

    @property
    def time(self) -> float:
        """Return the median of the repeats [s per lane-second]."""
        return statistics.median(self.times)

    @property
    def spread(self) -> float:
        """Return half the range of the repeats [s per lane-second]."""
        return (max(self.times) - min(self.times)) / 2


@dataclass
class Result:
    """A peer's runs; `compiling` [s]; `remark` says why runs are missing."""

    peer: Peer
    runs: list[Run] = field(default_factory=list)
    compiling: float = 0.0
    remark: str = ""

    def best(self, target: float) -> Run | None:
        """Return the fastest run within the error."""
        return min((run for run in self.runs if run.worst <= target), key=lambda run: run.time, default=None)

    def nearest(self) -> Run | None:
        """Return the most exact run."""
        return min(self.runs, key=lambda run: run.worst, default=None)


def raced(peer: Peer, judged: Judged, settle: float, observe: float, quick: bool = False) -> Result:
    """Return the results of a peer."""
    result = Result(peer, remark=peer.missing() or "")
    if result.remark:
        return result
    lanes = max(min(peer.lanes, 256), len(judged.period)) if quick else peer.lanes
    points = judged.points[np.arange(lanes)]

    def run(setting):
        ran = peer.run(points, setting, settle, observe, len(judged.period))
        result.compiling += ran.compiling
        return ran, ran.seconds / (lanes * (settle + observe))

    try:
        for ladder in peer.ladders(quick):
            for setting in ladder:
                ran, time = run(setting)
                errors = judged.errors(ran.period, ran.impact_velocity)
                found = Run(setting, lanes, float(errors.max()), float(np.median(errors)), [time])
                result.runs.append(found)
                _tell(peer, found)
                if found.worst <= TARGETS[-1] or ran.seconds > TOO_LONG:
                    break
        # A run may be fast by chance, so the best run is repeated, and so is its replacement.
        while again := [
            one for target in TARGETS if (one := result.best(target)) and _wants_more(one, settle + observe, quick)
        ]:
            again[0].times.append(run(again[0].setting)[1])
    except Exception as error:  # a peer that fails stays in the table, and the others continue
        result.remark = f"failed: {type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}"
    finally:
        peer.close()
    return result


def _wants_more(run: Run, seconds: float, quick: bool) -> bool:
    """Return whether the run has too few repeats and is short enough for more."""
    return len(run.times) < (1 if quick else REPEATS) and run.time * run.lanes * seconds < LONG


def _tell(peer, run):
    text = f"{peer.name}: {run.setting}: {1e6 * run.time:.3g} µs, worst {run.worst:.1e}, median {run.median:.1e}"
    print(text, file=sys.stderr, flush=True)
