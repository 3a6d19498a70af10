"""How a cell is simulated by itself: what the page may write into a command line and a Python call.

A dataset may come from anywhere, and whoever copies what the page shows runs it. So the page gets the names of a scene
that the package or a plugin has, and finite numbers, and nothing else; `calls.js` checks them again.
"""

import json
from typing import Any

import xarray as xr

from vibrojax.errors import InputError, Place
from vibrojax.io.attributes import differing_of, run_of, text_of
from vibrojax.models.physics.rock import ROCKS
from vibrojax.sweep.input.definition import Sweep
from vibrojax.sweep.input.names import CHOICES, Names, read_names

LONGEST_COMMAND = 10_000.0
"""Seconds that a command simulates at most, whatever the dataset says: a longer one hardly ends."""

_UNSAID = ("stribeck", "rectangular")
"""Options that are the default."""


def run_document(ds: xr.Dataset, sweep: Sweep | None = None) -> dict[str, Any]:
    """Return how a point is simulated: the parameters that differ from their defaults, options, start and duration.

    A scene that no name stands for is `own_scene`, and there is no command.
    """
    names = _known_names(ds, sweep)
    if names is None:
        return {"own_scene": True}
    differing = {one["name"]: one["value"] for one in differing_of(ds) if one["name"] in names.parameters}
    return {
        "own_scene": False,
        "scene": names.scene,
        "parameters": differing,
        "options": {option: word for option, word in names.options.items() if word not in _UNSAID},
        "start": _start(ds, names),
        "duration": shown_duration(sum(window_of(ds))),
        "names": list(names.parameters),
        "starts": list(names.starts),
        "states": list(names.system.start_states),
        "rocks": list(ROCKS) if names.has_rock else [],
    }


def window_of(ds: xr.Dataset) -> tuple[float, float]:
    """Return how long the lanes settled and were observed [s]."""
    run = run_of(ds)
    return float(run.get("settle", 40.0)), float(run.get("observe", 8.0))


def shown_duration(seconds: float) -> float:
    """Return the duration [s] that a command names."""
    return float(f"{min(seconds, LONGEST_COMMAND):.6g}")


def options_of(ds: xr.Dataset) -> dict[str, str]:
    """Return what is chosen by name in the scene of a dataset."""
    return {option: text_of(ds, option) for option in CHOICES if option in ds.attrs}


def start_of(ds: xr.Dataset) -> object:
    """Return the start that a dataset names: a word, or a vector; None if it names none."""
    text = text_of(ds, "start").strip('"')
    try:
        return json.loads(text) if text.startswith("[") else text or None
    except (ValueError, RecursionError):
        return text


def _known_names(ds: xr.Dataset, sweep: Sweep | None) -> Names | None:
    """Return the names of the scene, None if no name stands for the scene with its options."""
    try:
        if sweep is None:
            return read_names(Place("explore", "scene"), text_of(ds, "scene"), options_of(ds))
        names = read_names(Place("explore", "scene"), sweep.system.name, sweep.options)
    except InputError:
        return None
    return names if names.system == sweep.system else None


def _start(ds: xr.Dataset, names: Names) -> object:
    """Return the start of a dataset if the scene has it."""
    start = start_of(ds)
    if start is None or not names.has_starts:
        return None
    try:
        return names.start(Place("explore", "start"), start)
    except InputError:
        return None
