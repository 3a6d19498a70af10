"""One law over all lanes: C and eta0 as power laws of the parameters, with shared coefficients."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float

from vibrojax.analyses.rop_law.data import Columns, Data, open_rates
from vibrojax.analyses.rop_law.groups import check_axis, usable_lanes
from vibrojax.analyses.rop_law.joint_calibration import calibrate
from vibrojax.analyses.rop_law.results import law_title, provenance, reason, with_attributes
from vibrojax.analyses.rop_law.uncertainty import r_squared_reason
from vibrojax.errors import Place, shown, suggestion
from vibrojax.io.variables import Variable

OVER = ("force", "k3", "zeta", "threshold")
ONSETS = ("power-law", "shared")

_VARIABLES = {
    "C": Variable("m s-1", "coefficient of the rate-of-penetration law at the reference"),
    "C_stderr": Variable("m s-1", "standard error of C"),
    "C_exponent": Variable("1", "exponent of the parameter in C"),
    "C_exponent_stderr": Variable("1", "standard error of the parameter's exponent in C"),
    "eta0": Variable("1", "relief at the onset, at the reference"),
    "eta0_stderr": Variable("1", "standard error of eta0"),
    "eta0_exponent": Variable("1", "exponent of the parameter in eta0"),
    "eta0_exponent_stderr": Variable("1", "standard error of the parameter's exponent in eta0"),
    "reference": Variable("1", "value of the parameter at the reference, in its own unit"),
    "r_squared": Variable("1", "share of the rate's variance that the law explains"),
    "aic": Variable("1", "n ln(RSS/n) + 2k, RSS in m2 s-2"),
    "degrees_of_freedom": Variable("1", "lanes with a residual less coefficients", np.int32),
    "used": Variable("1", "lanes that the fit used, those at zero rate among them", np.int32),
    "left_out": Variable("1", "lanes left out: failed, irregular, or without usable values", np.int32),
    "reason": reason("why a coefficient is not a number"),
    "r_squared_reason": reason("why r_squared is not a number"),
    "exponent_reason": reason("why the parameter's exponents are not numbers"),
}


def fit_joint(
    data: Data,
    along: str | None = None,
    over: Sequence[str] = OVER,
    onset: str = "power-law",
    columns: Columns = None,
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
    - `columns`: of a CSV, which column is what, as in `fit_rop`.

    **Returns:** a dataset with C [m/s] and eta0 at the reference (the parameters' geometric means over the lanes that
    penetrate), and along `parameter` the exponents, each with standard error; r_squared, aic, used, left_out. NaN
    with a `reason` where nothing is identified; a parameter that does not vary, or not by itself, has exponents of NaN
    with an `exponent_reason`, and the others hold without it. The attribute `not_identified` names what is not.

    **Raises:** `InputError`.

    **Example:**

    >>> axes = {"force": [300e3, 400e3, 500e3], "frequency": [10.0, 20.0, 30.0]}
    >>> rates = vj.run_sweep({"scene": "penetration", "parameters": {"rock": "granite"}, "grid": axes}, progress=False)
    >>> joint = vj.fit_joint(rates, over=["force"])
    >>> f"C = {1e3 * float(joint.C):.0f} mm/s, in proportion to force^{joint.C_exponent.item():.1f}"
    'C = 14 mm/s, in proportion to force^2.9'
    """
    place, data = open_rates(data, "fit_joint", columns)
    if onset not in ONSETS:
        raise place.at("onset").error(f"{shown(onset)} is unknown; {suggestion(str(onset), ONSETS)}")
    lanes = usable_lanes(data)
    if along is not None:
        check_axis(place, lanes, along)
    relief, rate, valid = (lanes[name].values.ravel() for name in ("relief", "rate", "valid"))
    names = tuple(over)
    parameters = np.zeros((rate.size, len(names)))
    for index, name in enumerate(names):
        required = names != OVER
        parameters[:, index] = _parameter(place.at(f"over.{name}"), lanes, name, along, valid, required)
    law = calibrate(relief[valid], rate[valid], parameters[valid], shared=onset == "shared")
    why = r_squared_reason(np.asarray(law.r_squared), np.asarray(law.reason))
    values = {**vars(law), "used": valid.sum(), "left_out": (~valid).sum(), "r_squared_reason": why}
    dims = {name: ("parameter",) for name in _VARIABLES if np.ndim(values[name])}
    coordinate = ("parameter", np.array(names, dtype=str), {"units": "1", "long_name": "parameter"})
    more = {"formula": "C ln(eta/eta0), C and eta0 power laws of the parameters", "onset": onset}
    more["not_identified"] = ", ".join(_not_identified(law.confounded, names, onset == "shared")) or "none"
    return xr.Dataset(
        with_attributes(_VARIABLES, values, dims),
        {"parameter": coordinate},
        provenance(place, data, "joint fit", law_title(place, data), more),
    )


def _parameter(
    place: Place, lanes: xr.Dataset, name: str, along: str | None, valid: Bool[np.ndarray, " lanes"], required: bool
) -> Float[np.ndarray, " lanes"]:
    """A parameter's value for every lane; NaN where the data do not have it and it is not `required`."""
    if name not in lanes.coords or name == along:
        if required:
            choice = [str(coordinate) for coordinate in lanes.coords if coordinate != along]
            raise place.error(f"no coordinate of the data beside along; {suggestion(name, choice)}")
        return np.full(valid.size, np.nan)
    if lanes[name].dtype.kind not in "fiu":
        raise place.error("does not hold numbers; a power law needs them")
    on_lanes = xr.broadcast(lanes[name], lanes["rate"])[0].transpose(*lanes["rate"].dims)
    values = on_lanes.values.ravel().astype(np.float64)
    if not (np.isfinite(values[valid]) & (values[valid] > 0)).all():
        raise place.error("has values that are not above 0; a power law needs them above 0")
    return values


def _not_identified(confounded: Bool[np.ndarray, " coefficients"], names: tuple[str, ...], shared: bool) -> list[str]:
    """What the lanes do not identify, by name."""
    onsets = [f"eta0_exponent {name}" for name in names]
    every = ["C", *(f"C_exponent {name}" for name in names), "eta0", *onsets]
    return [name for name, lost in zip(every, confounded, strict=True) if lost and not (shared and name in onsets)]
