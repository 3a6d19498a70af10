"""One law over all lanes: C and eta0 as power laws of the parameters, with shared coefficients."""

from collections.abc import Sequence
from os import PathLike

import numpy as np
import xarray as xr

from vibrojax.errors import Place, shown, suggestion
from vibrojax.laws._about import described, law_title, provenance
from vibrojax.laws._calibrate import Calibration, calibrated
from vibrojax.laws._group import CONFOUNDED, LEAST_SPREAD, NO_SPREAD
from vibrojax.laws._lanes import axis, read_data, usable

OVER = ("force", "k3", "zeta", "threshold")
ONSETS = ("power-law", "shared")

_ABOUT = {
    "C": ("m s-1", "coefficient of the rate-of-penetration law at the reference"),
    "C_stderr": ("m s-1", "standard error of C"),
    "C_exponent": ("1", "exponent of the parameter in C"),
    "C_exponent_stderr": ("1", "standard error of the parameter's exponent in C"),
    "eta0": ("1", "relief at the onset, at the reference"),
    "eta0_stderr": ("1", "standard error of eta0"),
    "eta0_exponent": ("1", "exponent of the parameter in eta0"),
    "eta0_exponent_stderr": ("1", "standard error of the parameter's exponent in eta0"),
    "reference": ("1", "value of the parameter at the reference, in its own unit"),
    "r_squared": ("1", "share of the rate's variance that the law explains"),
    "aic": ("1", "n ln(RSS/n) + 2k, RSS in m2 s-2"),
    "degrees_of_freedom": ("1", "lanes with a residual less coefficients"),
    "used": ("1", "lanes that the fit used, those at zero rate among them"),
    "left_out": ("1", "lanes left out: failed, irregular, or without usable values"),
    "reason": ("1", "why a coefficient is not a number"),
    "exponent_reason": ("1", "why the parameter's exponents are not numbers"),
}


def fit_joint(
    data: xr.Dataset | str | PathLike, along: str | None = None, over: Sequence[str] = OVER, onset: str = "power-law"
) -> xr.Dataset:
    """One law for all groups at once, calibrated on all lanes:

        rate = C ln(eta/eta0),  C = C_ref prod (x_j/ref_j)^a_j,  eta0 = eta0_ref prod (x_j/ref_j)^b_j

    Least squares of the rate by Levenberg–Marquardt, from power laws through the groups' own onset fits; lanes at zero
    rate are censored, and lanes are left out, as in `fit_rop`.

    **Arguments:**

    - `data`: as in `fit_rop`; the parameters x_j are coordinates of it (of a CSV: columns).
    - `along`: the axis of a group, which is then no parameter of the law; by default none is excluded.
    - `over`: the parameters x_j.
    - `onset`: "power-law", or "shared": one eta0 for all (b_j = 0).

    **Returns:** a dataset with C [m/s] and eta0 at the reference (the parameters' geometric means over the lanes that
    penetrate), and along `parameter` the exponents, each with standard error; r_squared, aic, used, left_out. NaN
    with a `reason` where nothing can be told; a parameter that does not vary, or not by itself, has exponents of NaN
    with an `exponent_reason`, and the others hold without it. The attribute `not_identified` names what is not told.

    **Raises:** `InputError`.
    """
    place, data = read_data(data, "fit_joint")
    if onset not in ONSETS:
        raise place.at("onset").error(f"{shown(onset)} is unknown; {suggestion(str(onset), ONSETS)}")
    lanes = usable(data)
    if along is not None:
        axis(place, lanes, along)
    relief, rate, valid = (lanes[name].values.ravel() for name in ("relief", "rate", "valid"))
    names = tuple(over)
    logs = np.zeros((rate.size, len(names)))
    for index, name in enumerate(names):
        logs[:, index] = np.log(_values(place.at(f"over.{name}"), lanes, name, along, valid, required=names != OVER))
    seen = valid & (rate > 0)
    centre = logs[seen].mean(axis=0) if seen.any() else np.full(len(names), np.nan)
    away = np.nan_to_num((logs - centre)[valid])
    found = calibrated(relief[valid], rate[valid], away, onset == "shared")
    counts = {"used": np.int32(valid.sum()), "left_out": np.int32((~valid).sum())}
    values = (
        _variables(found, np.abs(away).max(axis=0, initial=0.0) > LEAST_SPREAD) | {"reference": np.exp(centre)} | counts
    )
    variables = {
        name: (("parameter",) if np.ndim(values[name]) else (), values[name], about)
        for name, about in described(_ABOUT).items()
    }
    coordinate = ("parameter", np.array(names, dtype=str), {"units": "1", "long_name": "parameter"})
    more = {"formula": "C ln(eta/eta0), C and eta0 power laws of the parameters", "onset": onset}
    more["not_identified"] = ", ".join(_not_identified(found, names, onset == "shared")) or "none"
    return xr.Dataset(
        variables, {"parameter": coordinate}, provenance(place, data, "joint fit", law_title(place, data), more)
    )


def _values(place: Place, lanes: xr.Dataset, name: str, along: str | None, valid: np.ndarray, required: bool):
    """A parameter's value for every lane; NaN where the data do not have it and it is not `required`."""
    if name not in lanes.coords or name == along:
        if required:
            choice = [str(coordinate) for coordinate in lanes.coords if coordinate != along]
            raise place.error(f"no coordinate of the data beside along; {suggestion(name, choice)}")
        return np.full(valid.size, np.nan)
    if lanes[name].dtype.kind not in "fiu":
        raise place.error("does not hold numbers; a power law needs them")
    values = xr.broadcast(lanes[name], lanes["rate"])[0].transpose(*lanes["rate"].dims)
    values = values.values.ravel().astype(np.float64)
    if not (np.isfinite(values[valid]) & (values[valid] > 0)).all():
        raise place.error("has values that are not above 0; a power law needs them above 0")
    return np.where(valid, values, 1.0)


def _variables(found: Calibration, varies: np.ndarray) -> dict:
    """The dataset's variables; `varies` tells which parameters have more than one value."""
    number = varies.size
    c, eta0 = found.unit * np.exp(found.theta[0]), np.exp(found.theta[1 + number])
    told = np.where(found.told, found.reason, np.where(varies, CONFOUNDED, NO_SPREAD))
    return {
        "C": c,
        "C_stderr": c * found.errors[0],
        "C_exponent": found.theta[1 : 1 + number],
        "C_exponent_stderr": found.errors[1 : 1 + number],
        "eta0": eta0,
        "eta0_stderr": eta0 * found.errors[1 + number],
        "eta0_exponent": found.theta[2 + number :],
        "eta0_exponent_stderr": found.errors[2 + number :],
        "r_squared": found.r_squared,
        "aic": found.aic,
        "degrees_of_freedom": np.int32(found.degrees_of_freedom),
        "reason": np.int8(found.reason),
        "exponent_reason": told.astype(np.int8),
    }


def _not_identified(found: Calibration, names: tuple[str, ...], shared: bool) -> list[str]:
    """What the lanes could not tell, by name."""
    onsets = [f"eta0_exponent {name}" for name in names]
    every = ["C", *(f"C_exponent {name}" for name in names), "eta0", *onsets]
    return [name for name, lost in zip(every, found.lost, strict=True) if lost and not (shared and name in onsets)]
