"""Computations that results and pictures need: lanes, motions, maps and struck masses.

`read_needs` reads them from the notation of `results.csv` and `source.toml`, in which `;` separates items:

    vibro-impact beta=0.3 gamma=0.6,0.5; without: rotary beta=0.3

An item is a scene and its parameters; what it omits has the scene's default. A word without `=` is an abbreviation.
`NAME=A,B` makes one computation for each value, `NAME=FIRST:LAST:STEP` one for each value of a range, and
`start=[...]` is an initial state. A later value replaces an earlier one. With `duration` an item is a motion, otherwise
a lane. `LABEL: ` names an item's answers. An item can also be the name of a map.
"""

import itertools
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

STARTS = {"rotary": ("drive", "stuck"), "penetration": ()}
"""Starts from which every lane of a scene runs, for the scenes without contact of bit and striker."""
OBSERVATION = {"penetration": (1.0, 1.0)}
"""Settling time and observation [s]. Pulses repeat soon."""
USUAL_OBSERVATION = (40.0, 8.0)

Parameters = tuple[tuple[str, float | str], ...]
"""Names and values, sorted by name; a friction law and the shape of a pulse are texts."""


@dataclass(frozen=True)
class LaneNeed:
    """One point of a scene from one start. Its answer is a dictionary of features."""

    scene: str
    parameters: Parameters
    start: str
    settle: float
    observe: float


@dataclass(frozen=True)
class MotionNeed:
    """The motion of one point over `duration` [s], sampled every `sampling` [s] (None: the default of `simulate`).

    Its answer is the dataset of `simulate`.
    """

    scene: str
    parameters: Parameters
    start: str | tuple[float, ...]
    duration: float
    sampling: float | None


@dataclass(frozen=True)
class Map:
    """A grid of lanes; `axes` are names and values. Its answer is the dataset of `run_sweep`."""

    name: str
    scene: str
    parameters: Parameters
    axes: tuple[tuple[str, tuple[float, ...]], ...]
    settle: float
    observe: float


@dataclass(frozen=True)
class StruckMass:
    """A mass that hits a stop, from (x, x') over `duration` [s]. Its answer is the `Blows` of `struck_mass.py`."""

    start: tuple[float, float]
    duration: float
    parameters: Parameters


Need = LaneNeed | MotionNeed | Map | StruckMass
Labelled = tuple[str, Need]
"""A need with the label of its answer; the empty label is the result's main subject."""


def starts_of(scene: str) -> tuple[str, ...]:
    """Return the starts from which lanes of a scene run together, in one compiled program."""
    return STARTS.get(scene, ("drive", "stuck", "touching"))


def read_needs(text: str, abbreviations: Mapping[str, str], maps: Mapping[str, str]) -> tuple[Labelled, ...]:
    """Return the needs that a specification names, in its order."""
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
    """Return the scene of an item and the texts of its settings, abbreviations replaced."""
    words = text.split()
    while any(word in abbreviations for word in words):
        words = [part for word in words for part in abbreviations.get(word, word).split()]
    return words[0], dict(word.split("=") for word in words[1:])


def _values(text: str) -> list[Any]:
    """Return the values of a setting: numbers, names, or one initial state."""
    if text.startswith("["):
        return [tuple(float(number) for number in text.strip("[]").split(","))]
    if ":" in text:
        first, last, step = map(float, text.split(":"))
        count = round((last - first) / step) + 1
        return [float(value) for value in np.round(first + step * np.arange(count), 6)]
    return [float(value) if re.match(r"-?\d", value) else value for value in text.split(",")]


def _read_points(scene: str, settings: Mapping[str, str]) -> list[Need]:
    """Return a need for each combination of values, the last setting varying fastest."""
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
    """Return the map of an item: settings with several values, or with a range, are its axes."""
    axes = {axis: tuple(_values(text)) for axis, text in settings.items() if "," in text or ":" in text}
    parameters = {key: _values(text)[0] for key, text in settings.items() if key not in axes}
    settle, observe = OBSERVATION.get(scene, USUAL_OBSERVATION)
    return Map(name, scene, tuple(sorted(parameters.items())), tuple(axes.items()), settle, observe)
