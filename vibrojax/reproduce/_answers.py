"""Computes what is asked for: lanes of one kind together in one sweep, motions one by one, maps as they are."""

from collections.abc import Callable, Iterable

import numpy as np
import xarray as xr

from vibrojax.errors import Place
from vibrojax.reproduce._needs import Lane, Map, Motion, StruckMass, starts_of
from vibrojax.reproduce._struck import blows
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


class Answers:
    """The answers to needs, and the datasets that they are read from, by name."""

    def __init__(self, needs: Iterable, told: Callable[[str], None] = lambda text: None):
        self.datasets: dict[str, xr.Dataset] = {}
        self._found: dict = {}
        self._told = told
        needs = list(dict.fromkeys(needs))
        self._lanes([need for need in needs if isinstance(need, Lane)])
        for need in needs:
            if isinstance(need, Map):
                self._map(need)
        for need in needs:
            if isinstance(need, Motion):
                self._motion(need)
            elif isinstance(need, StruckMass):
                self._found[need] = blows(need.start, need.duration, **dict(need.parameters))

    def __getitem__(self, need):
        return self._found[need]

    def _lanes(self, lanes: list[Lane]) -> None:
        kinds: dict[tuple, list[Lane]] = {}
        for lane in lanes:
            kinds.setdefault((lane.scene, _names(lane.parameters), lane.settle, lane.observe), []).append(lane)
        for (scene, names, settle, observe), alike in kinds.items():
            points = list(dict.fromkeys(_numbers(lane.parameters) for lane in alike))
            self._told(f"{scene}{''.join(' ' + value for _, value in names)}: {len(points)} points, {settle:g} s")
            sweep = {"scene": scene, "parameters": dict(names), "points": _columns(scene, names, points)}
            if starts_of(scene):
                sweep["starts"] = list(starts_of(scene))
            sweep["run"] = {"settle": settle, "observe": observe}
            sweep["title"] = f"The source, reproduced: points of the scene {scene}"
            dataset = run_sweep(sweep, progress=False)
            self.datasets[self._free("-".join([scene, *(value for _, value in names), f"{settle:g}s"]))] = dataset
            for lane in alike:
                row = dataset.isel(point=points.index(_numbers(lane.parameters)))
                self._found[lane] = Row(row.sel(start=lane.start) if starts_of(scene) else row)

    def _map(self, need: Map) -> None:
        axes = {name: list(values) for name, values in need.axes}
        self._told(f"{need.name}: {np.prod([len(values) for values in axes.values()])} points")
        sweep = {"scene": need.scene, "parameters": dict(need.parameters), "grid": axes, "title": need.name}
        if need.starts:
            sweep["starts"] = list(need.starts)
        sweep["run"] = {"settle": need.settle, "observe": need.observe}
        dataset = run_sweep(sweep, progress=False)
        self.datasets[self._free(need.name.replace(" ", "-"))] = dataset
        self._found[need] = dataset

    def _motion(self, need: Motion) -> None:
        start = {} if need.scene == "penetration" else {"start": need.start}
        self._told(f"motion: {need.scene}, {need.duration:g} s")
        self._found[need] = simulate(
            need.scene,
            duration=need.duration,
            sampling=need.sampling,
            progress=False,
            **start,
            **dict(need.parameters),
        )

    def _free(self, name: str) -> str:
        count = sum(one.partition("--")[0] == name for one in self.datasets)
        return f"{name}--{count + 1}" if count else name


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
