"""The specification of `curves`: a family, a second parameter with its bounds, and the special points to continue."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.errors import Place, shown
from vibrojax.io.attributes import parameters_of, text_of
from vibrojax.io.kinds import SPECIAL_KINDS, kind_of
from vibrojax.maps.read import read_point
from vibrojax.periodic.codim2 import CONTINUED
from vibrojax.physics.meanings import suggest_parameter
from vibrojax.physics.parameters import ROTATION
from vibrojax.pictures.branches import along_name, family_coordinates, family_numbers, kind_names, numbers_of
from vibrojax.scenes import Scene
from vibrojax.settings.names import Names, read_names
from vibrojax.settings.values import UnusualValue
from vibrojax.studies.family_run import read_span

SAME_VALUE = 1e-7
"""Difference of the parameter, relative to its range, up to which special points of one kind on one branch are one."""


@dataclass(frozen=True, eq=False)
class CurvesSpec:
    """A checked specification.

    - `family`: dataset of the families; `scene`, `options`: scene with its options by name.
    - `along`, `first_span`: parameter of the families, and its bounds; `by`, `span`: second parameter, and its bounds.
    - `special`: indices of the special points; `at`: parameter and value of the crossings, or None.
    - `parameters`: all parameters of each special point, by name.
    """

    family: xr.Dataset
    scene: Scene[Any]
    options: Mapping[str, str]
    along: str
    first_span: tuple[float, float]
    by: str
    span: tuple[float, float]
    special: list[int]
    at: tuple[str, float] | None
    parameters: Mapping[str, np.ndarray]

    def identity(self) -> dict[str, object]:
        """Return all settings on which the result depends, as flat JSON values."""
        values = {"by": self.by, "from": self.span[0], "to": self.span[1], "special": list(self.special)}
        return {"curves": True, "history": text_of(self.family, "history")} | values | {"at": list(self.at or ())}


def read_curves(family: object, by: object, span: object, special: object, at: object) -> CurvesSpec:
    """Check the arguments of `curves`, and return the specification.

    **Raises:** `InputError` with a one-line message at the first invalid argument.
    """
    place = Place("curves")
    if not isinstance(family, xr.Dataset) or kind_of(family) != "family":
        raise place.at("family").error("is not a family of orbits; give what vj.follow or vibrojax follow has made")
    if "eigenvalue_re" in family:
        raise place.at("family").error("holds equilibria; give a family of orbits, which follow(from_hopf=...) begins")
    along = along_name(family)
    fixed: dict[str, Any] = dict(parameters_of(family))
    names = _names(place, family)
    if not isinstance(by, str) or by not in names.parameters:
        raise place.at("by").error(
            f"{shown(by)} is not a parameter of the scene; {suggest_parameter(str(by), names.parameters)}"
        )
    if by == along:
        raise place.at("by").error(f"{by} is the parameter of the family; give another one")
    several = family_coordinates(family, "special")
    if "rock" in several:
        raise place.at("family").error("holds families of several rocks; follow those of one rock")
    if by in (*ROTATION, "rpm") and by != "v":
        raise place.at("by").error(f"{by} is not continued; give v")
    low, high = read_span(place, names, by, span)
    kinds = continued_kinds(family)
    chosen = _special(place, special, family, kinds)
    values = {name: np.full(len(chosen), value) for name, value in fixed.items() if name in names.parameters}
    for name in (name for name in several if name in names.parameters):
        own = several[name][chosen].astype(float)
        if name in fixed and np.any(own != fixed[name]):
            raise place.at("family").error(
                f"its orbits are at {name} = {fixed[name]:g}, not {own[0]:g}; follow it there"
            )
        values[name] = own
    if missing := names.parameters.keys() - values.keys() - {along}:
        raise place.at("family").error(
            f"its value of {min(missing)} is not known; select families with isel, without drop=True"
        )
    values[along] = family["special_value"].values[chosen].astype(float)
    outside = ~((values[by] >= low) & (values[by] <= high))
    if outside.any():
        value = float(values[by][outside][0])
        raise place.at("from").error(f"the family is at {by} = {value:g}, which is not between {low:g} and {high:g}")
    first, last = (float(x) for x in family.attrs["span"])
    line = _line(place, names, at, {along: (first, last), by: (low, high)})
    return CurvesSpec(
        family, names.system, dict(names.options), along, (first, last), by, (low, high), chosen, line, values
    )


def continued_kinds(family: xr.Dataset) -> list[str]:
    """Return the kind of each special point; events that bear their own name are continued like sticks."""
    return [kind if kind in SPECIAL_KINDS else "stick" for kind in kind_names(family)]


def _names(place: Place, family: xr.Dataset) -> Names:
    """Return the names of the family's scene with its options."""
    scene = text_of(family, "scene")
    options = {name: text_of(family, name) for name in ("friction", "pulse_shape") if name in family.attrs}
    names = read_names(place.at("scene"), scene, dict(options), place)
    with warnings.catch_warnings():  # `follow` has already warned
        warnings.simplefilter("ignore", UnusualValue)
        read_point(place, names.system, parameters_of(family), None)
    return names


def _special(place: Place, special: object, family: xr.Dataset, kinds: list[str]) -> list[int]:
    """Return the indices of the special points to continue."""
    held = np.flatnonzero(np.isin(numbers_of(family, "special"), family_numbers(family))).tolist()
    if special is None:
        continued = _distinct(family, [k for k in held if kinds[k] in CONTINUED])
        if not continued:
            raise place.error("the family has no special point that can be continued; follow it further")
        return continued
    given: list[Any] = list(special) if isinstance(special, list | tuple | np.ndarray) else [special]
    for k in given:
        if isinstance(k, bool) or not isinstance(k, int | np.integer) or not 0 <= k < len(kinds):
            raise place.at("special").error(f"{shown(k)} is not a number from 0 to {len(kinds) - 1}")
        if k not in held:
            raise place.at("special").error(f"{k} is of a family that the dataset does not hold")
        if kinds[k] not in CONTINUED:
            raise place.at("special").error(f"{k} is of the kind {kinds[k]}; continued are {', '.join(CONTINUED)}")
    return [int(k) for k in given]


def _distinct(family: xr.Dataset, special: list[int]) -> list[int]:
    """Return the special points without those that a branch has passed before."""
    kinds, values = family["special_kind"].values, family["special_value"].values
    number, branch = numbers_of(family, "special"), family["special_branch"].values
    first, last = family.attrs["span"]
    kept: list[int] = []
    for k in special:
        own = [i for i in kept if (kinds[i], number[i], branch[i]) == (kinds[k], number[k], branch[k])]
        if all(abs(values[i] - values[k]) > SAME_VALUE * (last - first) for i in own):
            kept.append(k)
    return kept


def _line(place: Place, names: Names, at: object, spans: Mapping[str, tuple[float, float]]) -> tuple[str, float] | None:
    """Return the parameter and the value at which crossings are located, or None."""
    if at is None:
        return None
    if not isinstance(at, Mapping) or len(at) != 1 or next(iter(at)) not in spans:
        wrong = " and ".join(map(str, at)) if isinstance(at, Mapping) else at
        raise place.at("at").error(f"{shown(wrong)} is not {' or '.join(spans)} with a value; give one of them")
    [(name, given)] = at.items()
    value, (low, high) = names.quantity(place.at("at").at(name), name, given), spans[name]
    if not low <= value <= high:
        raise place.at("at").at(name).error(f"{value:g} is not between {low:g} and {high:g}, the bounds of the curves")
    return name, value
