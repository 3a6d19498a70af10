"""The analysis `tolerance`: a machine at samples of its tolerance box, and the search for extremes in it."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.errors import InputError, Place, counted, shown
from vibrojax.io.attributes import flags
from vibrojax.io.identity import IDENTITY
from vibrojax.io.kinds import dataset_attributes
from vibrojax.io.variables import VARIABLES, Variable, described
from vibrojax.lanes.labels import sweep_variables
from vibrojax.maps.bounds import MAX_TOLERANCES, corners, draws
from vibrojax.maps.dataset import attributes, certified
from vibrojax.maps.machines import several_and_single
from vibrojax.maps.read import read_point, read_sweep
from vibrojax.maps.rerun import sweep_of_dataset
from vibrojax.maps.run import run_sweep
from vibrojax.maps.sweep import Sweep
from vibrojax.measures.labels import REGIMES, UNBOUNDED
from vibrojax.pictures.axes import axis, margins, pretty_unit, quantity_text, scale, value_text, values_along
from vibrojax.pictures.colours import REGIME_COLOURS, regime_cells, regime_keys
from vibrojax.pictures.contents import POINT
from vibrojax.pictures.plots import Key, Layer, Look, Plot, Points, Sheet, dots, key, level
from vibrojax.pictures.style import IMPACT
from vibrojax.scenes import Scene
from vibrojax.settings.names import read_names
from vibrojax.settings.toml import plain_table
from vibrojax.settings.values import read_pair
from vibrojax.studies.analysis import PictureRule, SummaryPart, checked_result
from vibrojax.studies.subjects import MachineAnalysis

PLACES = ("nominal", "corner", "edge", "interior", "refined")
"""Meanings of the flags of `place`: the position of a sample in the box; refined: found from the extreme samples."""

REFINED = PLACES.index("refined")

INTERIOR_SAMPLES = 64  # number of Sobol points inside the box: a power of two, for which the points are balanced

QUANTITIES: tuple[str, ...] = ("impact_velocity", "impact_energy", "impact_power", "period", "peak_impact_force")
QUANTITIES += ("rate_of_penetration", "specific_energy")
"""Variables whose least and greatest value of the samples is stored."""

FIRST_STEP, LEAST_STEP = 0.25, 0.01
"""First and smallest step of the search, in half-widths: at the least step a smooth extreme is exact to 1e-4 of the
change over the box."""

SHRINKAGE = 0.4  # factor of the step after a round that found nothing more extreme
MAX_ROUNDS = 12  # limit of the rounds, each of which is one batch of lanes

SAME_POINT, SAME_VALUE = 1e-9, 1e-12
"""Distance in half-widths within which two points count as one, and relative range within which a quantity does."""

Units = Float[np.ndarray, "samples dimensions"]

_WORDS = {"least": ("least", -1), "most": ("greatest", 1)}  # in meanings, and the sign of what is then greatest
_MARKERS = "os^Dv"
_NOMINAL: Look = {"colour": "#999999", "width": 0.7, "dash": "--"}
_NOMINAL_POINT = dots(marker="*", size=11.0, colour=IMPACT, edge="white", edge_width=0.6, order=4.0)
_EXTREME: Look = {"marker": "o", "size": 9.0, "face": "none", "order": 3.5}
_DRAWN = ("impact_velocity", "impact_energy", "rate_of_penetration")


def toleranced(ds: xr.Dataset) -> list[str]:
    """Return the names of the parameters that have a tolerance."""
    names = (name.removeprefix("tolerance_") for name in ds.attrs if name.startswith("tolerance_"))
    return [name for name in names if name in ds.coords]


def _along_starts(ds: xr.Dataset) -> tuple[xr.Dataset, list[str]]:
    """Return a dataset along starts, and their names, of which there is none if the scene has no starts."""
    lanes = ds if "start" in ds.dims else ds.expand_dims("start")
    return lanes, [str(name) for name in lanes["start"].values] if "start" in lanes.coords else [""]


def extremes_picture(ds: xr.Dataset) -> Sheet:
    """Draw impact velocity, energy and rate of penetration of all samples over each parameter with a tolerance."""
    names, (lanes, starts) = toleranced(ds), _along_starts(ds)
    rows = [name for name in _DRAWN if name in ds and ds[name].notnull().any()] or ["period"]
    edge: Look = {"edge": "#4D4D4D", "edge_width": 0.4}
    plots = []
    for row, quantity in enumerate(rows):
        for column, name in enumerate(names):
            layers: list[Layer] = []
            for k in range(len(starts)):
                lane = lanes.isel(start=k)
                colours = [REGIME_COLOURS[int(flag)] for flag in regime_cells(lane["regime"])]
                y = lane[quantity].values * scale(lanes[quantity])[0]
                look = edge | {"marker": _MARKERS[k % len(_MARKERS)]}
                # Later starts are smaller: of samples that several starts bring to one motion, all markers show.
                size = max(6.0 / 3.0 ** (k / 2), 2.0)
                layers.append(level(y[0], order=0.0, **_NOMINAL))
                ends = [int(lane[end]) for word in _WORDS if (end := f"{quantity}_{word}_sample") in lane]
                layers.append(dots(values_along(ds[name])[ends], y[ends], **_EXTREME))
                layers.append(replace(_NOMINAL_POINT, x=values_along(ds[name])[:1], y=y[:1]))
                layers.append(Points(values_along(ds[name]), y, colours, size, **look))
            across = axis(ds[name], group=name, intervals=4)
            up = axis(lanes[quantity], group=quantity)
            plots.append(Plot(layers, across, up, place=(row, column)))
    keys: list[Key] = [dots(label=x.label, colour=x.colour, size=6.0, **edge) for x in regime_keys([lanes["regime"]])]
    for marker, start in zip(_MARKERS, starts if len(starts) > 1 else [], strict=False):
        keys.append(dots(label=f"start: {start}", marker=marker))
    keys.append(dots(label="least and greatest", **_EXTREME))
    keys += [replace(_NOMINAL_POINT, label="nominal point"), key("nominal value", **_NOMINAL)]
    missing = int(lanes[rows[0]].isnull().sum()) if rows[0] != "period" else 0
    note = counted(missing, "lane without impact is", "lanes without impact are") + " not drawn" if missing else ""
    box = ", ".join(
        f"{value_text(ds[name], float(ds[name][0]))} ± {quantity_text(float(ds.attrs[f'tolerance_{name}']), ds[name])}"
        for name in names
    )
    size = 1.8 + 2.6 * len(names), 0.9 + 2.2 * len(rows)
    return Sheet(plots, size, keys=[keys], **margins(ds, box, note))


SAMPLE_VARIABLES = {
    "place": Variable("1", "position of the sample in the tolerance box", np.int8, PLACES),
    "regime_share": Variable("1", "share of the samples in each regime"),
    "regime_kept": Variable("1", "share of the samples with the regime of the nominal point"),
    "irregular_share": Variable("1", "share of the samples whose motion is irregular, undecided or failed"),
}
"""Variables that neither lanes nor the extremes of `QUANTITIES` have."""


@dataclass(frozen=True, eq=False)
class ToleranceBox:
    """A checked box.

    - `tables`: tables of a sweep, without its points; `pairs`: nominal value and half-width by name.
    """

    tables: dict[str, Any]
    pairs: dict[str, tuple[float, float]]

    def sweep_over(self, units: Units) -> Sweep:
        """Return the sweep over points, from whose text the lanes can be run again; `units`: in half-widths."""
        points = {name: (x + width * units[:, k]).tolist() for k, (name, (x, width)) in enumerate(self.pairs.items())}
        return read_sweep({**self.tables, "points": points})

    @cached_property
    def sweep(self) -> Sweep:
        return self.sweep_over(sample_box(len(self.pairs))[0])


def sample_box(dimensions: int) -> tuple[Float[np.ndarray, "samples dimensions"], np.ndarray]:
    """Return the samples of the box [-1, 1]^dimensions and the place of each, an index into `PLACES`."""
    ends = corners(dimensions - 1)
    edges = [np.insert(ends, k, 0.0, axis=1) for k in range(dimensions) if dimensions > 1]
    groups = [np.zeros((1, dimensions)), corners(dimensions), np.concatenate([np.zeros((0, dimensions)), *edges])]
    groups.append(draws(dimensions, INTERIOR_SAMPLES, seed=0))
    return np.concatenate(groups), np.repeat(np.arange(len(groups)), [len(group) for group in groups])


def tolerance_variables(lanes: Mapping[str, Variable]) -> dict[str, Variable]:
    """Return the variables that are added to the variables of the lanes."""
    variables = dict(SAMPLE_VARIABLES)
    for name, (word, (text, _)) in product((name for name in QUANTITIES if name in lanes), _WORDS.items()):
        meaning = f"{text} {VARIABLES[name].long_name.removeprefix(f'{text} ')} of the samples"
        where = f"number of the sample with {name}_{word}; -1: no sample has a value"
        variables[f"{name}_{word}"] = Variable(lanes[name].units, meaning)
        variables[f"{name}_{word}_sample"] = Variable("1", where, np.int32)
    return variables


def tolerance(
    scene: str | Scene[Any],
    *,
    start: object = None,
    run: Mapping[str, object] | None = None,
    progress: bool = True,
    **parameters: Any,
) -> xr.Dataset:
    """Simulate a machine at samples of its tolerance box, and return extremes of variables and shares of regimes.

        box = vj.tolerance("vibro-impact", beta=0.4, gamma=(0.75, 0.01), delta=(0.005, 0.001))
        box.impact_velocity_least  # m/s, the worst of the samples from each start

    The samples are the nominal point, all corners of the box, the centres of its edges, and 64 Sobol points inside it.
    Each sample is simulated from every start. A search around the most extreme samples adds further samples, called
    *refined*.

    **Arguments:**

    - `scene`: name of a scene, or a scene.
    - `parameters`: parameters of the scene (SI), as in `simulate`. A parameter with a tolerance is a pair (nominal
      value, half-width); one to six parameters must have a tolerance.
    - `start`: initial condition, as a name or a vector, or a list of initial conditions; by default `drive` and
      `stuck`, as in a sweep.
    - `run`: settings of the simulation, as in the table `[run]` of a sweep file.

    **Returns:** a dataset with the variables of a sweep for each sample and start. Along `sample` are parameters and
    `place`, the position of the sample in the box; sample 0 is the nominal point. Along `start` are the extremes
    `NAME_least` and `NAME_most` of period, impact velocity and other variables, with the numbers of their samples
    (`NAME_least_sample`, -1 if there is none), and the shares `regime_share`, `regime_kept` (samples in the regime of
    the nominal point) and `irregular_share`. Shares leave out the refined samples.

    **Raises:** `InputError` for an invalid name or value, or if no parameter has a tolerance.

    **Example:**

    >>> machine = {"beta": 0.4, "gamma": 0.75, "delta": (0.005, 0.001), "start": "stuck"}
    >>> box = vj.tolerance("vibro-impact", **machine, progress=False)
    >>> float(box.regime_kept[0]), f"{float(box.impact_velocity_least[0]):.2f} m/s"
    (1.0, '2.21 m/s')
    """
    analysis = Tolerances()
    box = analysis.machines(Place(analysis.kind), scene, parameters, start, run or {})
    return checked_result(analysis, analysis.compute(box, progress))


class Tolerances(MachineAnalysis[ToleranceBox]):
    """Simulate a machine at samples of its tolerance box: regimes, extremes, and where they occur."""

    kind = "tolerance"
    variables = SAMPLE_VARIABLES
    pictures = (PictureRule("extremes of the samples of a tolerance box", lambda held: True, extremes_picture),)
    view = "plots"
    run_settings = ("settle", "observe", "error")
    file = "SCENE-tolerance.nc, SCENE-tolerance-2.nc, ..."
    lists, tolerances = False, True

    def machines(
        self, place: Place, scene: object, parameters: Mapping[str, object], start: object, run: Mapping[str, object]
    ) -> ToleranceBox:
        """Return the checked box: parameters with a tolerance are pairs of the nominal value and the half-width."""
        given, fixed = several_and_single(parameters)
        if not given:
            raise place.error(
                "no parameter has a tolerance; give one as delta=(0.005, 0.001), on the command line as "
                "delta=0.005+-0.001"
            )
        if len(given) > MAX_TOLERANCES:
            raise place.error(f"{len(given)} parameters have a tolerance; give at most {MAX_TOLERANCES}")
        names = read_names(place.at("scene"), scene, fixed, place)
        table, noun = plain_table(place, given, lambda: names.units), "a nominal value and a half-width above zero"
        pairs = {name: read_pair(place.at(name), pair, noun) for name, pair in table.items()}
        for name, (_, width) in pairs.items():
            if not 0 < width < np.inf:
                raise place.at(name).error(f"{shown(table[name])} is not {noun}")
        for end in (-1.0, 1.0):  # errors name the parameter, not a row of the points
            read_point(place, scene, fixed | {name: x + end * width for name, (x, width) in pairs.items()})
        tables: dict[str, Any] = {"scene": scene, "title": "Behaviour over the tolerances", "parameters": fixed}
        tables |= {"run": {name: x for name, x in run.items() if x is not None}, "unusual": True}
        if start is not None:
            several = isinstance(start, (list, tuple)) and any(isinstance(item, (str, list, tuple)) for item in start)
            tables["starts"] = start if several else [start]
        box = ToleranceBox(tables, pairs)
        if box.sweep.system.section is None:
            raise place.at("scene").error(f"{shown(box.sweep.scene)} has no section, so its motions have no regimes")
        return box

    def identity(self, spec: ToleranceBox) -> dict[str, object]:
        return spec.sweep.identity() | {f"tolerance_{name}": width for name, (_, width) in spec.pairs.items()}

    def file_name(self, spec: ToleranceBox) -> str:
        return f"{spec.sweep.scene}-tolerance.nc"

    def compute(self, spec: ToleranceBox, progress: bool = True) -> xr.Dataset:
        units, places = sample_box(len(spec.pairs))
        drawn, sampled = len(units), run_sweep(spec.sweep, progress=progress)
        ds, units, tried = refine(units, sampled, lambda units: run_sweep(spec.sweep_over(units), progress=False))
        sweep = spec.sweep_over(units)
        counts = certified(sweep, {str(name): x.values for name, x in ds.data_vars.items()})
        ds = ds.assign_attrs(attributes(sweep, json.loads(ds.attrs["solver"]), counts, ds.attrs["wall_time_s"]))
        ds = ds.rename(point="sample")
        regime = ds["regime"].transpose("sample", ...)
        rest, regimes = regime.dims[1:], regime.values[:drawn]
        shares = np.stack([(regimes == flag).mean(axis=0) for flag in range(len(REGIMES))])
        irregular = shares[list(UNBOUNDED)].sum(axis=0)
        table: dict[str, Any] = {
            "place": ("sample", np.append(places, np.full(len(units) - drawn, REFINED))),
            "regime_share": (("label", *rest), shares),
            "regime_kept": (rest, (regimes == regimes[0]).mean(axis=0)),
            "irregular_share": (rest, irregular),
        }
        for name, (word, (_, sign)) in product((name for name in QUANTITIES if name in ds), _WORDS.items()):
            x = sign * ds[name].transpose("sample", ...).values
            index = np.where(np.isnan(x), -np.inf, x).argmax(axis=0)
            table[f"{name}_{word}"] = rest, sign * np.fmax.reduce(x, axis=0)
            table[f"{name}_{word}_sample"] = rest, np.where(np.isnan(x).all(axis=0), -1, index)
        schema = tolerance_variables(sweep_variables(sweep.system))
        ds = ds.assign(described(table, schema)).assign_coords(label=list(REGIMES))
        about = dataset_attributes("tolerance", str(ds.attrs["title"]), f"tolerance {sweep.scene}")
        about |= {f"tolerance_{name}": width for name, (_, width) in spec.pairs.items()}
        obtained = f"{drawn} samples of the box, and {tried} points of a search from the extreme ones by sensitivities"
        bounds = "they are not bounds of the box" + ", in which motions are irregular" * bool(irregular.any())
        return ds.assign_attrs({**about, "extremes": f"extremes of {obtained}; {bounds}"})

    def page_cells(self, ds: xr.Dataset) -> tuple[xr.Dataset, Sweep] | None:
        points = ds[[name for name in ds.data_vars if "sample" in ds[name].dims]].rename(sample=POINT)
        points.attrs.pop(IDENTITY, None)  # it states the box, which the sweep does not have
        try:
            return points, sweep_of_dataset(points, orbits=False)
        except InputError:
            return None

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        lanes, starts = _along_starts(ds)
        shares = lanes["irregular_share"].values if "irregular_share" in lanes else np.zeros(1)
        facts, lines = {}, list[str]()
        if (shares > 0).any():
            where = [f"{100 * x:.3g} % of the samples from {start}" for x, start in zip(shares, starts, strict=True)]
            where = [text.removesuffix(" from ") for text in where]
            lines.append(
                f"irregular motions in the box ({', '.join(where)}): extremes depend on the time of observation, and "
                "other points of the box may be far beyond them"
            )
        for k, start in enumerate(starts):
            facts[start], text = _start_summary(ds, lanes.isel(start=k))
            lines += [f"from {start}:"] * bool(start) + [f"  {line}" if start else line for line in text]
        lines += [str(ds.attrs["extremes"])] * ("extremes" in ds.attrs)
        return [SummaryPart("tolerance", lines, {"tolerance": facts})]


def _start_summary(ds: xr.Dataset, lane: xr.Dataset) -> tuple[dict[str, object], list[str]]:
    def place(sample: int) -> dict[str, float]:
        return {name: float(ds[name][sample]) for name in toleranced(ds)}

    def place_text(sample: int) -> str:
        return ", ".join(value_text(ds[name], value) for name, value in place(sample).items())

    meanings, drawn = flags(ds["regime"]), lane["place"].values != REFINED
    samples, regimes = int(drawn.sum()), lane["regime"].values[drawn]
    nominal = meanings[int(regimes[0])]
    counts = {meanings[flag]: int((regimes == flag).sum()) for flag in np.unique(regimes).tolist()}
    others = [f"{name} at {count}" for name, count in counts.items() if name != nominal]
    lines = [f"{nominal} at {counts[nominal]} of {counted(samples, 'sample')}"]
    if others:
        lines[0] += f"; {', '.join(others)}, such as {place_text(int(np.flatnonzero(regimes != regimes[0])[0]))}"
    facts: dict[str, object] = {"nominal": nominal, "samples": samples, "regimes": counts}
    for name in (name for name in QUANTITIES if f"{name}_least" in lane):
        ends = {word: float(lane[f"{name}_{word}"]) for word in _WORDS}
        if not np.isfinite(ends["least"]):
            continue
        where = {word: int(lane[f"{name}_{word}_sample"]) for word in _WORDS}
        factor, unit = scale(ds[f"{name}_most"])
        low, high, middle = (f"{x * factor:.4g}" for x in (*ends.values(), float(lane[name][0])))
        middle = middle.replace("nan", "none")
        worst = "most" if name in ("peak_impact_force", "specific_energy") else "least"
        known = int(lane[name].notnull().values[drawn].sum())
        text = f"{name.replace('_', ' ')} {low} to {high} {pretty_unit(unit)}, nominal {middle}; "
        text += f"{worst} at {place_text(where[worst])}"
        text += f" ({counted(samples - known, 'sample has', 'samples have')} none)" * (known < samples)
        lines.append(text)
        facts[name] = {**ends, **{f"{word}_at": place(sample) for word, sample in where.items()}, "samples": known}
    return facts, lines


def refine(
    units: Units, ds: xr.Dataset, simulate: Callable[[Units], xr.Dataset]
) -> tuple[xr.Dataset, Float[np.ndarray, "kept dimensions"], int]:
    """Return the samples and, after them, the points that are more extreme; their places; and how many were tried.

    For each start and quantity, a search begins at the least and at the greatest sample. Its points are a step along
    each parameter, and one in all parameters, in the directions that the sensitivities near the best point predict.
    Each point is simulated, so that an extreme is never only predicted. Irregular motions are left out, because their
    extremes depend on the time of observation.
    """
    first, parts = len(units), [ds]
    best, steps = np.array(-1), np.array(FIRST_STEP)
    for _ in range(MAX_ROUNDS):
        goals = np.concatenate([_goals(part) for part in parts], axis=1)
        low, high = np.fmin.reduce(goals, axis=1), np.fmax.reduce(goals, axis=1)
        goals[high - low <= SAME_VALUE * np.abs(high)] = np.nan  # a constant, as the period that a forcing sets
        known = ~np.isnan(goals).all(axis=1)
        greatest = np.where(known, np.where(np.isnan(goals), -np.inf, goals).argmax(axis=1), -1)
        steps = np.where(known & (greatest == best), SHRINKAGE * steps, steps)
        best = greatest
        active = np.flatnonzero(known & (steps >= LEAST_STEP))
        proposals = [_proposals(units, goals[k], int(best[k]), float(steps[k])) for k in active]
        points = np.unique(np.round(np.concatenate([units[:0], *proposals]), 12), axis=0)
        apart = np.abs(points[:, None] - units[None]).max(axis=2).min(axis=1, initial=np.inf)
        points = points[apart > SAME_POINT]
        if len(points):
            parts.append(simulate(points))
            units = np.concatenate([units, points])
        elif not len(active):
            break
    added, tried = np.unique(best[best >= first]), len(units) - first
    if not len(added):
        return ds, units[:first], tried
    kept = [*range(first), *added.tolist()]
    whole = xr.concat(parts, "point", data_vars="minimal", join="override", combine_attrs="override")
    numbered = {"point": np.arange(len(kept))} if "point" in whole.coords else {}  # each part has its own numbers
    return whole.isel(point=kept).assign_coords(numbered), units[kept], tried


def _goals(ds: xr.Dataset) -> Float[np.ndarray, "searches samples"]:
    """Return what each search maximises: each quantity from each start, and its negative; NaN unless periodic."""
    periodic = [ds[name].where(ds["cycles"] > 0).transpose("point", ...) for name in QUANTITIES if name in ds]
    columns = np.concatenate([x.values.reshape(ds.sizes["point"], -1) for x in periodic], axis=1)
    return np.concatenate([columns, -columns], axis=1).T


def _proposals(
    units: Units, y: Float[np.ndarray, " samples"], best: int, step: float
) -> Float[np.ndarray, "points dimensions"]:
    """Return points of the box around the sample `best` at which `y` may be greater.

    The sensitivities are those of a linear fit to the nearest samples.
    """
    here, count = units[best], units.shape[1]
    known = np.flatnonzero(np.isfinite(y))
    near = known[np.argsort(np.abs(units[known] - here).max(axis=1), kind="stable")][: 2 * count + 2]
    slope = np.linalg.lstsq(units[near] - here, y[near] - y[best])[0]
    moves = np.concatenate([np.eye(count), -np.eye(count), np.sign(slope)[None]])
    return np.asarray(np.clip(here + step * moves, -1.0, 1.0))
