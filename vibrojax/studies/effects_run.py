"""The run of a study: lanes at all samples, the value of each variable at each sample, and the indices."""

from collections.abc import Mapping
from os import PathLike
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float

from vibrojax.io.kinds import dataset_attributes
from vibrojax.io.variables import STATUSES, Variable
from vibrojax.maps.dataset import described_variables, parameter_attributes
from vibrojax.maps.run import run_sweep
from vibrojax.measures.labels import EQUILIBRIUM, REGIMES, SINGLE_IMPACT
from vibrojax.studies.effects_sampling import CONFIDENCE, REASONS, indices
from vibrojax.studies.effects_spec import SHARE, Study, read_study

ZERO_WITHOUT_IMPACTS = (
    "impact_velocity",
    "impact_velocity_min",
    "impact_velocity_max",
    "impact_energy",
    "impact_power",
    "blow_frequency",
    "rate_of_penetration",
    "slip_per_impact",
)
"""Variables that are 0 in lanes without impacts, where a sweep leaves means over impacts undefined."""

RULES = (
    "lanes without impacts, or without a return of the bit and without contact: impact velocity, energy and power, "
    "blows, rate and slip are 0; irregular lanes: their means over the observation, impact_power from the impacts per "
    "return; several starts: the mean over them; lanes that failed or in which a variable has no value: for that "
    "variable the base sample with all its points is left out"
)
"""How lanes without the regime are handled, for the dataset's attributes."""

_OF, _PARAMETER = ("of",), ("of", "parameter")
_PAIR = ("of", "parameter", "other")

SCHEMA: dict[str, tuple[tuple[str, ...], Variable]] = {
    "first_order": (_PARAMETER, Variable("1", "share of the variance due to the parameter alone")),
    "first_order_conf": (_PARAMETER, Variable("1", "half-width of the confidence interval of first_order")),
    "total_order": (_PARAMETER, Variable("1", "share of the variance due to the parameter and all its interactions")),
    "total_order_conf": (_PARAMETER, Variable("1", "half-width of the confidence interval of total_order")),
    "second_order": (_PAIR, Variable("1", "share of the variance due to the interaction of two parameters")),
    "second_order_conf": (_PAIR, Variable("1", "half-width of the confidence interval of second_order")),
    "effect": (_PARAMETER, Variable("", "mean at the high minus mean at the low level, in the variable's own unit")),
    "interaction": (
        _PAIR,
        Variable("", "half the difference of an effect between the levels of the other, in the variable's own unit"),
    ),
    "mean": (_OF, Variable("", "mean over the box, in the variable's own unit")),
    "std": (_OF, Variable("", "standard deviation over the box, in the variable's own unit")),
    "left_out": (_OF, Variable("1", "base samples that are left out", np.int32)),
    "corners_left_out": (_OF, Variable("1", "corners of the two-level design that are left out", np.int32)),
    "set_to_zero": (_OF, Variable("1", "lanes without impacts whose value is set to 0", np.int32)),
    "averaged": (_OF, Variable("1", "irregular lanes, which count with their means", np.int32)),
    "sobol_reason": (_OF, Variable("1", "why there are no Sobol indices", np.int8, REASONS)),
    SHARE: ((), Variable("1", "share of the Sobol sample's lanes with a single impact")),
    "regime_share": (("label",), Variable("1", "share of the Sobol sample's lanes in the regime")),
    "low": (("parameter",), Variable("", "least value of the parameter, in its own unit")),
    "high": (("parameter",), Variable("", "greatest value of the parameter, in its own unit")),
}
"""Dimensions and meaning of each variable of a study's dataset."""

Lanes = Float[np.ndarray, "points starts"]


def study(source: str | PathLike[str] | Mapping[str, object], progress: bool = True) -> xr.Dataset:
    """Find which parameters, and which pairs of them, decide about a machine's performance within a box of values.

        ds = vj.study("drill")
        ds.total_order.sel(of="impact_energy").to_pandas()

    The study runs Saltelli's sample of the box, and the corners of a two-level factorial design. For each variable in
    `of` it returns Sobol indices with confidence intervals, and the effects and interactions of the factorial design.
    Up to eight parameters, all corners are run. Beyond, a fraction of resolution V is run, whose effects and
    interactions of two parameters are not confounded with each other.

    **Arguments:**

    - `source`: path of a TOML file, the name of a bundled study, or a dict with the same structure. It has a `scene`;
      `of`, a list of variables of the scene's sweeps, or "share_single_impact"; and [vary] with NAME = [low, high] for
      up to twelve parameters. Optional are [parameters], `starts` and [run] as in a sweep, `samples` (base samples, a
      power of two: 256) and `seed` (0). D parameters take (2 D + 2) lanes per base sample and start.
    - `progress`: whether to report progress on stderr.

    **Returns:** a dataset over `of`, `parameter` and `other` (the parameters again).

    - `first_order`, `total_order`: shares of the variance due to a parameter alone, and with all its interactions, with
      95 % confidence intervals `first_order_conf` and `total_order_conf`. `second_order`: share of a pair.
    - `effect`: mean of the variable at the high level of a parameter minus that at the low level. `interaction`: half
      the difference of this effect between the high and the low level of the other parameter.
    - `mean`, `std`: of the variable over the box. `share_single_impact`, `regime_share`: shares of regimes.
    - `set_to_zero`, `averaged`, `left_out`, `corners_left_out`: numbers of lanes, base samples and corners that are
      treated by rule, which the attribute `rules` states. `sobol_reason`: why there are no Sobol indices.

    **Raises:** `InputError` if the study is invalid, or SALib is not installed.

    **Example:**

    >>> drill = {"scene": "vibro-impact", "parameters": {"delta": 0.005}, "starts": ["stuck"], "of": ["impact_energy"]}
    >>> box = {"vary": {"v": [1.4, 1.6], "gamma": [0.7, 0.72]}, "samples": 16, "run": {"settle": 20.0}}
    >>> ds = vj.study(drill | box, progress=False)
    >>> ds.effect.sel(of="impact_energy").idxmax().item()  # a faster drive strikes harder
    'v'
    """
    spec = read_study(source)
    return study_of(spec, run_sweep(spec.sweep, progress=progress))


def study_of(spec: Study, lanes: xr.Dataset) -> xr.Dataset:
    """Return the dataset of a study from the dataset of its sweep."""
    lanes = lanes.transpose("point", ...)
    sobol = spec.sampling.samples * spec.sampling.group
    columns: dict[str, list[Any]] = {}
    for name in spec.of:
        values, zeros, averaged = values_of(lanes, name)
        result = indices(spec.sampling, values.mean(axis=1))
        for key, x in (result | {"set_to_zero": zeros.sum(), "averaged": averaged.sum()}).items():
            columns.setdefault(key, []).append(x)
    table: dict[str, Any] = {name: np.array(x) for name, x in columns.items()}
    table["low"], table["high"] = np.array(list(spec.sampling.bounds.values())).T
    coords: dict[str, Any] = {"of": spec.of, "parameter": spec.sampling.names, "other": spec.sampling.names}
    if "regime" in lanes:
        regime = lanes["regime"].values.reshape(lanes.sizes["point"], -1)[:sobol]
        table["regime_share"] = np.array([(regime == flag).mean() for flag in range(len(REGIMES))])
        table[SHARE] = np.asarray((regime == SINGLE_IMPACT).mean())
        coords["label"] = list(REGIMES)
    about = described_variables(spec.sweep) | {SHARE: SCHEMA[SHARE][1]}
    parameters = [parameter_attributes(spec.sweep, name) for name in spec.sampling.names]
    coords["of_unit"] = ("of", [about[name].units for name in spec.of])
    coords["of_long_name"] = ("of", [about[name].long_name for name in spec.of])
    coords["parameter_unit"] = ("parameter", [x["units"] for x in parameters])
    coords["parameter_long_name"] = ("parameter", [x["long_name"] for x in parameters])
    variables = {
        name: (dims, table[name].astype(known.dtype), known.attributes())
        for name, (dims, known) in SCHEMA.items()
        if name in table
    }
    corners = len(spec.sampling.corner_signs())
    fraction = "full" if corners == 2 ** len(spec.sampling.bounds) else "fraction of resolution V"
    attributes = {
        **dataset_attributes("study", spec.sweep.title, f"study {spec.sweep.scene}", scene=spec.sweep.scene),
        **{name: lanes.attrs[name] for name in ("parameters", "differing", "run", "solver") if name in lanes.attrs},
        "study": spec.text,
        "rules": RULES,
        "samples": spec.sampling.samples,
        "seed": spec.sampling.seed,
        "confidence": CONFIDENCE,
        "design": f"{fraction}, {corners} corners",
        "lanes": lanes.attrs["lanes"],
        "sobol_lanes": sobol * (lanes.sizes.get("start", 1)),
    }
    return xr.Dataset(variables, coords, attributes)


def values_of(lanes: xr.Dataset, name: str) -> tuple[Lanes, Bool[np.ndarray, "points starts"], Any]:
    """Return a variable of all lanes, NaN where it has no value, and masks of lanes set to zero and averaged."""

    def column(key: str) -> Lanes:
        return lanes[key].values.reshape(lanes.sizes["point"], -1).astype(float)

    done = column("status") == STATUSES.index("done")
    none = np.zeros(done.shape, bool)
    regime = column("regime") if "regime" in lanes else None
    if name == SHARE:
        assert regime is not None
        return np.where(done, regime == SINGLE_IMPACT, np.nan), none, none
    values = column(name)
    if regime is None or "impacts" not in lanes:
        return np.where(done, values, np.nan), none, none
    impacts, irregular = column("impacts"), done & (column("cycles") == 0) & (regime != EQUILIBRIUM)
    with np.errstate(all="ignore"):
        if name in ("impact_power", "specific_energy"):
            power = column("impact_energy") * impacts / column("period")  # impacts per return
            if name == "specific_energy":
                radius = lanes[name].attrs.get("bit_radius")
                radius = lanes["bit_radius"].values[:, None] if radius is None else radius
                rate = column("rate_of_penetration")
                power = np.where(rate > 0, power / (np.pi * radius**2 * rate), np.nan)
            values = np.where(irregular & np.isnan(values), power, values)
    apart = (column("returns") < 2) & (column("peak_impact_force") == 0) if "peak_impact_force" in lanes else none
    still = done & ((impacts == 0) | (regime == EQUILIBRIUM) | apart) & (name in ZERO_WITHOUT_IMPACTS)
    zeros = still & ~(values > 0)
    values = np.where(done, np.where(zeros, 0.0, values), np.nan)
    values = np.where(np.isfinite(values), values, np.nan)
    return values, zeros, irregular & ~zeros & np.isfinite(values)
