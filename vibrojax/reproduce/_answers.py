"""Computes what is asked for: lanes of one kind together in one sweep, motions one by one, maps as they are."""

from collections.abc import Callable, Iterable

import numpy as np
import xarray as xr

from vibrojax.errors import InputError, Place
from vibrojax.reproduce._entry import Unanswered
from vibrojax.reproduce._needs import Lane, Map, Motion, StruckMass, starts_of
from vibrojax.reproduce._struck import Blows, blows
from vibrojax.simulation import simulate
from vibrojax.sweep import read_point, run_sweep


class Row:
    """The features of one lane, by name, in SI units."""

    def __init__(self, dataset: xr.Dataset):
        self._dataset = dataset

    def __getitem__(self, name: str) -> float:
        return float(self._dataset[name])

    @property
    def regime(self) -> str:
        return self._dataset["regime"].attrs["flag_meanings"].split()[int(self["regime"])]

    @property
    def frequency(self) -> float:
        """1/period [Hz]."""
        return 1 / self["period"]

    @property
    def angular_frequency(self) -> float:
        """2 pi/period [rad/s]."""
        return 2 * np.pi / self["period"]


PROBES = 8
"""Lanes of each scene that are tried before all."""
MOST_FAILED = 0.25
"""Share of the probes that may fail. Where the equations are wrong lanes do not end but by running out of steps, each
after minutes."""


class Answers:
    """The answers to needs, and the datasets that they are read from, by name.

    A scene whose probes fail is not computed: its needs are `Unanswered`.
    """

    def __init__(self, needs: Iterable, told: Callable[[str], None] = lambda text: None):
        self.datasets: dict[str, xr.Dataset] = {}
        self._found: dict = {}
        self._told = told
        self._failing: dict[str, str] = {}
        needs = list(dict.fromkeys(needs))
        self._lanes([need for need in needs if isinstance(need, Lane)])
        for kind, compute in ((Map, self._map), (Motion, self._motion), (StruckMass, self._struck)):
            for need in needs:
                if isinstance(need, kind):
                    failing = self._failing.get(getattr(need, "scene", ""))
                    self._found[need] = Unanswered(failing) if failing else compute(need)

    def __getitem__(self, need):
        return self._found[need]

    def _lanes(self, lanes: list[Lane]) -> None:
        kinds: dict[tuple, list[Lane]] = {}
        for lane in lanes:
            kinds.setdefault((lane.scene, _names(lane.parameters), lane.settle, lane.observe), []).append(lane)
        for (scene, names, settle, observe), alike in kinds.items():
            points = list(dict.fromkeys(_numbers(lane.parameters) for lane in alike))
            if scene not in self._failing and self._fails(scene, names, points[:: max(1, len(points) // PROBES)]):
                self._failing[scene] = f"points of the scene {scene} fail"
            if scene in self._failing:
                self._found |= dict.fromkeys(alike, Unanswered(self._failing[scene]))
                continue
            self._told(f"{scene}{''.join(' ' + value for _, value in names)}: {len(points)} points, {settle:g} s")
            dataset = run_sweep(_sweep(scene, names, points, settle, observe), progress=False)
            self.datasets[self._free("-".join([scene, *(value for _, value in names), f"{settle:g}s"]))] = dataset
            for lane in alike:
                row = dataset.isel(point=points.index(_numbers(lane.parameters)))
                self._found[lane] = Row(row.sel(start=lane.start) if starts_of(scene) else row)

    def _fails(self, scene: str, names, points) -> bool:
        """Whether many of some lanes fail within two seconds."""
        dataset = run_sweep(_sweep(scene, names, points, 1.0, 1.0), progress=False)
        return bool((dataset.status == 1).mean() > MOST_FAILED)

    def _map(self, need: Map) -> xr.Dataset:
        axes = {name: list(values) for name, values in need.axes}
        self._told(f"{need.name}: {np.prod([len(values) for values in axes.values()])} points")
        sweep = {"scene": need.scene, "parameters": dict(need.parameters), "grid": axes, "title": need.name}
        if need.starts:
            sweep["starts"] = list(need.starts)
        sweep["run"] = {"settle": need.settle, "observe": need.observe}
        dataset = run_sweep(sweep, progress=False)
        self.datasets[self._free(need.name.replace(" ", "-"))] = dataset
        return dataset

    def _motion(self, need: Motion) -> xr.Dataset | Unanswered:
        start = {} if need.scene == "penetration" else {"start": need.start}
        self._told(f"motion: {need.scene}, {need.duration:g} s")
        settings = {"duration": need.duration, "sampling": need.sampling, "progress": False}
        try:
            return simulate(need.scene, **settings, **start, **dict(need.parameters))
        except InputError as problem:  # too many steps: the other answers are still good
            return Unanswered(str(problem))

    def _struck(self, need: StruckMass) -> Blows:
        return blows(need.start, need.duration, **dict(need.parameters))

    def _free(self, name: str) -> str:
        count = sum(one.partition("--")[0] == name for one in self.datasets)
        return f"{name}--{count + 1}" if count else name


def _sweep(scene: str, names, points, settle: float, observe: float) -> dict:
    """A sweep over points from all starts of the scene, and so one compiled program whatever is asked."""
    starts = {"starts": list(starts_of(scene))} if starts_of(scene) else {}
    return {
        "scene": scene,
        "title": f"The source, reproduced: points of the scene {scene}",
        "parameters": dict(names),
        "points": _columns(scene, names, points),
        "run": {"settle": settle, "observe": observe},
        **starts,
    }


def _names(parameters) -> tuple:
    """What is chosen by name, such as the friction law: one program each. A rock is an axis like any other."""
    return tuple((name, value) for name, value in parameters if isinstance(value, str))


def _numbers(parameters) -> tuple:
    return tuple((name, value) for name, value in parameters if not isinstance(value, str))


def _columns(scene: str, names, points) -> dict[str, list[float]]:
    """Columns of a sweep: what any point says, with the scene's defaults where one says nothing."""
    defaults = read_point(Place("reproduce"), scene, dict(names), None).parameters
    said = dict.fromkeys(name for point in points for name, _ in point)
    return {name: [float(dict(point).get(name, defaults[name])) for point in points] for name in said or ("m1",)}
