"""The analysis `tolerance`: a machine at samples of the box of its parameter tolerances."""

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from scipy.stats import qmc

from vibrojax.errors import Place, counted, shown
from vibrojax.io.attributes import flags
from vibrojax.io.kinds import dataset_attributes
from vibrojax.io.variables import VARIABLES, Variable
from vibrojax.maps.bounds import MAX_TOLERANCES
from vibrojax.maps.dataset import attributes, certified
from vibrojax.maps.read import read_point, read_sweep
from vibrojax.maps.run import run_sweep
from vibrojax.maps.sweep import Sweep
from vibrojax.measures.labels import REGIMES, UNBOUNDED
from vibrojax.physics.arrays import check_untraced
from vibrojax.pictures.axes import axis, margins, pretty_unit, scale, values_along
from vibrojax.pictures.colours import REGIME_COLOURS, regime_cells, regime_keys
from vibrojax.pictures.plots import Layer, Look, Plot, Points, Sheet, dots, key, level
from vibrojax.pictures.style import IMPACT
from vibrojax.scenes import Scene
from vibrojax.studies.analysis import PictureRule, SummaryPart
from vibrojax.studies.subjects import MachineAnalysis

PLACES = ("nominal", "corner", "edge", "interior", "refined")
"""Meanings of the flags of `place`: the position of a sample in the box; refined: found from the extreme samples."""

REFINED = PLACES.index("refined")

INTERIOR_SAMPLES = 64
"""Number of Sobol points inside the box: a power of two, for which the points are balanced."""

QUANTITIES = (
    "impact_velocity",
    "impact_energy",
    "impact_power",
    "period",
    "peak_impact_force",
    "rate_of_penetration",
    "specific_energy",
)
"""Variables whose least and greatest value of the samples is stored."""

_WORDS = {"least": "least", "most": "greatest"}

FIRST_STEP, LEAST_STEP = 0.25, 0.01
"""First and smallest step of the search, in half-widths: at the least step a smooth extreme is exact to 1e-4 of the
change over the box."""

SHRINKAGE = 0.4
"""Factor of the step after a round that found nothing more extreme."""

MAX_ROUNDS = 12
"""Limit of the rounds, each of which is one batch of lanes."""

SAME_POINT = 1e-9
"""Distance in half-widths within which two points count as one."""

Units = Float[np.ndarray, "samples dimensions"]


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
    steps: dict[tuple[str, int, float], tuple[int, float]] = {}
    for _ in range(MAX_ROUNDS):
        points = np.zeros((0, units.shape[1]))
        for name in (name for name in QUANTITIES if name in ds):
            periodic = (part[name].where(part["cycles"] > 0).transpose("point", ...).values for part in parts)
            values = np.concatenate([x.reshape(len(x), -1) for x in periodic])
            for start, sign in product(range(values.shape[1]), (1.0, -1.0)):
                y = sign * values[:, start]
                if not np.isfinite(y).any():
                    continue
                best = int(np.nanargmax(y))
                before, step = steps.get((name, start, sign), (best, FIRST_STEP))
                step *= SHRINKAGE if (name, start, sign) in steps and before == best else 1.0
                steps[name, start, sign] = best, step
                if step >= LEAST_STEP:
                    points = np.concatenate([points, _proposals(units, y, best, step)])
        points = np.unique(np.round(points, 12), axis=0)
        apart = np.abs(points[:, None] - units[None]).max(axis=2).min(axis=1, initial=np.inf)
        points = points[apart > SAME_POINT]
        if len(points):
            parts.append(simulate(points))
            units = np.concatenate([units, points])
        elif all(step < LEAST_STEP for _, step in steps.values()):
            break
    added, tried = sorted({best for best, _ in steps.values() if best >= first}), len(units) - first
    if not added:
        return ds, units[:first], tried
    kept = [*range(first), *added]
    whole = xr.concat(parts, "point", data_vars="minimal", join="override", combine_attrs="override")
    return whole.isel(point=kept), units[kept], tried


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


_TOLERANCE = "tolerance_"
_MARKERS = "os^Dv"
_NOMINAL: Look = {"colour": "#999999", "width": 0.7, "dash": "--"}
_NOMINAL_POINT = dots(marker="*", size=11.0, colour=IMPACT, edge="white", edge_width=0.6, order=4.0)
_DRAWN = ("impact_velocity", "impact_energy", "rate_of_penetration")


def toleranced(ds: xr.Dataset) -> list[str]:
    """Return the names of the parameters that have a tolerance."""
    names = [name.removeprefix(_TOLERANCE) for name in ds.attrs if name.startswith(_TOLERANCE)]
    return [name for name in names if name in ds.coords]


def extremes_picture(ds: xr.Dataset) -> Sheet:
    """Draw impact velocity, energy and rate of penetration of all samples over each parameter with a tolerance."""
    names = toleranced(ds)
    rows = [name for name in _DRAWN if name in ds and ds[name].notnull().any()] or ["period"]
    lanes = ds if "start" in ds.dims else ds.expand_dims("start")
    starts = [str(name) for name in np.atleast_1d(lanes["start"].values)] if "start" in lanes.coords else [""]
    plots = []
    for row, quantity in enumerate(rows):
        for column, name in enumerate(names):
            layers: list[Layer] = []
            for k in range(len(starts)):
                lane = lanes.isel(start=k)
                colours = [REGIME_COLOURS[int(flag)] for flag in regime_cells(lane["regime"])]
                y = lane[quantity].values * scale(lanes[quantity])[0]
                look: Look = {"marker": _MARKERS[k % len(_MARKERS)], "edge": "#4D4D4D", "edge_width": 0.4}
                # Later starts are smaller: of samples that several starts bring to one motion, all markers show.
                size = max(6.0 / 3.0 ** (k / 2), 2.0)
                layers.append(level(y[0], order=0.0, **_NOMINAL))
                layers.append(replace(_NOMINAL_POINT, x=values_along(ds[name])[:1], y=y[:1]))
                layers.append(Points(values_along(ds[name]), y, colours, size, **look))
            across = axis(ds[name], group=name, margin=0.08, intervals=4)
            up = axis(lanes[quantity], group=quantity, margin=0.08)
            plots.append(Plot(layers, across, up, place=(row, column)))
    keys = regime_keys([lanes["regime"]])
    for marker, start in zip(_MARKERS, starts if len(starts) > 1 else [], strict=False):
        keys.append(dots(label=f"start: {start}", colour="#4D4D4D", marker=marker))
    keys += [replace(_NOMINAL_POINT, label="nominal point"), key("nominal value", **_NOMINAL)]
    missing = int(lanes[rows[0]].isnull().sum()) if rows[0] != "period" else 0
    note = counted(missing, "lane without impact is", "lanes without impact are") + " not drawn" if missing else ""
    size = 1.8 + 2.6 * len(names), 0.9 + 2.2 * len(rows)
    return Sheet(plots, size, (1.0,) * len(names), (1.0,) * len(rows), [keys], **margins(ds, note))


SAMPLE_VARIABLES = {
    "place": Variable("1", "position of the sample in the box", np.int8, PLACES),
    "regime_share": Variable("1", "share of the samples in the regime"),
    "regime_kept": Variable("1", "share of the samples whose regime is that of the nominal point"),
    "irregular_share": Variable("1", "share of the samples whose motion is irregular, undecided or failed"),
}
"""Variables that neither lanes nor the extremes of `QUANTITIES` have."""


@dataclass(frozen=True, eq=False)
class ToleranceBox:
    """A checked specification.

    - `tables`: tables of a sweep, without its points; `nominal`, `half_widths`: nominal values and half-widths by name.
    - `units`: the samples in half-widths from the nominal point; `places`: the place of each.
    """

    tables: dict[str, Any]
    nominal: dict[str, float]
    half_widths: dict[str, float]
    units: Units
    places: np.ndarray

    def points(self, units: Units) -> dict[str, np.ndarray]:
        """Return the parameters of points by name; `units`: in half-widths from the nominal point."""
        return {name: x + self.half_widths[name] * units[:, k] for k, (name, x) in enumerate(self.nominal.items())}

    def sweep_over(self, units: Units) -> Sweep:
        """Return the sweep over points, with the text of a sweep file from which the lanes can be run again."""
        points = {name: column.tolist() for name, column in self.points(units).items()}
        return read_sweep({**self.tables, "points": points})

    @cached_property
    def sweep(self) -> Sweep:
        """The sweep over the samples."""
        return self.sweep_over(self.units)


def tolerance_variables(names: Iterable[str]) -> dict[str, Variable]:
    """Return the variables that are added to `names`, the variables of the lanes."""
    held = [name for name in QUANTITIES if name in names]
    extremes = [_extreme(name, word) for name in held for word in _WORDS]
    return SAMPLE_VARIABLES | {name: about for pair in extremes for name, about in pair.items()}


def _extreme(name: str, word: str) -> dict[str, Variable]:
    """Return the schema of the least or greatest value of a quantity, and of the sample that has it."""
    long_name = VARIABLES[name].long_name.removeprefix(f"{_WORDS[word]} ")
    return {
        f"{name}_{word}": Variable(VARIABLES[name].units, f"{_WORDS[word]} {long_name} of the samples"),
        f"{name}_{word}_sample": Variable("1", f"sample with {name}_{word}; -1: the quantity exists nowhere", np.int32),
    }


def tolerance(
    scene: str | Scene[Any],
    *,
    start: object = None,
    run: Mapping[str, object] | None = None,
    progress: bool = True,
    **parameters: Any,
) -> xr.Dataset:
    """Simulate a machine at samples of the box of its parameter tolerances, and return their extremes and regimes.

        box = vj.tolerance("vibro-impact", beta=0.4, gamma=(0.75, 0.01), delta=(0.005, 0.001))
        box.impact_velocity_least  # m/s, the worst of the samples from each start

    The samples are the nominal point, all corners of the box, the centres of its edges, and 64 Sobol points inside it.
    Each sample runs from every start. From the extreme samples of periodic motions, a search with shrinking steps,
    along the parameters and in the direction that their sensitivities predict, simulates further points; those that are
    more extreme become samples, too. Between the samples the behaviour is not known: the extremes are not bounds of the
    box, least of all where motions are irregular.

    **Arguments:**

    - `scene`: name of a scene, or a scene.
    - `parameters`: parameters of the scene (SI), as in `simulate`. A pair (nominal value, half-width) is a tolerance;
      at least one parameter and at most six have one.
    - `start`: initial condition, a name or a vector, or a list of these; by default those of a sweep of the scene
      (drive and stuck), without other named starts such as touching.
    - `run`: settings of the simulation, as in the table `[run]` of a sweep file.
    - `progress`: True to report progress on stderr.

    **Returns:** a dataset.

    - Along `sample` and `start`: the variables of a sweep; along `sample`: the parameters, and `place` (nominal,
      corner, edge, interior or refined). Sample 0 is the nominal point.
    - Along `start`, for period, impact velocity, impact energy, peak force and rate of penetration:
      `NAME_least` and `NAME_most` over the samples where the quantity exists, and `NAME_least_sample` and
      `NAME_most_sample`, the samples that have these values (-1 if there is none).
    - `regime_share` along `label` and `start`, `regime_kept`, the share of samples in the nominal regime, and
      `irregular_share`, all without the refined samples.
    - The attribute `extremes` says how the extremes were obtained.

    **Raises:** `InputError` for an invalid name or value, or if no parameter has a tolerance.

    **Example:**

    >>> machine = {"beta": 0.4, "gamma": 0.75, "delta": (0.005, 0.001), "start": "stuck"}
    >>> box = vj.tolerance("vibro-impact", **machine, progress=False)
    >>> float(box.regime_kept[0]), f"{float(box.impact_velocity_least[0]):.2f} m/s"
    (1.0, '2.21 m/s')
    """
    analysis = Tolerances()
    box = analysis.machines(Place(analysis.kind), scene, parameters, start, run or {})
    return analysis.compute(box, progress)


class Tolerances(MachineAnalysis[ToleranceBox]):
    """Simulate a machine at samples of the box of its tolerances: regimes, extremes, and where they occur."""

    kind = "tolerance"
    variables = SAMPLE_VARIABLES
    pictures = (PictureRule("extremes of the samples of a tolerance box", lambda held: True, extremes_picture),)
    view = "plots"
    run_settings = ("settle", "observe", "error")
    file, lists, tolerances = "SCENE-tolerance.nc", False, True

    def machines(
        self, place: Place, scene: object, parameters: Mapping[str, object], start: object, run: Mapping[str, object]
    ) -> ToleranceBox:
        """Return the checked box: parameters with a tolerance are pairs of the nominal value and the half-width."""
        pairs = {name: x for name, x in parameters.items() if isinstance(x, (tuple, list))}
        if not pairs:
            raise place.error(
                "no parameter has a tolerance; give one as delta=(0.005, 0.001), on the command line as "
                "delta=0.005+-0.001"
            )
        if len(pairs) > MAX_TOLERANCES:
            raise place.error(f"{len(pairs)} parameters have a tolerance; give at most {MAX_TOLERANCES}")
        nominal, half_widths = {}, {}
        for name, pair in pairs.items():
            for x in pair:
                check_untraced(place.at(name).error, x)
            numbers = all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in pair)
            if len(pair) != 2 or not numbers or not (np.isfinite(pair[1]) and pair[1] > 0):
                raise place.at(name).error(f"{shown(pair)} is not a nominal value and a half-width above zero")
            nominal[name], half_widths[name] = float(pair[0]), float(pair[1])
        fixed = {name: x for name, x in parameters.items() if name not in pairs}
        for end in (-1.0, 1.0):  # errors name the parameter, not a row of the points
            read_point(place, scene, fixed | {name: x + end * half_widths[name] for name, x in nominal.items()})
        tables: dict[str, Any] = {
            "scene": scene,
            "parameters": fixed,
            "run": {name: x for name, x in run.items() if x is not None},
            "unusual": True,
        }
        tables["title"] = "Behaviour over the tolerances"
        if start is not None:
            several = isinstance(start, (list, tuple)) and any(isinstance(item, (str, list, tuple)) for item in start)
            tables["starts"] = start if several else [start]
        box = ToleranceBox(tables, nominal, half_widths, *sample_box(len(pairs)))
        if box.sweep.system.section is None:
            raise place.at("scene").error(f"{shown(box.sweep.scene)} has no section, so its motions have no regimes")
        return box

    def file_name(self, asked: ToleranceBox) -> str:
        return f"{asked.sweep.scene}-tolerance.nc"

    def identity(self, asked: ToleranceBox) -> dict[str, object]:
        widths = {f"tolerance_{name}": width for name, width in asked.half_widths.items()}
        return asked.sweep.identity() | widths

    def compute(self, asked: ToleranceBox, progress: bool = True) -> xr.Dataset:
        """Run all samples from all starts, and return the dataset of [vibrojax.studies.tolerance.tolerance][]."""
        sampled = run_sweep(asked.sweep, progress=progress)
        ds, units, tried = refine(
            asked.units,
            sampled,
            lambda units: run_sweep(replace(asked.sweep, points=asked.points(units)), progress=False),
        )
        if ds is not sampled:
            sweep = asked.sweep_over(units)
            counts = certified(sweep, {str(name): x.values for name, x in ds.data_vars.items()})
            ds = ds.assign_attrs(attributes(sweep, json.loads(ds.attrs["solver"]), counts, ds.attrs["wall_time_s"]))
        ds = ds.rename(point="sample")
        places = np.concatenate([asked.places, np.full(len(units) - len(asked.units), REFINED)])
        ds["place"] = ("sample", places.astype(np.int8), SAMPLE_VARIABLES["place"].attributes())
        regime = ds["regime"].transpose("sample", ...)
        drawn, rest = regime.values[: len(asked.places)], regime.dims[1:]
        shares = np.stack([(drawn == flag).mean(axis=0) for flag in range(len(REGIMES))])
        ds = ds.assign_coords(label=list(REGIMES))
        unbounded = shares[list(UNBOUNDED)].sum(axis=0)
        table = {
            "regime_share": (("label", *rest), shares),
            "regime_kept": (rest, (drawn == drawn[0]).mean(axis=0)),
            "irregular_share": (rest, unbounded),
        }
        for name, (dims, values) in table.items():
            ds[name] = (dims, values, SAMPLE_VARIABLES[name].attributes())
        for name in (name for name in QUANTITIES if name in ds):
            x = ds[name].transpose("sample", ...).values
            unknown = np.isnan(x).all(axis=0)
            for word, worst, choose in (("least", np.inf, np.argmin), ("most", -np.inf, np.argmax)):
                index = choose(np.where(np.isnan(x), worst, x), axis=0)
                extreme = np.where(unknown, np.nan, np.take_along_axis(x, index[None], axis=0)[0])
                sample = np.where(unknown, -1, index).astype(np.int32)
                for (variable, known), values in zip(_extreme(name, word).items(), (extreme, sample), strict=True):
                    unit = {"units": ds[name].attrs["units"]} if variable == f"{name}_{word}" else {}
                    ds[variable] = (rest, values, known.attributes() | unit)
        about = dataset_attributes("tolerance", str(ds.attrs["title"]), f"tolerance {asked.sweep.scene}")
        about |= {f"tolerance_{name}": width for name, width in asked.half_widths.items()}
        obtained = (
            f"{len(drawn)} samples of the box, and {tried} points of a search from the extreme ones by sensitivities"
        )
        bounds = "they are not bounds of the box" + ", in which motions are irregular" * bool(unbounded.any())
        return ds.assign_attrs({**about, "extremes": f"extremes of {obtained}; {bounds}"})

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        """Return the nominal behaviour, the regimes and the extremes, for each start."""
        lanes = ds if "start" in ds.dims else ds.expand_dims("start")
        facts, lines = {}, list[str]()
        shares = lanes["irregular_share"].values if "irregular_share" in lanes else np.zeros(1)
        if (shares > 0).any():
            starts = [f" from {start}" for start in lanes["start"].values] if "start" in lanes.coords else [""]
            where = (f"{100 * x:.2g} % of the samples{start}" for x, start in zip(shares, starts, strict=True))
            lines.append(
                f"irregular motions in the box ({', '.join(where)}): extremes depend on the time of observation, and "
                "other points of the box may be far beyond them"
            )
        for k in range(lanes.sizes["start"]):
            lane = lanes.isel(start=k)
            start = str(lane["start"].values) if "start" in lane.coords else ""
            facts[start], text = _start_summary(ds, lane)
            lines += [f"from {start}:"] * bool(start) + [f"  {line}" if start else line for line in text]
        lines += [str(ds.attrs["extremes"])] * ("extremes" in ds.attrs)
        return [SummaryPart("tolerance", lines, {"tolerance": facts})]


def sample_box(dimensions: int) -> tuple[Float[np.ndarray, "samples dimensions"], np.ndarray]:
    """Return the samples of the box [-1, 1]^dimensions and the place of each, an index into `PLACES`."""
    corners = np.array(list(product((-1.0, 1.0), repeat=dimensions)))
    ends = np.array(list(product((-1.0, 1.0), repeat=dimensions - 1)))
    edges = [np.insert(ends, k, 0.0, axis=1) for k in range(dimensions)] if dimensions > 1 else []
    interior = 2 * qmc.Sobol(dimensions, seed=0).random(INTERIOR_SAMPLES) - 1
    groups = [np.zeros((1, dimensions)), corners, np.concatenate(edges) if edges else corners[:0], interior]
    return np.concatenate(groups), np.repeat(np.arange(len(groups)), [len(group) for group in groups])


def _start_summary(ds: xr.Dataset, lane: xr.Dataset) -> tuple[dict[str, object], list[str]]:
    """Return the behaviour from one start, as facts and as lines of text."""
    meanings, drawn = flags(ds["regime"]), lane["place"].values != REFINED
    samples, regimes = int(drawn.sum()), lane["regime"].values[drawn]
    nominal = meanings[int(regimes[0])]
    counts = {meanings[flag]: int((regimes == flag).sum()) for flag in np.unique(regimes).tolist()}
    others = [f"{name} at {count}" for name, count in counts.items() if name != nominal]
    line = f"{nominal} at {counts[nominal]} of {counted(samples, 'sample')}"
    if others:
        first = int(np.flatnonzero(regimes != regimes[0])[0])
        line += f"; {', '.join(others)}, such as {_place_text(ds, first)}"
    facts: dict[str, object] = {"nominal": nominal, "samples": samples, "regimes": counts}
    lines = [line]
    for name in (name for name in QUANTITIES if f"{name}_least" in lane):
        ends = {word: float(lane[f"{name}_{word}"]) for word in ("least", "most")}
        if not np.isfinite(ends["least"]):
            continue
        where = {word: int(lane[f"{name}_{word}_sample"]) for word in ends}
        factor, unit = scale(ds[f"{name}_most"])
        known = int(lane[name].notnull().values[drawn].sum())
        low, high = (f"{ends[word] * factor:.4g}" for word in ends)
        worst = "most" if name == "peak_impact_force" else "least"
        text = (
            f"{name.replace('_', ' ')} {low} to {high} {pretty_unit(unit)}, nominal {float(lane[name][0]) * factor:.4g}"
        )
        text += f"; {worst} at {_place_text(ds, where[worst])}"
        lines.append(
            text + (f" ({counted(samples - known, 'sample has', 'samples have')} none)" if known < samples else "")
        )
        facts[name] = {**ends, **{f"{word}_at": _place(ds, index) for word, index in where.items()}, "samples": known}
    return facts, lines


def _place(ds: xr.Dataset, sample: int) -> dict[str, float]:
    return {name: float(ds[name][sample]) for name in toleranced(ds)}


def _place_text(ds: xr.Dataset, sample: int) -> str:
    return ", ".join(f"{name} = {value:.6g}" for name, value in _place(ds, sample).items())
