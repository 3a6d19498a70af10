"""Errors of lanes against the reference, and why some of them have none."""

import numpy as np

RELATIVE = ("period", "impact_velocity", "peak_impact_force", "rate_of_penetration")
ERRORS = ("period", "impact_velocity", "peak_impact_force", "stick_fraction", "rate_of_penetration")
"""What errors are told of: relative ones, of the stick fraction (a share already) the difference."""

ANOTHER = 0.5
"""A relative error from which on a lane is taken to move in another way than the reference."""

STATUSES = ("done", "not-finite", "out-of-steps", "other-regime", "unsupported")


def errors_of(found: dict, reference: dict) -> dict[str, np.ndarray]:
    """Errors (lanes,) of what the scene has, by name, and `overall`.

    That is the larger of period's and impact velocity's; in penetration that of the rate of penetration.
    """
    errors = {}
    for name in ERRORS:
        if name not in reference or name not in found:
            continue
        difference = np.abs(found[name].astype(float) - reference[name])
        if name in RELATIVE:
            difference = _over(difference, np.abs(reference[name]))
        errors[name] = difference
    main = [errors[name] for name in ("period", "impact_velocity") if name in errors]
    return errors | {"overall": np.fmax.reduce(main or [errors["rate_of_penetration"]])}


def statuses_of(found: dict, reference: dict, errors: dict) -> np.ndarray:
    """What became of each lane, indices into `STATUSES`.

    Another regime: impacts per return differ by over 5 %, or an error is a half or more. Whether the motion repeats to
    1e-3 is not asked: coarse steps jitter by more, and their means are still of the same motion.
    """
    other = ~(errors["overall"] < ANOTHER)
    if "impacts" in reference:
        expected = _per_return(reference)
        other |= ~(np.abs(_per_return(found) - expected) <= 0.05 * np.maximum(expected, 1))
    conditions = [~found["finite"], ~found["finished"], other]
    return np.select(conditions, [STATUSES.index(name) for name in STATUSES[1:4]], 0)


def usable(reference: dict, second: dict) -> np.ndarray:
    """Which lanes the reference can be trusted on: periodic ones, to four digits at least, that both find alike."""
    errors = errors_of(second, reference)
    alike = (statuses_of(second, reference, errors) == 0) & (errors["overall"] < 1e-4)
    if "cycles" in reference:
        return alike & (reference["cycles"] > 0) & (reference["cycles"] == second["cycles"])
    return alike & (reference["rate_of_penetration"] > 0)


def _per_return(features: dict) -> np.ndarray:
    return np.asarray(features["impacts"], float) / np.maximum(features["cycles"], 1)


def _over(difference: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """The quotient; 0 where both are zero, infinite where only the scale is."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(difference == 0, 0.0, difference / scale)
