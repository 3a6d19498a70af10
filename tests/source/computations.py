"""Computations that results and pictures require (*needs*), and their execution.

`read_needs` parses the notation of `results.csv` and `source.toml`, in which `;` separates items:

    vibro-impact beta=0.3 gamma=0.6,0.5; without: rotary beta=0.3

An item consists of a scene and its parameters; an omitted parameter has the scene's default. A word without `=` is an
abbreviation, which is replaced by its definition. `NAME=A,B` stands for one computation per value,
`NAME=FIRST:LAST:STEP` for one computation per value of a range. `start=[...]` is an initial state. If a name occurs
twice, the later value counts. An item with `duration` is a motion, otherwise a lane (one trajectory of a sweep).
`LABEL: ` before an item names its *answers*, the values computed for it. An item can also be the name of a map.
"""

import itertools
import re
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from source.struck_mass import EXACT, STRUCK, struck_mass
from vibrojax.errors import InputError, Place, counted
from vibrojax.maps.read import read_point
from vibrojax.maps.run import run_sweep
from vibrojax.settings.values import UnusualValue
from vibrojax.studies.trajectory import simulate

STARTS = {"rotary": ("drive", "stuck"), "penetration": ()}
"""Initial conditions of all lanes, by scene, for the scenes in which bit and striker are not in contact."""
OBSERVATION: dict[str, dict[str, Any]] = {"penetration": {"settle": 1.0, "observe": 1.0}}
"""Settling time and observation time [s] by scene. The motion under pulses soon becomes periodic."""

PROBED_LANES = 8
"""Approximate number of lanes per sweep that are first simulated for two seconds, to detect a failing scene early."""
MAX_FAILED_SHARE = 0.25
"""Fraction of the probed lanes that may fail. With wrong equations, every lane would run out of steps after minutes."""

Parameters = tuple[tuple[str, Any], ...]
Features = dict[str, Any]
"""Parameters and variables by name: scalars of one lane, or arrays of several lanes."""


@dataclass(frozen=True)
class Need:
    """A computation of the `kind` "lanes" (one lane), "motion" or "map" (a sweep over a grid).

    Its answer is a dictionary of features, the dataset of `simulate`, or the dataset of the sweep.

    - `parameters`: pairs (name, value), sorted by name; the friction law and the shape of a pulse are strings.
    - `start`: name of the initial condition, or the initial state.
    - `settle`, `observe`: times of a lane or map [s]; `duration`: time of a motion [s].
    - `sampling`: interval of a motion's samples [s], None for the default of `simulate`.
    - `name`, `axes`: the title of a map, and its pairs of a parameter name and its values.
    """

    kind: str
    scene: str
    parameters: Parameters
    start: Any = "drive"
    settle: float = 40.0
    observe: float = 8.0
    duration: float = 0.0
    sampling: float | None = None
    name: str = ""
    axes: Parameters = ()

    @property
    def starts(self) -> tuple[str, ...]:
        """Names of the scene's initial conditions, all of which every sweep of the scene contains."""
        return STARTS.get(self.scene, ("drive", "stuck", "touching"))

    @property
    def numbers(self) -> Parameters:
        return tuple((name, value) for name, value in self.parameters if not isinstance(value, str))


@dataclass(frozen=True)
class Unanswered:
    """A failed computation: stands for its result; `reason` explains why there is none."""

    reason: str


Labelled = tuple[str, Need]
"""A label and the computation whose result it names; the empty label stands for the main subject of a result."""
Answer = Features | xr.Dataset | Unanswered


def read_needs(text: str, abbreviations: Mapping[str, str], maps: Mapping[str, str]) -> tuple[Labelled, ...]:
    """Parse a specification and return its labelled computations (needs), in order.

    **Arguments:**

    - `text`: the specification, in the notation of this module.
    - `abbreviations`, `maps`: definitions by name.
    """
    labelled: list[Labelled] = []
    for part in text.split(";"):
        label, _, item = part.strip().rpartition(": ")
        if ";" in abbreviations.get(item, ""):
            labelled += [(label, need) for _, need in read_needs(abbreviations[item], abbreviations, maps)]
        elif item:
            scene, *words = maps.get(item, item).split()
            while any(word in abbreviations for word in (scene, *words)):
                scene, *words = (part for word in (scene, *words) for part in abbreviations.get(word, word).split())
            settings = dict(word.split("=") for word in words)
            labelled += [(label, need) for need in _read_item(scene, settings, item if item in maps else "")]
    return tuple(labelled)


def _read_item(scene: str, settings: Mapping[str, str], title: str) -> list[Need]:
    """Return one computation per combination of values (the last setting varies fastest), or the map `title`."""
    axes = {name: text for name, text in settings.items() if title and ("," in text or ":" in text)}
    names = [name for name in settings if name not in axes]
    needs: list[Need] = []
    for combination in itertools.product(*(_values(settings[name]) for name in names)):
        values = dict(zip(names, combination, strict=True))
        times = dict(OBSERVATION.get(scene, {}))
        times |= {name: values.pop(name) for name in ("start", "settle", "duration", "sampling") if name in values}
        grid = tuple((name, tuple(_values(text))) for name, text in axes.items())
        kind = "map" if title else "motion" if "duration" in times else "lanes"
        needs.append(Need(kind, scene, tuple(sorted(values.items())), **times, name=title, axes=grid))
    return needs


def _values(text: str) -> list[Any]:
    """Return the list of values of a setting: numbers, strings, or a single initial state."""
    if text.startswith("["):
        return [tuple(float(number) for number in text.strip("[]").split(","))]
    if ":" in text:
        first, last, step = map(float, text.split(":"))
        return np.round(first + step * np.arange(round((last - first) / step) + 1), 6).tolist()
    return [float(value) if re.match(r"-?\d", value) else value for value in text.split(",")]


class SourceAnswers:
    """The values computed for `needs` (*answers*), by computation. All are computed on construction.

    Lanes with equal settings are computed together in one sweep. Each map is a sweep of its own, and motions are
    simulated one at a time. `datasets` holds, by name, the datasets of the sweeps. If too many probed lanes of a scene
    fail, the scene is not computed, and all its answers are `Unanswered`.

    **Arguments:**

    - `needs`: the computations to run; equal ones run only once.
    - `report`: function that receives a line of text before each sweep, map and motion, with its number and the total.
    """

    def __init__(self, needs: Iterable[Need], report: Callable[[str], None] = lambda line: None) -> None:
        self.datasets: dict[str, xr.Dataset] = {}
        self._answers: dict[Need, Answer] = {}
        needs = list(dict.fromkeys(needs))
        sweeps: dict[Need, list[Need]] = {}  # lanes by what those of one sweep share: all but numbers and starts
        for need in needs:
            if need.kind == "lanes":
                names = tuple(item for item in need.parameters if item not in need.numbers)
                sweeps.setdefault(replace(need, parameters=names, start="drive"), []).append(need)
        parts = len(sweeps) + sum(need.kind in ("map", "motion") for need in needs)
        number = itertools.count(1)

        def begin(text: str) -> None:
            report(f"{next(number):3d}/{parts}  {text}")

        failing: dict[str, Unanswered] = {}
        for shared, lanes in sweeps.items():
            scene = " ".join([shared.scene, *(name for _, name in shared.parameters)])
            points = list(dict.fromkeys(lane.numbers for lane in lanes))
            begin(f"{scene}: {counted(len(points), 'point')}, {shared.settle:g} s")
            if shared.scene not in failing:
                probes = points[:: max(1, len(points) // PROBED_LANES)]
                probed = _run_points(replace(shared, settle=1.0, observe=1.0), probes)
                if (probed.status == 1).mean() > MAX_FAILED_SHARE:
                    failing[shared.scene] = Unanswered(f"points of the scene {shared.scene} fail")
            if shared.scene not in failing:
                dataset = _run_points(shared, points)
                self._keep(f"{scene.replace(' ', '-')}-{shared.settle:g}s", dataset)
                for lane in lanes:
                    self._answers[lane] = _features(lane, dataset.isel(point=points.index(lane.numbers)))
        self._answers = {need: failing[need.scene] for need in needs if need.scene in failing} | self._answers
        others = [need for need in needs if need not in self._answers]
        for need in (need for need in others if need.kind == "map"):  # a map takes longer than a motion
            begin(f"{need.name}: {counted(int(np.prod([len(values) for _, values in need.axes])), 'point')}")
            self._answers[need] = dataset = _run(need, need.name, grid=dict(need.axes))
            self._keep(need.name.replace(" ", "-"), dataset)
        for need in (need for need in others if need.kind == "motion"):
            begin(f"motion: {need.scene}, {need.duration:g} s")
            self._answers[need] = _simulate(need)

    def __getitem__(self, need: Need) -> Answer:
        return self._answers[need]

    def _keep(self, name: str, dataset: xr.Dataset) -> None:
        """Store a dataset under `name`; append a number if datasets with this name are already stored."""
        count = sum(other.partition("--")[0] == name for other in self.datasets)
        self.datasets[f"{name}--{count + 1}" if count else name] = dataset


def collect(needs: tuple[Labelled, ...], answers: list[Answer]) -> dict[str, Any]:
    """Return computed values as variables, by name, for the expressions of a row of `results.csv` or of a picture.

    `answers`: the computed values of each of the `needs`, in the same order.

    The lanes with one label form one dictionary of features, whose values are arrays if there are several lanes. Lanes
    without a label are named `lanes`, and each of their features is also a variable of its own. Motions without a label
    are the list `motions`, and `motion` is the first of them. `map` and `maps` follow the same rule.
    """
    names: dict[str, Any] = {}
    groups: dict[str, list[Any]] = {}
    for (label, need), answer in zip(needs, answers, strict=True):
        groups.setdefault(label or need.kind, []).append(answer)
    for name, group in groups.items():
        if isinstance(group[0], dict):
            common = [key for key in group[0] if all(key in lane for lane in group)]
            arrays = {key: np.array([lane[key] for lane in group]) for key in common}
            names[name] = group[0] if len(group) == 1 else arrays
            names |= names[name] if name == "lanes" else {}
        else:
            names[name], names[f"{name}s"] = group[0], group
    return names


def _features(lane: Need, row: xr.Dataset) -> Features:
    """Return the parameters and variables of a lane, and some variables also converted to the source's units."""
    row = row.sel(start=lane.start) if lane.starts else row
    scalars = {str(name): variable.values.item() for name, variable in row.variables.items() if not variable.ndim}
    features: Features = scalars | dict(lane.parameters)
    if "regime" in features:
        features["regime"] = row["regime"].attrs["flag_meanings"].split()[features["regime"]]
        features["single"] = features["regime"] == "single-impact"
    if "period" in features:
        features["hertz"], features["omega"] = 1 / features["period"], 2 * np.pi / features["period"]
    # The contact is lossless, so the velocity is reversed at impact.
    converted = {"velocity_change": ("impact_velocity", 2), "impact_kN": ("peak_impact_force", 1e-3)}
    converted["rate"] = ("rate_of_penetration", 1e3)
    return features | {name: scale * features[key] for name, (key, scale) in converted.items() if key in features}


def _simulate(need: Need) -> xr.Dataset | Unanswered:
    settings: dict[str, Any] = {"start": need.start} if need.starts else {}
    settings |= {"duration": need.duration, "sampling": need.sampling, "progress": False}
    scene: Any = need.scene
    if scene == STRUCK:
        scene, settings["error"] = struck_mass(), EXACT
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UnusualValue)
            return simulate(scene, **settings, **dict(need.parameters))
    except InputError as problem:  # too many steps: this does not invalidate the other results
        return Unanswered(str(problem))


def _run_points(shared: Need, points: list[Parameters]) -> xr.Dataset:
    """Run a sweep of points and return its dataset; a parameter that a point omits has the scene's default."""
    defaults = read_point(Place("reproduce"), shared.scene, dict(shared.parameters), None).parameters
    varied = dict.fromkeys(name for point in points for name, _ in point) or ("m1",)
    columns = {name: [float(dict(point).get(name, defaults[name])) for point in points] for name in varied}
    return _run(shared, f"The source, reproduced: points of the scene {shared.scene}", points=columns)


def _run(need: Need, title: str, **axes: Mapping[str, Any]) -> xr.Dataset:
    """Run a sweep and return its dataset.

    The sweep covers all usual initial conditions of the scene, so that all sweeps of a scene share a compiled program.
    """
    sweep = {"scene": need.scene, "title": title, "parameters": dict(need.parameters), **axes}
    sweep |= {"run": {"settle": need.settle, "observe": need.observe}}
    sweep |= {"starts": list(need.starts)} if need.starts else {}
    # The source itself examines extreme parameters, so some values are unusual.
    return run_sweep(sweep | {"unusual": True}, progress=False)
