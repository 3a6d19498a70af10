"""Simulation of a machine over the box of its parameter tolerances: `tolerance`."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from scipy.stats import qmc

from vibrojax.errors import Place, shown
from vibrojax.io.kinds import dataset_attributes
from vibrojax.io.variables import VARIABLES, Variable
from vibrojax.maps.bounds import MAX_TOLERANCES
from vibrojax.maps.read import read_point, read_sweep
from vibrojax.maps.run import run_sweep
from vibrojax.maps.sweep import Sweep
from vibrojax.measures.labels import REGIMES, UNBOUNDED
from vibrojax.physics.arrays import check_untraced
from vibrojax.scenes import Scene
from vibrojax.studies.tolerance_refinement import refine

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

    - `sweep`: one point per sample; `tables`: its tables without the points.
    - `nominal`, `half_widths`: nominal values and half-widths by name.
    - `units`: the samples in half-widths from the nominal point; `places`: the place of each.
    """

    sweep: Sweep
    tables: dict[str, Any]
    nominal: dict[str, float]
    half_widths: dict[str, float]
    units: Float[np.ndarray, "samples dimensions"]
    places: np.ndarray

    def identity(self) -> dict[str, object]:
        """Return all settings on which the result depends, as flat JSON values."""
        return self.sweep.identity() | {f"tolerance_{name}": width for name, width in self.half_widths.items()}

    def sweep_over(self, units: Float[np.ndarray, "samples dimensions"]) -> Sweep:
        """Return the sweep over other points of the box."""
        return _sweep(self.tables, self.nominal, self.half_widths, units)


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
    return simulate_box(read_box(scene, start, run, parameters), progress)


def read_box(
    scene: str | Scene[Any],
    start: object,
    run: Mapping[str, object] | None,
    parameters: Mapping[str, Any],
) -> ToleranceBox:
    """Return the checked specification; raise `InputError` with a one-line message at the first error."""
    place = Place("tolerance")
    pairs = {name: x for name, x in parameters.items() if isinstance(x, (tuple, list))}
    if not pairs:
        raise place.error(
            "no parameter has a tolerance; give one as delta=(0.005, 0.001), on the command line as delta=0.005+-0.001"
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
    tables: dict[str, Any] = {"scene": scene, "parameters": fixed, "run": dict(run or {}), "unusual": True}
    tables["title"] = "Behaviour over the tolerances"
    if start is not None:
        several = isinstance(start, (list, tuple)) and any(isinstance(item, (str, list, tuple)) for item in start)
        tables["starts"] = start if several else [start]
    units, places = sample_box(len(pairs))
    sweep = _sweep(tables, nominal, half_widths, units)
    if sweep.system.section is None:
        raise place.at("scene").error(f"{shown(sweep.scene)} has no section, so its motions have no regimes")
    return ToleranceBox(sweep, tables, nominal, half_widths, units, places)


def _sweep(
    tables: Mapping[str, Any],
    nominal: Mapping[str, float],
    half_widths: Mapping[str, float],
    units: Float[np.ndarray, "samples dimensions"],
) -> Sweep:
    """Return the sweep over points of the box, which are in half-widths from the nominal point."""
    columns = {
        name: [centre + half_widths[name] * float(unit) for unit in units[:, k]]
        for k, (name, centre) in enumerate(nominal.items())
    }
    return read_sweep({**tables, "points": columns})


def sample_box(dimensions: int) -> tuple[Float[np.ndarray, "samples dimensions"], np.ndarray]:
    """Return the samples of the box [-1, 1]^dimensions and the place of each, an index into `PLACES`."""
    corners = np.array(list(product((-1.0, 1.0), repeat=dimensions)))
    ends = np.array(list(product((-1.0, 1.0), repeat=dimensions - 1)))
    edges = [np.insert(ends, k, 0.0, axis=1) for k in range(dimensions)] if dimensions > 1 else []
    interior = 2 * qmc.Sobol(dimensions, seed=0).random(INTERIOR_SAMPLES) - 1
    groups = [np.zeros((1, dimensions)), corners, np.concatenate(edges) if edges else corners[:0], interior]
    return np.concatenate(groups), np.repeat(np.arange(len(groups)), [len(group) for group in groups])


def simulate_box(box: ToleranceBox, progress: bool) -> xr.Dataset:
    """Run all samples from all starts, and return the dataset of [vibrojax.studies.tolerance_run.tolerance][]."""
    ds, tried, added = refine(box.sweep_over, box.units, run_sweep(box.sweep, progress=progress), QUANTITIES)
    ds = ds.rename(point="sample")
    places = np.concatenate([box.places, np.full(added, REFINED)])
    ds["place"] = ("sample", places.astype(np.int8), SAMPLE_VARIABLES["place"].attributes())
    regime = ds["regime"].transpose("sample", ...)
    drawn, rest = regime.values[: len(box.places)], regime.dims[1:]
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
            for (variable, about), values in zip(_extreme(name, word).items(), (extreme, sample), strict=True):
                unit = {"units": ds[name].attrs["units"]} if variable == f"{name}_{word}" else {}
                ds[variable] = (rest, values, about.attributes() | unit)
    attributes = dataset_attributes("tolerance", str(ds.attrs["title"]), f"tolerance {box.sweep.scene}")
    attributes |= {f"tolerance_{name}": width for name, width in box.half_widths.items()}
    obtained = f"{len(drawn)} samples of the box, and {tried} points of a search from the extreme ones by sensitivities"
    bounds = "they are not bounds of the box" + ", in which motions are irregular" * bool(unbounded.any())
    return ds.assign_attrs({**attributes, "extremes": f"extremes of {obtained}; {bounds}"})
