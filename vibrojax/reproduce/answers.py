"""Computes what is asked for: lanes of one kind together in one sweep, motions one by one, maps as they are."""

import warnings
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from vibrojax.analyses.sweep.run import run_sweep
from vibrojax.errors import InputError, Place
from vibrojax.reproduce.needs import (
    Answer,
    Features,
    Lane,
    Map,
    Motion,
    Need,
    Parameters,
    StruckMass,
    Unanswered,
    starts_of,
)
from vibrojax.reproduce.struck_mass import blows
from vibrojax.sweep.input.plausible import UnusualValue
from vibrojax.sweep.input.point import read_point
from vibrojax.sweep.simulation import simulate

PROBES = 8
"""Lanes of each scene that are tried before all."""
MOST_FAILED = 0.25
"""Share of the probes that may fail. Where the equations are wrong lanes do not end but by running out of steps, each
after minutes."""


class _Kind(NamedTuple):
    """What lanes share that are computed in one sweep: `names` are the parameters that are chosen by name."""

    scene: str
    names: tuple[tuple[str, str], ...]
    settle: float
    observe: float


_Point = tuple[tuple[str, float], ...]
"""The parameters of a lane that are numbers."""


class Answers:
    """The answers to needs, and the datasets that they are read from, by name.

    A scene whose probes fail is not computed: its needs are `Unanswered`.

    **Arguments:**

    - `needs`: what to compute; repeated needs are computed once.
    - `report`: is given a line before each sweep, map and motion: how many of them there are, and which comes now.
    """

    def __init__(self, needs: Iterable[Need], report: Callable[[str], None] = lambda line: None) -> None:
        self.datasets: dict[str, xr.Dataset] = {}
        self._answers: dict[Need, Answer] = {}
        self._failing: dict[str, str] = {}
        self._report = report
        self._begun = 0
        needs = list(dict.fromkeys(needs))
        kinds = _by_kind(need for need in needs if isinstance(need, Lane))
        self._parts = len(kinds) + sum(isinstance(need, Map | Motion) for need in needs)
        for kind, lanes in kinds.items():
            self._lanes(kind, lanes)
        # Maps before motions: what takes longest comes first.
        for map_ in (need for need in needs if isinstance(need, Map)):
            self._answers[map_] = self._unless_failing(map_.scene) or self._map(map_)
        for motion in (need for need in needs if isinstance(need, Motion)):
            self._answers[motion] = self._unless_failing(motion.scene) or self._motion(motion)
        for mass in (need for need in needs if isinstance(need, StruckMass)):
            self._answers[mass] = blows(mass.start, mass.duration, **dict(mass.parameters))

    def __getitem__(self, need: Need) -> Answer:
        return self._answers[need]

    def _begin(self, text: str) -> None:
        """Report the next part."""
        self._begun += 1
        self._report(f"{self._begun:3d}/{self._parts}  {text}")

    def _unless_failing(self, scene: str) -> Unanswered | None:
        return Unanswered(self._failing[scene]) if scene in self._failing else None

    def _lanes(self, kind: _Kind, lanes: list[Lane]) -> None:
        points = list(dict.fromkeys(_numbers(lane.parameters) for lane in lanes))
        chosen = [value for _, value in kind.names]
        self._begin(f"{' '.join([kind.scene, *chosen])}: {len(points)} points, {kind.settle:g} s")
        if kind.scene not in self._failing and _fails(kind, points[:: max(1, len(points) // PROBES)]):
            self._failing[kind.scene] = f"points of the scene {kind.scene} fail"
        if kind.scene in self._failing:
            self._answers |= dict.fromkeys(lanes, Unanswered(self._failing[kind.scene]))
            return
        dataset = run_sweep(_sweep(kind, points), progress=False)
        self._keep("-".join([kind.scene, *chosen, f"{kind.settle:g}s"]), dataset)
        for lane in lanes:
            row = dataset.isel(point=points.index(_numbers(lane.parameters)))
            self._answers[lane] = Features(row.sel(start=lane.start) if starts_of(kind.scene) else row)

    def _map(self, need: Map) -> xr.Dataset:
        axes = {name: list(values) for name, values in need.axes}
        self._begin(f"{need.name}: {np.prod([len(values) for values in axes.values()])} points")
        sweep: dict[str, Any] = {
            "scene": need.scene,
            "parameters": dict(need.parameters),
            "grid": axes,
            "title": need.name,
            "unusual": True,
        }
        if need.starts:
            sweep["starts"] = list(need.starts)
        sweep["run"] = {"settle": need.settle, "observe": need.observe}
        dataset = run_sweep(sweep, progress=False)
        self._keep(need.name.replace(" ", "-"), dataset)
        return dataset

    def _motion(self, need: Motion) -> xr.Dataset | Unanswered:
        self._begin(f"motion: {need.scene}, {need.duration:g} s")
        settings: dict[str, Any] = {"duration": need.duration, "sampling": need.sampling, "progress": False}
        if need.scene != "penetration":
            settings["start"] = need.start
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UnusualValue)
                return simulate(need.scene, **settings, **dict[str, Any](need.parameters))
        except InputError as problem:  # too many steps: the other answers are still good
            return Unanswered(str(problem))

    def _keep(self, name: str, dataset: xr.Dataset) -> None:
        """Keep a dataset under a name that is free."""
        count = sum(other.partition("--")[0] == name for other in self.datasets)
        self.datasets[f"{name}--{count + 1}" if count else name] = dataset


def _by_kind(lanes: Iterable[Lane]) -> dict[_Kind, list[Lane]]:
    kinds: dict[_Kind, list[Lane]] = {}
    for lane in lanes:
        kind = _Kind(lane.scene, _names(lane.parameters), lane.settle, lane.observe)
        kinds.setdefault(kind, []).append(lane)
    return kinds


def _fails(kind: _Kind, points: list[_Point]) -> bool:
    """Whether many of some lanes fail within two seconds."""
    dataset = run_sweep(_sweep(kind._replace(settle=1.0, observe=1.0), points), progress=False)
    return bool((dataset.status == 1).mean() > MOST_FAILED)


def _sweep(kind: _Kind, points: list[_Point]) -> dict[str, Any]:
    """A sweep over points from all starts of the scene, and so one compiled program whatever is asked."""
    starts = {"starts": list(starts_of(kind.scene))} if starts_of(kind.scene) else {}
    return {
        "scene": kind.scene,
        "title": f"The source, reproduced: points of the scene {kind.scene}",
        "unusual": True,  # what the source itself asks of limits
        "parameters": dict(kind.names),
        "points": _columns(kind, points),
        "run": {"settle": kind.settle, "observe": kind.observe},
        **starts,
    }


def _names(parameters: Parameters) -> tuple[tuple[str, str], ...]:
    """What is chosen by name, such as the friction law: one program each. A rock is an axis like any other."""
    return tuple((name, value) for name, value in parameters if isinstance(value, str))


def _numbers(parameters: Parameters) -> _Point:
    return tuple((name, value) for name, value in parameters if not isinstance(value, str))


def _columns(kind: _Kind, points: list[_Point]) -> dict[str, list[float]]:
    """Columns of a sweep: what any point says, with the scene's defaults where one says nothing."""
    defaults = read_point(Place("reproduce"), kind.scene, dict(kind.names), None).parameters
    said = dict.fromkeys(name for point in points for name, _ in point)
    return {name: [float(dict(point).get(name, defaults[name])) for point in points] for name in said or ("m1",)}
