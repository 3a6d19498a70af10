"""Specifications of the computations that results and pictures require, here called *needs*.

A need is a lane, a motion, a map or a struck mass. `read_needs` parses the notation of `results.csv` and
`source.toml`, in which `;` separates items:

    vibro-impact beta=0.3 gamma=0.6,0.5; without: rotary beta=0.3

An item consists of a scene and its parameters; an omitted parameter has the scene's default. A word without `=` is an
abbreviation, which is replaced by its definition. `NAME=A,B` stands for one computation per value,
`NAME=FIRST:LAST:STEP` for one computation per value of a range. `start=[...]` is an initial state. If a name occurs
twice, the later value counts. An item with `duration` is a motion, otherwise a lane (one trajectory of a sweep).
`LABEL: ` before an item names its *answers*, the values computed for it. An item can also be the name of a map.
"""

import itertools
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

STARTS = {"rotary": ("drive", "stuck"), "penetration": ()}
"""Initial conditions of all lanes, by scene, for the scenes in which bit and striker are not in contact."""
OBSERVATION = {"penetration": (1.0, 1.0)}
"""Settling time and observation time [s] by scene. The motion under pulses soon becomes periodic."""
USUAL_OBSERVATION = (40.0, 8.0)
"""Settling time and observation time [s] of all other scenes."""

Parameters = tuple[tuple[str, float | str], ...]
"""Parameters as (name, value), sorted by name; the friction law and the shape of a pulse are strings."""


@dataclass(frozen=True)
class LaneNeed:
    """A lane to compute: one parameter point with one initial condition. Its result is a dictionary of features."""

    scene: str
    parameters: Parameters
    start: str
    settle: float
    observe: float


@dataclass(frozen=True)
class MotionNeed:
    """A motion to compute at one parameter point, over `duration` [s]. Its result is the dataset of `simulate`.

    `sampling` [s]: interval of the samples, None for the default of `simulate`.
    """

    scene: str
    parameters: Parameters
    start: str | tuple[float, ...]
    duration: float
    sampling: float | None


@dataclass(frozen=True)
class Map:
    """A sweep over a grid to compute. Its result is the sweep's dataset.

    `axes`: pairs of a parameter name and its values.
    """

    name: str
    scene: str
    parameters: Parameters
    axes: tuple[tuple[str, tuple[float, ...]], ...]
    settle: float
    observe: float


@dataclass(frozen=True)
class StruckMass:
    """A motion to compute of a mass that hits a stop, over `duration` [s].

    `start` is the initial state (x, x'). Its result is the `Blows` of `struck_mass.py`.
    """

    start: tuple[float, float]
    duration: float
    parameters: Parameters


Need = LaneNeed | MotionNeed | Map | StruckMass
Labelled = tuple[str, Need]
"""A label and the computation whose result it names; the empty label stands for the main subject of a result."""


def starts_of(scene: str) -> tuple[str, ...]:
    """Return the names of the initial conditions from which every sweep of a scene computes each parameter point.

    The tuple is empty if the scene has a single initial condition.
    """
    return STARTS.get(scene, ("drive", "stuck", "touching"))


def read_needs(text: str, abbreviations: Mapping[str, str], maps: Mapping[str, str]) -> tuple[Labelled, ...]:
    """Parse a specification and return its labelled computations (needs), in order.

    **Arguments:**

    - `text`: the specification, in the notation of this module.
    - `abbreviations`, `maps`: definitions by name.
    """
    labelled: list[Labelled] = []
    for part in text.split(";"):
        label, _, item = part.strip().rpartition(": ")
        needs: list[Need]
        if item in maps:
            needs = [_read_map(item, *_settings(maps[item], abbreviations))]
        elif ";" in abbreviations.get(item, ""):
            needs = [need for _, need in read_needs(abbreviations[item], abbreviations, maps)]
        else:
            needs = _read_points(*_settings(item, abbreviations)) if item else []
        labelled += [(label, need) for need in needs]
    return tuple(labelled)


def _settings(text: str, abbreviations: Mapping[str, str]) -> tuple[str, dict[str, str]]:
    """Return the scene of an item and its settings as strings, after replacing abbreviations."""
    words = text.split()
    while any(word in abbreviations for word in words):
        words = [part for word in words for part in abbreviations.get(word, word).split()]
    return words[0], dict(word.split("=") for word in words[1:])


def _values(text: str) -> list[Any]:
    """Return the list of values of a setting: numbers, strings, or a single initial state."""
    if text.startswith("["):
        return [tuple(float(number) for number in text.strip("[]").split(","))]
    if ":" in text:
        first, last, step = map(float, text.split(":"))
        count = round((last - first) / step) + 1
        return [float(value) for value in np.round(first + step * np.arange(count), 6)]
    return [float(value) if re.match(r"-?\d", value) else value for value in text.split(",")]


def _read_points(scene: str, settings: Mapping[str, str]) -> list[Need]:
    """Return one computation per combination of values; the last setting varies fastest."""
    needs: list[Need] = []
    for combination in itertools.product(*map(_values, settings.values())):
        values = dict(zip(settings, combination, strict=True))
        start = values.pop("start", "drive")
        duration, sampling = values.pop("duration", None), values.pop("sampling", None)
        usual_settle, observe = OBSERVATION.get(scene, USUAL_OBSERVATION)
        settle = values.pop("settle", usual_settle)
        parameters = tuple(sorted(values.items()))
        if scene == "struck":
            needs.append(StruckMass(start, duration, parameters))
        elif duration is not None:
            needs.append(MotionNeed(scene, parameters, start, duration, sampling))
        else:
            needs.append(LaneNeed(scene, parameters, start, settle, observe))
    return needs


def _read_map(name: str, scene: str, settings: Mapping[str, str]) -> Map:
    """Return the map that an item specifies; its axes are the settings with several values or a range."""
    axes = {axis: tuple(_values(text)) for axis, text in settings.items() if "," in text or ":" in text}
    parameters = {key: _values(text)[0] for key, text in settings.items() if key not in axes}
    settle, observe = OBSERVATION.get(scene, USUAL_OBSERVATION)
    return Map(name, scene, tuple(sorted(parameters.items())), tuple(axes.items()), settle, observe)
