"""Files of studies, designs and calibrations: the keys that they share, bounds, and the sweep over points within."""

from collections.abc import Mapping
from dataclasses import MISSING, dataclass
from itertools import product
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

from vibrojax.errors import Place, shown
from vibrojax.lazy import qmc
from vibrojax.maps.read import sweep_of
from vibrojax.maps.sweep import Sweep
from vibrojax.physics.parameters import Parameter
from vibrojax.settings.fields import Settings, given, setting
from vibrojax.settings.names import Names, read_names
from vibrojax.settings.toml import Source, plain_table, render
from vibrojax.settings.values import as_table, read_pair

MAX_VARIED = 12
"""Largest number of varied parameters: a dozen, as many as a person chooses by hand."""

MAX_TOLERANCES = 6
"""Largest number of parameters with a tolerance; six have 64 corners, and 192 edges."""

_EXAMPLE = "write one like gamma = [0.6, 0.8]"


@dataclass(frozen=True, kw_only=True)
class SceneFile(Settings):
    """The keys of a file about a scene."""

    scene: Any = setting(MISSING, 'write the scene\'s name, like scene = "vibro-impact"', read=given)
    title: Any = setting("", "title of the dataset", read=given)
    parameters: dict[str, Any] = setting(dict, "values of the other parameters", read=as_table)
    unusual: bool = setting(False, "whether values far from those of rigs are intended")


@dataclass(frozen=True, kw_only=True)
class VariedFile(SceneFile):
    """The keys of a file about a scene whose parameters vary between bounds."""

    vary: Any = setting(None, "bounds of the varied parameters", read=given)
    starts: Any = setting(None, "initial conditions, as in a sweep", read=given)
    run: dict[str, Any] = setting(dict, "settings of the run, as in a sweep", read=as_table)

    def sweep(self, file: str, points: Mapping[str, list[float]], **changes: object) -> Sweep:
        """Return the sweep over points, with some keys changed; messages name the file, and its table [vary]."""
        if "carry" in self.run:
            raise Place(file, "run.carry").error("points have no axis along which lanes continue; leave it out")
        tables = {name: getattr(self, name) for name in ("scene", "title", "parameters", "run", "starts")}
        tables |= {"points": points, "unusual": self.unusual} | changes
        tables = plain_table(Place(file), {name: value for name, value in tables.items() if value is not None})
        return sweep_of(Source("sweep", file, Path(), render(tables), tables), "vary")


File = TypeVar("File", bound=SceneFile)


def read_file(kind: type[File], origin: Source) -> tuple[File, Place, Names]:
    """Return the keys of a file, its place, and the names of its scene."""
    place = Place(origin.file)
    file = kind.read(place, origin.tables)
    return file, place, read_names(place.at("scene"), file.scene, dict(file.parameters), place.at("parameters"))


def read_bounds(
    place: Place,
    value: object,
    names: Names,
    fixed: Mapping[str, object],
    further: Mapping[str, Parameter] | None = None,
) -> dict[str, tuple[float, float]]:
    """Return the bounds of each varied parameter.

    `fixed`: values of the others; `further`: parameters that the scene has not.
    """
    table = as_table(place, {} if value is None else value)
    if not table:
        raise place.error(f"{'missing' if value is None else 'empty'}, so nothing varies; {_EXAMPLE}")
    if len(table) > MAX_VARIED:
        raise place.error(f"{len(table)} parameters vary; give at most {MAX_VARIED}")
    bounds = {}
    for name, ends in table.items():
        here = place.at(name)
        parameter = (further or {}).get(name) or names.parameter(here, name)
        if name in fixed:
            raise here.error("is in [parameters] as well; give it in one of the two")
        low, high = read_pair(here, ends, f"a pair of a least and a greatest value; {_EXAMPLE}", parameter)
        if not low < high:
            why = "the least value comes first" if low > high else "move one value to [parameters]"
            raise here.error(f"{shown(ends)} is no interval; {why}")
        bounds[name] = (low, high)
    places = {name: Place(place.file, f"parameters.{name}") for name in fixed}
    names.check_substitutes(places | {name: place.at(name) for name in bounds})
    return bounds


def corners(dimensions: int) -> Float[np.ndarray, "corners dimensions"]:
    """Return the corners of the box [-1, 1]^dimensions."""
    return np.array([*product((-1.0, 1.0), repeat=dimensions)])


def draws(dimensions: int, count: int, seed: int) -> Float[np.ndarray, "count dimensions"]:
    """Return the first points of a scrambled Sobol sequence in the box [-1, 1]^dimensions."""
    return np.asarray(2 * qmc.Sobol(dimensions, seed=seed).random(count) - 1)
