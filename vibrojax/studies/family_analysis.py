"""The analysis `family`: picture and summary of branches of periodic orbits along a parameter."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.colors import Normalize

from vibrojax.errors import Place, counted, printable
from vibrojax.io.attributes import attribute_of
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.pictures.axes import axis, label, margins, scale, values_along, with_unit
from vibrojax.pictures.branches import (
    FAMILY,
    LARGEST,
    LEADING,
    Branch,
    along_name,
    branches,
    colour_keys,
    family_layers,
    heights_of,
    kind_names,
    numbers_of,
    ranges_text,
    special_keys,
    stability_keys,
    stable_intervals,
)
from vibrojax.pictures.colours import Value
from vibrojax.pictures.plots import Axis, Layer, Line, Look, Plot, Points, Sheet, colours_of, level, upright
from vibrojax.pictures.starts import SYMBOLS
from vibrojax.pictures.style import colour_map
from vibrojax.settings.fields import given, setting
from vibrojax.studies import FAMILY_WORDS
from vibrojax.studies.analysis import PictureRule, SummaryPart
from vibrojax.studies.family import continue_families
from vibrojax.studies.family_data import FamilySpec, family_spec
from vibrojax.studies.subjects import MachineAnalysis

_VALUES_SHOWN, _FAMILIES_SHOWN = 4, 12
_DIGITS = 9  # special points are located to nine digits
_MODULUS_RANGE = (1e-2, 1e2)  # limits of the axis of the largest modulus
_HALF_PLANE = (1.2, 1.5)  # bounds of half the width of the multiplier plot
_QUANTITIES = ("impact_velocity", "slip_per_impact", "bit_amplitude", "period")  # the first available one is drawn
_PANEL_HEIGHT = 1.8  # inches


def family_lines(ds: xr.Dataset) -> list[str]:
    """Return the numbers of points and branches, special points by kind, and stable intervals of branch 0, as text."""
    facts = family_facts(ds)
    along, (low, high) = facts["along"], facts["span"]
    count = f"{counted(facts['families'], 'family', 'families')}, " if FAMILY in ds.dims else ""
    count += f"{counted(facts['points'], 'point')} on {counted(facts['branches'], 'branch', 'branches')}"
    lines = [f"{count} over {along} {low:g} to {high:g}, {counted(len(facts['special']), 'special point')}"]
    order = str(ds["special_kind"].attrs["flag_meanings"]).split()
    for kind in sorted(facts["kinds"], key=order.index):
        own = [point for point in facts["special"] if point["kind"] == kind and point["branch"] == 0]
        values = [_digits(value) for value in np.sort([float(point["value"]) for point in own])]
        others, places = facts["kinds"][kind] - len(own), []
        if values and facts["families"] > 1:
            between = f"{values[0]}" + (f" to {values[-1]}" if len(values) > 1 else "")
            places.append(f"{len(own)} on the branches 0 at {along} {between}")
        elif values:
            further = len(values) - _VALUES_SHOWN
            more = f" (and {further} more up to {values[-1]})" if further > 0 else ""
            places.append(f"{len(own)} on branch 0 at {along} {', '.join(values[:_VALUES_SHOWN])}{more}")
        if others:
            places.append(f"{others} on other branches")
        lines.append(f"{kind:<16}  {'; '.join(places)}")
    stable: dict[int, list[str]] = {family: [] for family in numbers_of(ds, "point").tolist()}
    for x in (x for x in facts["stable"] if x["branch"] == 0):
        ends = ((_digits(x[name]), x[f"{name}_kind"]) for name in ("from", "to"))
        stable[x["family"]].append(" to ".join(f"{value} ({kind})" if kind else value for value, kind in ends))
    begun = [*stable]
    if len(begun) == 1:
        where = "; ".join(stable[begun[0]])
        lines.append(f"branch 0 is stable for {along} {where}" if where else "branch 0 is stable nowhere")
    elif begun:
        lines.append("stable on branch 0:")
        shown = begun[:_FAMILIES_SHOWN]
        lines += [f"  {_name(ds, family)}: {'; '.join(stable[family]) or 'nowhere'}" for family in shown]
        lines += [f"  and {len(begun) - _FAMILIES_SHOWN} more"] * (len(begun) > _FAMILIES_SHOWN)
    else:
        lines.append("no point")
    known = ds[FAMILY].values.tolist() if FAMILY in ds.dims else []
    missing = [_name(ds, family) for family in known if family not in begun]
    more = f" and {len(missing) - _VALUES_SHOWN} more" if len(missing) > _VALUES_SHOWN else ""
    return lines + ([f"no orbit to begin with: {'; '.join(missing[:_VALUES_SHOWN])}{more}"] if missing else [])


def family_facts(ds: xr.Dataset) -> dict[str, Any]:
    """Return the summary as a dictionary, whose keys are a stable interface.

    - `along`, `span`: the parameter and its bounds; `families`, `branches`, `points`: numbers of these.
    - `kinds`: number of special points of each kind; `special`: `kind`, `value`, `family`, `branch` and `note` of each.
    - `stable`: `family`, `branch`, `from` and `to` of each stable interval. `from_kind` and `to_kind` are the kinds of
      special points at its ends.
    """
    every, kinds = list(branches(ds)), kind_names(ds)
    values, branch, notes = (ds[f"special_{name}"].values for name in ("value", "branch", "note"))
    ends_of_interval = ("from", "to", "from_kind", "to_kind")
    special = zip(kinds, values, numbers_of(ds, "special"), branch, (printable(x, 300) for x in notes), strict=True)
    return {
        "along": along_name(ds),
        "span": list(ds.attrs["span"]),
        "families": len({branch.family for branch in every}),
        "branches": len(every),
        "points": ds.sizes["point"],
        "kinds": dict(Counter(kinds)),
        "special": [dict(zip(("kind", "value", "family", "branch", "note"), row, strict=True)) for row in special],
        "stable": [
            {"family": x.family, "branch": x.number, **dict(zip(ends_of_interval, ends, strict=True))}
            for x in every
            for ends in stable_intervals(ds, x)
        ],
    }


def _digits(value: float) -> str:
    return f"{value:.{_DIGITS}g}"


def _name(ds: xr.Dataset, family: int) -> str:
    """Return a label of a family: its values of the parameters in which families differ."""
    names = [str(name) for name, data in ds.coords.items() if data.dims == (FAMILY,) and name != FAMILY]
    values = ((name, ds[name].sel(family=family).item()) for name in names)
    parts = [f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}" for name, value in values]
    return ", ".join(parts) or f"family {family}"


def families(ds: xr.Dataset, names: Sequence[str] = ()) -> Sheet:
    """Draw families over the parameter with their special points; stable orbits are solid, unstable orbits dashed.

    The panels show the impact velocity (without impacts, the bit's amplitude), the bit's position at the section, and
    the largest modulus of the multipliers. Next to the panels, the multipliers are drawn in the complex plane. Branches
    of a single family are coloured by their number of section crossings per period, and the multipliers of its first
    branch by the parameter. If there are several families, each has its own colour. Of equilibria, two states and the
    leading eigenvalues are drawn.

    `names`: variables with the dimension `point` that replace the variables of the first two panels.
    """
    standing = LEADING in ds
    if not names:
        known = [name for name in _QUANTITIES if name in ds and bool(np.isfinite(ds[name].values).any())]
        states = [str(name) for name in ds.data_vars if str(name).startswith("orbit_")]
        names = tuple(states[:2]) if standing else (*known[:1], *states[:1])
    last = LEADING if standing else LARGEST
    names = (*names, last)
    every = list(branches(ds))
    along = ds[along_name(ds)]
    plots = []
    for row, name in enumerate(names):
        layers, up = family_layers(ds, every, name), Axis(_label(ds, name), name)
        if row == len(names) - 1:  # the last panel has the stability limit
            layers = [level(0.0 if standing else 1.0, width=0.8, order=1.0), *layers]
        if name == LARGEST:
            largest = heights_of(ds, LARGEST, 1.0)
            low, high = np.nanmin(largest, initial=0.5), np.nanmax(largest, initial=1.5)
            ends = max(float(low), _MODULUS_RANGE[0]) / 1.2, min(float(high), _MODULUS_RANGE[1]) * 1.2
            up = Axis(_label(ds, name), name, ends, log=True)
        plots.append(Plot(layers, axis(along, group="along"), up, place=(row, 0)))
    height = _PANEL_HEIGHT * len(names) + 0.8
    plane, outside = _plane(ds, every)
    plots.append(replace(plane, place=(0, 1, len(names), 1)))
    keys = colour_keys(ds), [*stability_keys(ds), *special_keys(ds)]
    note, (low, high) = "", _MODULUS_RANGE
    if not standing and bool(((heights_of(ds, LARGEST, 1.0) < low) | (heights_of(ds, LARGEST, 1.0) > high)).any()):
        note = f"The largest modulus is drawn from {low:g} to {high:g}"
    about = margins(ds, ranges_text(ds, names), note, outside)
    return Sheet(plots, (12.5, height), (1.75, 1.0), (1.0,) * len(names), keys, beside=False, **about)


def _label(ds: xr.Dataset, name: str) -> str:
    if name == LARGEST:
        return "largest |multiplier|"
    if name == LEADING:
        return "largest real part of\nthe eigenvalues [1/s]"
    state = name.removeprefix("orbit_")
    where = "" if LEADING in ds else " at the section"
    words = f"{SYMBOLS.get(state, state)}{where}" if state != name else name.replace("_", " ")
    return with_unit(words, scale(ds[name])[1]).replace(" [", "\n[")


def _plane(ds: xr.Dataset, every: Sequence[Branch]) -> tuple[Plot, str]:
    """Draw the multipliers of the first branches in the complex plane, or the eigenvalues; say how many are outside."""
    parameter, many, standing = ds[along_name(ds)], FAMILY in ds.dims, LEADING in ds
    along = values_along(parameter)
    layers: list[Layer] = []
    first = min((branch.number for branch in every), default=0)
    shown = [branch for branch in every if branch.number == first]
    points = np.concatenate([np.zeros(0, int), *(branch.points for branch in shown)])
    if standing:
        layers.append(upright(0.0, width=0.9))
        values = (ds[LEADING].values + 1j * ds["eigenvalue_im"].values)[points].reshape(len(points), -1)
        sides = [1.1 * float(np.nanmax(np.abs(part), initial=1e-12)) for part in (values.real, values.imag)]
    else:
        turn = np.linspace(0.0, 2 * np.pi, 181)
        layers.append(Line(np.cos(turn), np.sin(turn), width=0.9))
        modulus, argument = ds[LARGEST].values[points], ds["multiplier_arg"].values[points]
        sides = [float(np.clip(1.1 * modulus[np.isfinite(modulus)].max(initial=0.0), *_HALF_PLANE))] * 2
        values = (modulus * np.exp(1j * argument)).reshape(len(points), -1)
    norm = Normalize(along[points].min(), along[points].max()) if len(points) else Normalize(0.0, 1.0)
    look: Look = {"colours": colours_of(along[points], colour_map(), norm), "sizes": 3.5, "values": along[points]}
    if many:
        look = {"colours": [branch.colour for branch in shown for _ in branch.points.tolist()], "sizes": 2.2}
    for column in values.T if len(points) else ():
        for mirrored in (column, column.conj()):
            layers.append(Points(mirrored.real, mirrored.imag, order=3.0, **look))
    name, unit = str(parameter.name), " [1/s]" * standing
    value = Value(name, label(parameter, 60), scale(parameter)[0], norm, "neither", colour_map())
    parts = zip(("real", "imaginary"), sides, strict=True)
    across, up = (Axis(f"{part} part{unit}", limits=(-x, x)) for part, x in parts)
    title = f"{'eigenvalues' if standing else 'multipliers'} of branch {first}"
    plot = Plot(layers, across, up, title, square=not standing, scale=None if many else value)
    largest = values[:, 0] if len(points) else np.zeros(0)
    outside = int(((np.abs(largest.real) > sides[0]) | (np.abs(largest.imag) > sides[1])).sum())
    note = f"The plane leaves out {outside} of {len(points)} orbits' largest multiplier" if outside else ""
    return plot, note


_SYNTAX = "along=NAME at=VALUE from=A to=B"


@dataclass(frozen=True, kw_only=True)
class Families(MachineAnalysis[FamilySpec]):
    """Follow a family of periodic orbits or equilibria, stable and unstable, along one parameter."""

    kind, command = "family", "follow"
    file, view = "SCENE-NAME.nc, SCENE-NAME-2.nc, ...", "families"
    terms = FAMILY_WORDS
    pictures = (PictureRule("families", lambda held: True, families),)

    along: object = setting(None, f"{_SYNTAX}: the parameter, its value at the first orbit, and its bounds", read=given)
    at: object = setting(None, "", read=given)
    from_hopf: object = setting(
        None, "from-hopf=FILE.nc: a family of equilibria; orbits begin at its Hopf points", read=given
    )
    span: object = setting(None, "", read=given)
    cycles: object = setting(
        MOST_CYCLES,
        "most returns per period on branches that begin at period doublings; 0: follow equilibria",
        read=given,
    )

    def view_of(self, ds: xr.Dataset) -> str:
        return "plots" if LEADING in ds else self.view

    @classmethod
    def words(cls) -> tuple[str, ...]:
        return ("along", "at", "from", "to", "cycles", "from-hopf", "from_hopf", "start", *cls.run_settings)

    @classmethod
    def of_words(cls, values: dict[str, Any]) -> dict[str, Any]:
        values["from_hopf"] = values.pop("from-hopf", values.get("from_hopf"))
        missing = [name for name in ("along", "at", "from", "to") if name not in values]
        if (missing and values["from_hopf"] is None) or len({"from", "to"} & set(missing)) == 1:
            raise Place("follow").error(f"{' and '.join(missing)} missing; write vibrojax follow SCENE {_SYNTAX}")
        return values | {"span": (values.pop("from"), values.pop("to")) if "from" in values else None}

    def machines(
        self, place: Place, scene: object, parameters: Mapping[str, object], start: object, run: Mapping[str, object]
    ) -> FamilySpec:
        times, begin = (run.get("settle"), run.get("observe")), {"start": start, "from_hopf": self.from_hopf}
        return family_spec(scene, self.along, self.at, self.span, begin, *times, self.cycles, parameters)

    def identity(self, request: FamilySpec) -> dict[str, object]:
        return request.identity()

    def file_name(self, request: FamilySpec) -> str:
        return f"{request.sweep.scene}-{request.along}.nc"

    def compute(self, request: FamilySpec, progress: bool = True) -> xr.Dataset:
        return continue_families(request, progress)

    def facts(self, ds: xr.Dataset, request: FamilySpec) -> Mapping[str, object]:
        machine = {"scene": ds.attrs["scene"], "start": ds.attrs.get("start")}
        return {**machine, "parameters": attribute_of(ds, "parameters"), **family_facts(ds)}

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        return [SummaryPart("families", family_lines(ds), {"families": family_facts(ds)})]
