"""The analysis `curves`: picture and summary of special points over two parameters."""

from collections import Counter
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.errors import InputError, counted, printable
from vibrojax.io.attributes import flags
from vibrojax.io.kinds import OF_CURVES
from vibrojax.pictures.axes import axis, margins, scale
from vibrojax.pictures.overlays import axes_of, codim2_layers, curve_layers
from vibrojax.pictures.plots import Layer, Plot, Sheet, dots
from vibrojax.studies.analysis import Analysis, PictureRule, SummaryPart

_MOST_NOTES = 4  # lines of the summary for single curves
_DIGITS = 9  # crossings and points of codimension two are located to nine digits


def curves_picture(ds: xr.Dataset) -> Sheet:
    """Draw curves of special points over two parameters, with their points of codimension two and their crossings."""
    x, y = axes_of(ds)
    layers: list[Layer] = [*curve_layers(ds, np.ones(ds.sizes["curve"], bool), x, y), *codim2_layers([ds], x, y)]
    if ds.sizes.get("crossing", 0):
        places = [scale(ds[name])[0] * ds[f"crossing_{name}"].values for name in (x, y)]
        layers.append(dots(*places, label="crossing", marker="x", size=6.0, order=4.0))
    limits = {name: [scale(ds[name])[0] * bound for bound in bounds] for name, bounds in bounds_of(ds).items()}
    across, up = (axis(ds[name], limits=tuple(limits[name])) for name in (x, y))
    note = "Lines: orbits at which the motion changes, stable or not"
    return Sheet([Plot(layers, across, up)], (8.4, 5.2), beside=False, **margins(ds, note))


def bounds_of(ds: xr.Dataset) -> dict[str, tuple[float, float]]:
    """Return the bounds of both parameters, by name."""
    values = np.asarray(ds.attrs.get("bounds", ()), float).ravel()
    if len(values) != 4 or not np.isfinite(values).all():
        raise InputError("attribute bounds: does not hold the lower and upper bounds of both parameters")
    return dict(zip(axes_of(ds), [(values[0], values[1]), (values[2], values[3])], strict=True))


def curves_facts(ds: xr.Dataset) -> dict[str, Any]:
    """Return the summary as a dictionary, whose keys are a stable interface.

    - `axes`, `bounds`: the two parameters; `points`: number of points.
    - `curves`: `kind`, `special`, `points` and `note` of each curve.
    - `codim2`: `kind`, `curve` and the two parameters of each point; `crossings`: `curve` and the two parameters.
    """
    names, meanings = axes_of(ds), flags(ds["kind"])
    sizes = np.bincount(ds["point_curve"].values, minlength=ds.sizes["curve"]).tolist()
    columns = ds["kind"].values.tolist(), ds["special"].values.tolist(), sizes, ds["curve_note"].values
    curves = [
        {"kind": meanings[kind], "special": special, "points": size, "note": printable(note, 300)}
        for kind, special, size, note in zip(*columns, strict=True)
    ]

    def places(dimension: str) -> list[dict[str, Any]]:
        return [
            {"curve": int(ds[f"{dimension}_curve"][k])} | {name: float(ds[f"{dimension}_{name}"][k]) for name in names}
            for k in range(ds.sizes.get(dimension, 0))
        ]

    kinds = [{"kind": printable(kind, 100)} for kind in ds["codim2_kind"].values]
    return {
        "axes": list(names),
        "bounds": {name: [float(x) for x in pair] for name, pair in bounds_of(ds).items()},
        "points": ds.sizes["point"],
        "curves": curves,
        "codim2": [kind | place for kind, place in zip(kinds, places("codim2"), strict=True)],
        "crossings": places("crossing"),
    }


def curves_lines(ds: xr.Dataset) -> list[str]:
    """Return the summary as lines of text: curves with their ends, points of codimension two, and crossings."""
    facts, names = curves_facts(ds), axes_of(ds)
    spans = " and ".join(f"{name} {low:g} to {high:g}" for name, (low, high) in facts["bounds"].items())
    lines = [f"{counted(len(facts['curves']), 'curve')}, {counted(facts['points'], 'point')} over {spans}"]
    kinds = Counter(curve["kind"] for curve in facts["curves"])
    lines.append(", ".join(f"{count} {kind}" for kind, count in kinds.items()))
    for k, curve in enumerate(facts["curves"][:_MOST_NOTES]):
        size = counted(curve["points"], "point")
        special = f" (special point {curve['special']})" if curve["special"] >= 0 else ""
        lines.append(f"curve {k}, {curve['kind']}{special}: {size}; {curve['note']}")
    if len(facts["curves"]) > _MOST_NOTES:
        lines.append(f"and {counted(len(facts['curves']) - _MOST_NOTES, 'more curve')}")

    def at(place: dict[str, Any]) -> str:
        return f"{', '.join(f'{name} = {place[name]:.{_DIGITS}g}' for name in names)} (curve {place['curve']})"

    lines += [f"{place['kind']} at {at(place)}" for place in facts["codim2"]]
    lines += [f"crossing at {at(place)}" for place in facts["crossings"]]
    return lines


class Curves(Analysis):
    """Continue the special points of a family of orbits in a second parameter, with points of codimension two."""

    kind = "curves"
    variables = OF_CURVES
    counted = "curve"
    view = "orbits"
    pictures = (PictureRule("curves of special points", lambda held: True, curves_picture),)

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        return [SummaryPart("curves", curves_lines(ds), {"curves": curves_facts(ds)})]
