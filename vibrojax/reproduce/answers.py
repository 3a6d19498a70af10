"""Execution of the computations that results and pictures require (*needs*).

The values computed for a need are called its *answer*. Lanes (single trajectories) with equal settings are computed
together in one sweep. Each map is a sweep of its own, and motions are simulated one at a time.
"""

import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from vibrojax.analyses.sweep.run import run_sweep
from vibrojax.errors import InputError, Place
from vibrojax.reproduce.needs import Labelled, LaneNeed, Map, MotionNeed, Need, StruckMass, starts_of
from vibrojax.reproduce.struck_mass import Blows, strike
from vibrojax.sweep.input.read import read_point
from vibrojax.sweep.input.values import UnusualValue
from vibrojax.sweep.simulation import simulate

PROBED_LANES = 8
"""Approximate number of lanes per sweep that are first simulated for two seconds, to detect a failing scene early."""
MAX_FAILED_SHARE = 0.25
"""Fraction of the probed lanes that may fail. With wrong equations, every lane would run out of steps after minutes."""

Features = dict[str, Any]
"""Parameters and variables by name: scalars of one lane, or arrays of several lanes."""


@dataclass(frozen=True)
class Unanswered:
    """A failed computation: stands for its result; `reason` explains why there is none."""

    reason: str


Answer = Features | xr.Dataset | Blows | Unanswered


class _Kind(NamedTuple):
    """Settings shared by lanes that are computed in one sweep; `names` are the string-valued parameters."""

    scene: str
    names: tuple[tuple[str, str], ...]
    settle: float
    observe: float


_Point = tuple[tuple[str, float], ...]
"""The numeric parameters of a lane."""


class SourceAnswers:
    """The results of computations (`needs`), by computation. All are computed on construction.

    `datasets` holds, by name, the datasets of sweeps and maps. If too many probed lanes of a scene fail, the scene is
    not computed, and the results of all its computations are `Unanswered`.

    **Arguments:**

    - `needs`: the computations to run; equal ones run only once.
    - `report`: function that receives a line of text before each sweep, map and motion, with its number and the total.
    """

    def __init__(self, needs: Iterable[Need], report: Callable[[str], None] = lambda line: None) -> None:
        self.datasets: dict[str, xr.Dataset] = {}
        self._answers: dict[Need, Answer] = {}
        self._failing: set[str] = set()
        self._report = report
        self._parts_begun = 0
        needs = list(dict.fromkeys(needs))
        kinds: dict[_Kind, list[LaneNeed]] = {}
        for lane in (need for need in needs if isinstance(need, LaneNeed)):
            names = tuple((name, value) for name, value in lane.parameters if isinstance(value, str))
            kinds.setdefault(_Kind(lane.scene, names, lane.settle, lane.observe), []).append(lane)
        maps = [need for need in needs if isinstance(need, Map)]
        motions = [need for need in needs if isinstance(need, MotionNeed)]
        self._parts = len(kinds) + len(maps) + len(motions)
        for kind, lanes in kinds.items():
            self._run_lanes(kind, lanes)
        for need in maps:  # before the motions, since a map takes longer than a motion
            self._answers[need] = self._refusal(need.scene) or self._run_map(need)
        for motion in motions:
            self._answers[motion] = self._refusal(motion.scene) or self._simulate(motion)
        for mass in (need for need in needs if isinstance(need, StruckMass)):
            self._answers[mass] = strike(mass.start, mass.duration, dict(mass.parameters))

    def __getitem__(self, need: Need) -> Answer:
        return self._answers[need]

    def _begin_part(self, text: str) -> None:
        self._parts_begun += 1
        self._report(f"{self._parts_begun:3d}/{self._parts}  {text}")

    def _refusal(self, scene: str) -> Unanswered | None:
        return Unanswered(f"points of the scene {scene} fail") if scene in self._failing else None

    def _run_lanes(self, kind: _Kind, lanes: list[LaneNeed]) -> None:
        points = list(dict.fromkeys(_numbers(lane) for lane in lanes))
        names = [value for _, value in kind.names]
        self._begin_part(f"{' '.join([kind.scene, *names])}: {len(points)} points, {kind.settle:g} s")
        if kind.scene not in self._failing:
            probes = points[:: max(1, len(points) // PROBED_LANES)]
            probed = _run_points(kind._replace(settle=1.0, observe=1.0), probes)
            self._failing |= {kind.scene} if (probed.status == 1).mean() > MAX_FAILED_SHARE else set()
        if refusal := self._refusal(kind.scene):
            self._answers |= dict.fromkeys(lanes, refusal)
            return
        dataset = _run_points(kind, points)
        self._keep("-".join([kind.scene, *names, f"{kind.settle:g}s"]), dataset)
        for lane in lanes:
            row = dataset.isel(point=points.index(_numbers(lane)))
            self._answers[lane] = _features(lane, row.sel(start=lane.start) if starts_of(kind.scene) else row)

    def _run_map(self, need: Map) -> xr.Dataset:
        self._begin_part(f"{need.name}: {np.prod([len(values) for _, values in need.axes])} points")
        axes = {name: list(values) for name, values in need.axes}
        dataset = _run(need, need.name, dict(need.parameters), grid=axes)
        self._keep(need.name.replace(" ", "-"), dataset)
        return dataset

    def _simulate(self, need: MotionNeed) -> xr.Dataset | Unanswered:
        self._begin_part(f"motion: {need.scene}, {need.duration:g} s")
        settings: dict[str, Any] = {"duration": need.duration, "sampling": need.sampling, "progress": False}
        if starts_of(need.scene):
            settings["start"] = need.start
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UnusualValue)
                return simulate(need.scene, **settings, **dict[str, Any](need.parameters))
        except InputError as problem:  # too many steps: this does not invalidate the other results
            return Unanswered(str(problem))

    def _keep(self, name: str, dataset: xr.Dataset) -> None:
        """Store a dataset under `name`; append a number if datasets with this name are already stored."""
        count = sum(other.partition("--")[0] == name for other in self.datasets)
        self.datasets[f"{name}--{count + 1}" if count else name] = dataset


def collect(needs: tuple[Labelled, ...], answers: list[Answer]) -> dict[str, Any]:
    """Return computed values as variables, by name, for the expressions of a row of `results.csv` or of a picture.

    `answers`: the computed values of each of the `needs`, in the same order.

    The lanes with one label form one dictionary of features, whose values are arrays if there are several lanes. Lanes
    without a label are named `lanes`, and each of their features is also a variable of its own. Motions without a label
    are the list `motions`, and `motion` is the first of them. `map` and `maps`, `mass` and `masses` follow the same
    rule.
    """
    names: dict[str, Any] = {}
    groups: dict[str, list[Any]] = {}
    for (label, need), answer in zip(needs, answers, strict=True):
        kind = {LaneNeed: "lanes", MotionNeed: "motion", Map: "map", StruckMass: "mass"}[type(need)]
        groups.setdefault(label or kind, []).append(answer)
    for name, group in groups.items():
        if isinstance(group[0], dict):
            common = [key for key in group[0] if all(key in lane for lane in group)]
            arrays = {key: np.array([lane[key] for lane in group]) for key in common}
            names[name] = group[0] if len(group) == 1 else arrays
            names |= names[name] if name == "lanes" else {}
        else:
            names[name], names[{"mass": "masses"}.get(name, f"{name}s")] = group[0], group
    return names


def _features(lane: LaneNeed, row: xr.Dataset) -> Features:
    """Return the parameters and variables of a lane, and some variables also converted to the source's units."""
    scalars = {str(name): variable.values.item() for name, variable in row.variables.items() if not variable.ndim}
    features: Features = scalars | dict(lane.parameters)
    if "regime" in features:
        features["regime"] = row["regime"].attrs["flag_meanings"].split()[features["regime"]]
        features["single"] = features["regime"] == "single-impact"
    if "period" in features:
        features["hertz"], features["omega"] = 1 / features["period"], 2 * np.pi / features["period"]
    if "impact_velocity" in features:  # the contact is lossless: the velocity is reversed
        features["velocity_change"] = 2 * features["impact_velocity"]
    if "peak_impact_force" in features:
        features["impact_kN"] = features["peak_impact_force"] / 1e3
    if "rate_of_penetration" in features:
        features["rate"] = 1e3 * features["rate_of_penetration"]
    return features


def _numbers(lane: LaneNeed) -> _Point:
    """Return the numeric parameters of a lane."""
    return tuple((name, value) for name, value in lane.parameters if not isinstance(value, str))


def _run_points(kind: _Kind, points: list[_Point]) -> xr.Dataset:
    """Run a sweep of points and return its dataset; a parameter that a point omits has the scene's default."""
    defaults = read_point(Place("reproduce"), kind.scene, dict(kind.names), None).parameters
    varied = dict.fromkeys(name for point in points for name, _ in point) or ("m1",)
    columns = {name: [float(dict(point).get(name, defaults[name])) for point in points] for name in varied}
    return _run(kind, f"The source, reproduced: points of the scene {kind.scene}", dict(kind.names), points=columns)


def _run(kind: _Kind | Map, title: str, parameters: dict[str, Any], **axes: dict[str, list[float]]) -> xr.Dataset:
    """Run a sweep and return its dataset.

    The sweep covers all usual initial conditions of the scene, so that all sweeps of a scene share a compiled program.
    """
    starts = {"starts": list(starts_of(kind.scene))} if starts_of(kind.scene) else {}
    run = {"settle": kind.settle, "observe": kind.observe}
    # The source itself examines extreme parameters, so some values are unusual.
    sweep = {"scene": kind.scene, "title": title, "unusual": True, "parameters": parameters, **axes, "run": run}
    return run_sweep(sweep | starts, progress=False)
