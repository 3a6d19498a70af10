"""Sobol indices with confidence intervals, and the effects of a two-level factorial design, from values at samples."""

from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from vibrojax.analyses.study.sampling import Sampling, salib

CONFIDENCE = 0.95
"""Level of the confidence intervals."""

RESAMPLES = 200
"""Number of bootstrap samples from which the confidence intervals are estimated."""

MIN_GROUPS = 8
"""Smallest number of base samples from which indices are computed."""

REASONS = ("known", "constant", "too-few-samples")
"""Meanings of the flags of `sobol_reason`."""

Values = Float[np.ndarray, " points"]
Result = dict[str, np.ndarray]


def indices(sampling: Sampling, values: Values) -> Result:
    """Return the results of one variable, by name, from its values at `sampling.points()`, NaN where it has none.

    A base sample with a point without a value is left out with all its points, so that Saltelli's estimators remain
    valid on the others. A corner without a value is left out of the least squares that give the effects.

    **Returns:** along the parameters: first_order, total_order, with `_conf`, and effect; over pairs of parameters:
    second_order, with `_conf`, and interaction, both symmetric, NaN on the diagonal; and mean, std, left_out,
    corners_left_out and sobol_reason.
    """
    count = sampling.samples * sampling.group
    groups = values[:count].reshape(sampling.samples, sampling.group)
    kept = np.isfinite(groups).all(axis=1)
    effect, interaction, corners_left_out = factorial_effects(sampling.corner_signs(), values[count:])
    ends = groups[kept][:, [0, -1]]  # the independent points of each base sample
    result = {
        **_sobol_indices(sampling, groups[kept]),
        "effect": effect,
        "interaction": interaction,
        "mean": np.mean(ends) if kept.any() else np.nan,
        "std": np.std(ends) if kept.any() else np.nan,
        "left_out": np.sum(~kept),
        "corners_left_out": corners_left_out,
    }
    return {name: np.asarray(x) for name, x in result.items()}


def _sobol_indices(sampling: Sampling, groups: Float[np.ndarray, "groups points"]) -> Result:
    names = ("first_order", "total_order", "second_order")
    size = len(sampling.bounds)
    shapes: dict[str, tuple[int, ...]] = {"first_order": (size,), "total_order": (size,), "second_order": (size, size)}
    result = {f"{name}{end}": np.full(shapes[name], np.nan) for name in names for end in ("", "_conf")}
    if len(groups) < MIN_GROUPS:
        return result | {"sobol_reason": np.asarray(REASONS.index("too-few-samples"))}
    if np.ptp(groups) <= 1e-12 * np.abs(groups).max():
        return result | {"sobol_reason": np.asarray(REASONS.index("constant"))}
    found = salib("analyze").analyze(
        sampling.problem,
        groups.ravel(),
        calc_second_order=True,
        num_resamples=RESAMPLES,
        conf_level=CONFIDENCE,
        seed=sampling.seed + 1,  # SALib takes 0 for no seed
    )
    for name, short in zip(names, ("S1", "ST", "S2"), strict=True):
        for end in ("", "_conf"):
            x = np.asarray(found[f"{short}{end}"], float)
            result[f"{name}{end}"] = np.where(np.isnan(x), x.T, x) if x.ndim == 2 else x
    return result | {"sobol_reason": np.asarray(REASONS.index("known"))}


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
