"""Samples of a box, values that count at them, Saltelli's Sobol indices, and effects of a factorial design."""

from dataclasses import dataclass
from itertools import combinations
from types import ModuleType
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float

from vibrojax.errors import InputError
from vibrojax.io.variables import STATUSES
from vibrojax.maps.bounds import corners
from vibrojax.measures.labels import EQUILIBRIUM, SINGLE_IMPACT

CONFIDENCE = 0.95  # level of the confidence intervals
RESAMPLES = 200  # number of bootstrap samples from which the confidence intervals are estimated
_NAMES = {"first_order": "S1", "total_order": "ST", "second_order": "S2"}  # of SALib
MIN_GROUPS = 8  # smallest number of base samples from which indices are computed
REASONS = ("known", "constant", "too-few-samples")  # meanings of the flags of `sobol_reason`
SHARE = "share_single_impact"  # name in `of` for the share of starts from which a point has a single impact

# Up to eight parameters, all corners are run, 256 of them, and a fraction beyond. There, each further parameter is the
# product of the signs of some of the first seven, or eight. Main effects and interactions of two parameters are not
# confounded with each other (resolution V).
_BASIC = {9: 7, 10: 7, 11: 7, 12: 8}
_GENERATORS = {
    7: ((0, 1, 2, 6), (1, 2, 3, 4), (0, 2, 3, 5), (0, 1, 2, 3, 4, 5, 6)),
    8: ((0, 1, 2, 3), (0, 1, 4, 5), (0, 2, 4, 6), (1, 2, 4, 7)),
}

Points = Float[np.ndarray, "points parameters"]
Lanes = Float[np.ndarray, "points starts"]

ZERO_WITHOUT_IMPACTS = (
    *("impact_velocity", "impact_velocity_min", "impact_velocity_max", "impact_energy", "impact_power"),
    *("blow_frequency", "rate_of_penetration", "slip_per_impact"),
)
"""Variables that are 0 in lanes without impacts, where a sweep leaves means over impacts undefined."""

RULES = (
    "In lanes without impacts, and in lanes without a return of the bit and without contact, impact velocity, energy "
    "and power, blows, rate and slip are 0. Irregular lanes count with their means over the observation, with "
    "impact_power from the impacts per return. Of several starts, the mean counts. If a lane has failed, or if a "
    "variable has no value in it, the base sample of this lane is left out for this variable, with all its points."
)
"""How lanes without the regime are handled, for the dataset's attributes."""


@dataclass(frozen=True, eq=False)
class Sampling:
    """Samples of a box.

    - `bounds`: least and greatest value of each parameter, by name.
    - `samples`: number of base samples, a power of two; `seed`: seed of the scrambled Sobol sequence.
    """

    bounds: dict[str, tuple[float, float]]
    samples: int
    seed: int = 0

    @property
    def group(self) -> int:
        """Number of consecutive points of the Sobol sample that belong to one base sample: 2 D + 2."""
        return 2 * len(self.bounds) + 2

    @property
    def problem(self) -> dict[str, object]:
        return {"num_vars": len(self.bounds), "names": [*self.bounds], "bounds": [[*x] for x in self.bounds.values()]}

    def points(self) -> Points:
        """Return all points: Saltelli's sample, `samples` groups of `group` points each, and the corners.

        **Raises:** `InputError` if SALib is not installed.
        """
        sample = salib("sample").sample(self.problem, self.samples, calc_second_order=True, seed=self.seed)
        low, high = np.array(list(self.bounds.values())).T
        return np.concatenate([sample, np.where(factorial_signs(len(low)) > 0, high, low)])


def factorial_signs(parameters: int) -> Points:
    """Return the signs of a two-level design: full for up to eight parameters, else a fraction of resolution V."""
    basic = _BASIC.get(parameters, parameters)
    signs = corners(basic)
    further = _GENERATORS[basic][: parameters - basic] if parameters > basic else ()
    return np.column_stack([signs, *(signs[:, list(word)].prod(axis=1) for word in further)])


def salib(part: str) -> ModuleType:
    """Return the module `SALib.sample.sobol` or `SALib.analyze.sobol`; `part` is "sample" or "analyze".

    **Raises:** `InputError` if SALib is not installed.
    """
    from importlib import import_module

    try:
        return import_module(f"SALib.{part}.sobol")
    except ImportError:
        advice = "install it with: pip install SALib"
        raise InputError(f"study: the package SALib, which computes Sobol indices, is missing; {advice}") from None


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


def indices(sampling: Sampling, values: Float[np.ndarray, " points"]) -> dict[str, np.ndarray]:
    """Return the results of one variable, by name, from its values at `sampling.points()`, NaN where it has none.

    A base sample with a point without a value is left out with all its points, so that Saltelli's estimators remain
    valid on the others. A corner without a value is left out of the least squares that give the effects.

    **Returns:** along the parameters: first_order, total_order, with `_conf`, and effect; over pairs of parameters:
    second_order, with `_conf`, and interaction, both symmetric, NaN on the diagonal; and mean, std, left_out,
    corners_left_out and sobol_reason.
    """
    size, count = len(sampling.bounds), sampling.samples * sampling.group
    whole = values[:count].reshape(sampling.samples, sampling.group)
    kept = np.isfinite(whole).all(axis=1)
    groups = whole[kept]
    of_salib = {f"{name}{end}": f"{short}{end}" for name, short in _NAMES.items() for end in ("", "_conf")}
    shares = {name: np.full((size, size) if "second" in name else size, np.nan) for name in of_salib}
    reason = "too-few-samples" if len(groups) < MIN_GROUPS else "known"
    if reason == "known" and np.ptp(groups) <= 1e-12 * np.abs(groups).max():
        reason = "constant"
    if reason == "known":
        sobol = salib("analyze").analyze(
            sampling.problem, groups.ravel(), calc_second_order=True, num_resamples=RESAMPLES, conf_level=CONFIDENCE,
            seed=sampling.seed + 1,  # SALib takes 0 for no seed
        )  # fmt: skip
        for name, short in of_salib.items():
            x = np.asarray(sobol[short], float)
            shares[name] = np.where(np.isnan(x), x.T, x) if x.ndim == 2 else x
        shares["total_order_conf"] = np.fmax(shares["total_order_conf"], _unseen(groups))
    effect, interaction, corners_left_out = factorial_effects(factorial_signs(size), values[count:])
    ends = groups[:, [0, -1]]  # the independent points of each base sample
    result = shares | {
        "effect": effect,
        "interaction": interaction,
        "mean": np.mean(ends) if kept.any() else np.nan,
        "std": np.std(ends) if kept.any() else np.nan,
        "left_out": np.sum(~kept),
        "corners_left_out": corners_left_out,
        "sobol_reason": REASONS.index(reason),
    }
    return {name: np.asarray(x) for name, x in result.items()}


def _unseen(groups: Float[np.ndarray, "groups points"]) -> float:
    """Return the share of the variance that a parameter may cause although the variable changed in no sample.

    Where most samples have one value, as a share of lanes has, rare changes cause the variance, and resampling gives an
    interval of width 0 if none was seen. With 95 % confidence, they then have at most the probability 3/groups (rule of
    three); each causes at most half the squared range of the values.
    """
    if np.unique(groups, return_counts=True)[1].max() <= groups.size / 2:
        return 0.0
    with np.errstate(divide="ignore"):
        return min(1.0, 3 / len(groups) * float(np.ptp(groups) ** 2 / (2 * np.var(groups[:, [0, -1]]))))


def factorial_effects(
    signs: Float[np.ndarray, "corners parameters"], values: Float[np.ndarray, " corners"]
) -> tuple[np.ndarray, np.ndarray, int]:
    """Return the effects, the interactions, and the number of corners without a value.

    The effect of a parameter is the mean of the values at its high level minus that at its low level. The interaction
    of two parameters is half the difference of the effect of one between the high and the low level of the other. Both
    are NaN if too many corners have no value.
    """
    size = signs.shape[1]
    pairs = list(combinations(range(size), 2))
    columns = [np.ones(len(signs)), *signs.T, *(signs[:, i] * signs[:, j] for i, j in pairs)]
    known: Bool[np.ndarray, " corners"] = np.isfinite(values)
    effect, interaction = np.full(size, np.nan), np.full((size, size), np.nan)
    design = np.column_stack(columns)[known]
    if np.linalg.matrix_rank(design) == len(columns):
        coefficients = 2 * np.linalg.lstsq(design, values[known])[0]
        effect = coefficients[1 : size + 1]
        for (i, j), x in zip(pairs, coefficients[size + 1 :], strict=True):
            interaction[i, j] = interaction[j, i] = x
    return effect, interaction, int(np.sum(~known))
