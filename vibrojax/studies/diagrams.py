"""Diagrams that engineers ask for by name: Campbell, rate of penetration over the force, designer's chart."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import xarray as xr

from vibrojax.errors import InputError
from vibrojax.measures.labels import FAILED, UNDECIDED
from vibrojax.pictures.axes import scale, value_text, with_unit
from vibrojax.pictures.chart import chart
from vibrojax.pictures.contents import FORM, POINT, RATE, REGIME, RELIEF, START, lane_dims, rates_in, without_single
from vibrojax.pictures.lines import Series, axis_of_lines, line_keys, longest_axis, row_per_facet
from vibrojax.pictures.plots import FAINT, Area, Axis, Key, Layer, Line, Look, Picture, Plot, Sheet, Text, dots, key
from vibrojax.pictures.style import BIT
from vibrojax.studies.sweep import frequencies

_MODES = {"lower_frequency": "-", "upper_frequency": "-", "bit_frequency": ":", "striker_frequency": ":"}
_MODE_NAMES = {"-": "natural frequencies\nof both masses", ":": "bit alone,\nstriker alone"}
_MEAN: Look = {"size": 2.0, "edge_width": 0.8}  # of a motion that does not repeat
_MOTIONS = {"return_frequency": "o", "blows_per_second": "x"}
_MOTION_NAMES = {"return_frequency": "returns of the bit", "blows_per_second": "blows, if not one per return"}
_ONE_PER_RETURN = 1e-3  # relative difference of the two up to which blows have no mark
_ORDERS = 6  # most multiples of the rotation that are drawn
_CURVE_POINTS = 200
_RAY_LABEL = 0.06  # room of the label of a ray, as a fraction of the axis
_MOST_ONSETS = 6  # greatest number of lines whose onset is named and shaded
_FORCE = "mean_force"


def campbell(ds: xr.Dataset) -> Sheet:
    """Draw the Campbell diagram: frequencies of the motion and of the machine over the speed, or the longest axis.

    Rings are the returns of the bit per second, and crosses the blows if they are not one per return. Lines are the
    natural frequencies. If the sweep has a bit radius, the axis is the rotation speed, with its multiples as rays.
    Undecided and failed lanes are left out.

    **Raises:** `InputError` if the dataset holds no periods over an axis, or no natural frequencies.
    """
    ds = without_single(_on_a_grid(ds, "campbell"))
    known = frequencies(ds) if "period" in ds else {}
    if "lower_frequency" not in known or "period" not in ds:
        raise InputError("campbell: the dataset holds no natural frequencies and periods; give a sweep of a drill")
    x = longest_axis(ds)
    if not x.is_number:
        raise InputError("campbell: no number varies in the dataset; sweep the speed, as v or rpm")
    decided = ~ds[REGIME].isin((UNDECIDED, FAILED)) if REGIME in ds else True
    known["return_frequency"] = returns = (1 / ds["period"]).where(decided)
    if "blow_frequency" in known:
        blows = (known["blow_frequency"] / 60).where(decided)
        known["blows_per_second"] = blows.where(~(np.abs(blows - returns) <= _ONE_PER_RETURN * returns))
    drawn = {name: data for name, data in known.items() if name in (*_MODES, *_MOTIONS, "rpm")}
    ds = ds.assign({name: data for name, data in drawn.items() if name not in ds.coords}).sortby(x.name)
    turns = "rpm" in ds and x.name in ds["rpm"].dims
    by, named = axis_of_lines(ds, x.name), "cycles" in ds
    # The frame ends at zero and a little beyond the data; the rays do not change it.
    values = [ds[name].values for name in (*_MODES, *_MOTIONS) if name in ds]
    top = 1.05 * max(float(np.nanmax(part, initial=0.0)) for part in values) or 1.0
    places = ds["rpm"].values if turns else np.zeros(1)
    room = 0.05 * float(np.ptp(places))
    low, high = float(places.min()) - room, float(places.max()) + room
    across = Axis("rotation [1/min]", "rpm", (low, high), group="across") if turns else x.axis(ds)

    def nested(k: int) -> Look:
        """Return the size of the marks of a start; the marks of each further start are smaller."""
        return {"size": max(5.5 - 2.2 * k, 2.0)} if by == START else {}

    def draw(lines: list[Series]) -> Plot:
        layers: list[Layer] = []
        for k, line in enumerate(lines):
            along = line.lanes["rpm"].values if turns else x.of(line.lanes)
            for name, dash in _MODES.items():
                layers.append(
                    Line(along, np.broadcast_to(line.lanes[name].values, along.shape), FAINT, 1.5, dash, order=1.0)
                )
            for name, marker in _MOTIONS.items():
                if name in line.lanes:
                    values = np.broadcast_to(line.lanes[name].values, along.shape)
                    repeats = np.broadcast_to(line.lanes["cycles"].values > 0 if named else True, along.shape)
                    for mask, look in ((repeats, _marks(marker) | nested(k)), (~repeats, _MEAN | {"marker": marker})):
                        shown = mask & ~np.isnan(values)
                        if shown.any():
                            layers.append(dots(along[shown], values[shown], colour=line.colour, **look))
        free = np.inf  # right of it, rays have their labels
        for order in range(1, _ORDERS + 1) if turns else ():
            layers.append(Line([0.0, 2 * high], [0.0, 2 * high * order / 60], FAINT, 0.6, order=1.0))
            end = 0.98 * min(high, 60 * top / order)
            if low + _RAY_LABEL * (high - low) < end < free:
                layers.append(Text(end, order * end / 60, f"{order}n", "right", "top", size=8.0, halo=1.0))
                free = end - _RAY_LABEL * (high - low) if end < 0.98 * high else free
        return Plot(layers, across, Axis("frequency [Hz]", limits=(0.0, top), group="frequency"))

    keys: list[Key] = [key(name, colour=FAINT, dash=dash) for dash, name in _MODE_NAMES.items()]
    marks = {name: marker for name, marker in _MOTIONS.items() if name in ds and ds[name].notnull().any()}
    keys += [dots(label=_MOTION_NAMES[name], **_marks(marker)) for name, marker in marks.items()]
    keys += [dots(label="small: mean, does not repeat", **_MEAN)] * (named and bool((ds["cycles"] == 0).any()))
    lines = [replace(each, **nested(k)) for k, each in enumerate(line_keys(ds, by, dash="", **_marks("o")))]
    note = "Rays: multiples of the rotation n" if turns else ""
    return row_per_facet(ds, x, by, [draw], [keys, lines], note)


def rate_over_force(ds: xr.Dataset) -> Sheet:
    """Draw the rate of penetration over the mean force P, with the onset: the force at which penetration begins.

    The onset lies between a lane without penetration, drawn hollow, and the next one with it. Lines are the fitted law
    C ln(P/P₀).

    **Raises:** `InputError` if the dataset holds no rates over an axis.
    """
    ds = rates_in(_on_a_grid(ds, "rate-over-force"))
    if not {_FORCE, RELIEF} <= set(ds.data_vars):
        raise InputError(f"rate-over-force: the dataset holds no {_FORCE}; give a sweep of a scene with rock")
    # The axis `force` if it is swept, else the longest one.
    x = longest_axis(ds.isel({name: 0 for name in lane_dims(ds) if name != "force"}) if "force" in ds.dims else ds)
    if not x.is_number:
        raise InputError("rate-over-force: no number varies in the dataset; sweep the force, or what changes it")
    # Only this diagram needs the fits, which import SciPy's optimizers.
    from vibrojax.studies.rop_forms import FORMS
    from vibrojax.studies.rop_law import fit_rop

    fit = fit_rop(ds, along=x.name, progress=False).sel({FORM: "onset"})
    law = next(form.rate for form in FORMS if form.name == "onset")
    by = axis_of_lines(ds, x.name)
    facet_names = [name for name in lane_dims(ds) if name not in (x.name, by)]
    (factor, unit), (of_force, force_unit) = scale(ds[RATE]), scale(ds[_FORCE])
    lowest = -0.03 * factor * max(float(ds[RATE].max()), np.finfo(float).tiny)
    across = Axis(with_unit("mean force P", force_unit), _FORCE, (0.0, None), group="force")
    up = Axis(with_unit("rate of penetration", unit), RATE, (lowest, None), group="rate")
    onsets: dict[str, list[str]] = {}  # of each line, by facet
    few = ds.sizes.get(by, 1) <= _MOST_ONSETS

    def draw(lines: list[Series]) -> Plot:
        layers: list[Layer] = []
        for line in lines:
            force, rate = (np.atleast_1d(line.lanes[name].values) for name in (_FORCE, RATE))
            group = fit.sel({name: line.lanes[name].item() for name in fit["C"].dims})
            with np.errstate(all="ignore"):
                thresholds = force / np.atleast_1d(line.lanes[RELIEF].values)
            known = thresholds[~np.isnan(thresholds)]  # none of a line of lanes that failed
            threshold = np.median(known) if known.size else np.nan
            onset = float(group["eta0"]) * threshold
            # The greatest force without penetration below the least force with it, and the latter.
            above = of_force * float(np.min(force[rate > 0], initial=np.inf))
            below = of_force * float(np.max(force[(rate == 0) & (of_force * force < above)], initial=-np.inf))
            if not np.isfinite(above):
                text = "none"
            elif not np.isfinite(below):
                text = f"below {above:.4g}"
            else:
                text = f"{below:.4g}–{above:.4g}"
            where = [value_text(line.lanes[name], line.lanes[name].item()) for name in facet_names]
            onsets.setdefault(line.name, []).append(" ".join([*where, text]).removeprefix("rock: "))
            if few and np.isfinite(below):
                layers.append(Area([below, above], [-np.inf] * 2, [np.inf] * 2, line.colour, 0.15))
            for mask, face in ((rate > 0, line.colour), (rate == 0, "white")):
                layers.append(dots(of_force * force[mask], factor * rate[mask], colour=line.colour, face=face))
            if 0 < onset < float(np.nanmax(force)):
                along = np.geomspace(onset, float(np.nanmax(force)), _CURVE_POINTS)
                values = law(along / threshold, float(group["C"]), float(group["eta0"]), np.nan)
                layers.append(Line(of_force * along, factor * values, line.colour))
        return Plot(layers, across, up)

    marks: list[Key] = [dots(label="no penetration", face="white")] * bool((ds[RATE] == 0).any())
    marks += [Area(colour=FAINT, alpha=0.3, label="onset")] * few
    sheet = row_per_facet(ds, x, by, [draw], [])
    if any(isinstance(layer, Line) for plot in sheet.plots for layer in plot.layers):
        marks.insert(0, key("fit of C ln(P/P₀), not compared with other laws", width=1.2))
    lines = line_keys(ds, by) or [key("", marker="o", colour=BIT)]
    if few:
        heads = [with_unit(", ".join(filter(None, (line.label, "onset"))), force_unit) for line in lines]
        texts = ["\n".join([head, *onsets[line.label]]) for line, head in zip(lines, heads, strict=True)]
        lines = [replace(line, label=text) for line, text in zip(lines, texts, strict=True)]
    return replace(sheet, keys=[marks, lines])


DIAGRAMS: dict[str, Callable[[xr.Dataset], Picture]] = {
    "campbell": campbell,
    "chart": chart,
    "rate-over-force": rate_over_force,
}
"""Diagrams by the name under which `picture` draws them."""


def _on_a_grid(ds: xr.Dataset, diagram: str) -> xr.Dataset:
    if not lane_dims(ds) or POINT in lane_dims(ds):
        raise InputError(f"{diagram}: the dataset holds no lanes over a grid; give the dataset of a sweep with one")
    return ds


def _marks(marker: str) -> Look:
    return {"marker": marker, "size": 5.0, "face": "none", "edge_width": 1.2}
