"""Fits of every form of the rate-of-penetration law to every group of lanes (a lane: one relief and its rate)."""

import sys
import time
from collections.abc import Sequence

import numpy as np
import xarray as xr

from vibrojax.errors import Place, counted
from vibrojax.io.riglog import log_lines
from vibrojax.io.variables import Variable
from vibrojax.progress import LOG
from vibrojax.settings.values import choice
from vibrojax.studies.rop_blocks import (
    LEAST_ROWS,
    STANDINGS,
    block_covariance,
    blocks_of,
    compare,
    prediction_errors,
)
from vibrojax.studies.rop_blocks import (
    segments as find_segments,
)
from vibrojax.studies.rop_data import Columns, Data, open_data
from vibrojax.studies.rop_dataset import GOODNESS_SCHEMA, LAW_TITLE, fit_dataset
from vibrojax.studies.rop_forms import FORMS, SAME_AS_ONSET, Form, Model
from vibrojax.studies.rop_groups import data_variables, group_lanes, usable_lanes
from vibrojax.studies.rop_least_squares import (
    LOSSES,
    Lanes,
    Minimum,
    Reason,
    covariance,
    goodness,
    minimise,
    minimise_loss,
    r_squared_reason,
    reason_of_no_fit,
)

_LEAST_SLOPE = 1e-10
"""Slope theta_1 of rate/greatest rate below which there is no onset, since the slope is a rounding error."""

_LEAST_SLOPE_IN_ERRORS = 2.0
"""Slope theta_1 in standard errors below which there is no onset: its Fieller confidence interval is unbounded."""

_SCHEMA = {
    "C": Variable("m s-1", "coefficient of the rate-of-penetration law"),
    "C_stderr": Variable("m s-1", "standard error of C"),
    "eta0": Variable("1", "relief at the onset"),
    "eta0_stderr": Variable("1", "standard error of eta0"),
    "exponent": Variable("1", "exponent of the relief"),
    "exponent_stderr": Variable("1", "standard error of the exponent"),
    **GOODNESS_SCHEMA,
    "r_squared": Variable("1", "share of the rate's variance that the form explains"),
    "cv_error": Variable("m s-1", "error of rates predicted from the other blocks of rows of a log"),
    "standing": Variable("1", "result of the cross-validation over blocks of rows", np.int8, STANDINGS),
}


def fit_rop(
    data: Data,
    along: str | None = None,
    by: Sequence[str] = (),
    robust: str | None = None,
    progress: bool = True,
    columns: Columns = None,
    dialect: str | None = None,
    fastest: str | None = None,
    segments: bool = False,
) -> xr.Dataset:
    """Fit the rate-of-penetration law (source, eq. 6.4) in three readings, and three rivals, to each group of lanes.

    The fit minimises the squared residuals of the rate. A lane at zero rate is censored: it contributes only if a form
    predicts a positive rate. Lanes that failed, are irregular or have no usable values are left out and counted.
    Standard errors follow from the Jacobian and the residual of each lane. They are therefore valid for noise of
    constant size as well as for noise proportional to the rate.

    The noise of neighbouring rows of a rig log is correlated. From 50 rows on, a bootstrap of blocks of rows gives the
    standard errors. The forms are compared by cross-validation: the rates of each block are predicted from all other
    blocks (`cv_error`, `standing`). AIC takes rows for independent and is overconfident there.

    **Arguments:**

    - `data`: dataset with rate_of_penetration [m/s], relief [1] and optionally regime, or the path of such a dataset
      (.nc) or of a rig log (.csv or .las, see `read_log`), or a DataFrame with the columns of such a .csv.
    - `along`: axis along which the lanes of a group vary, by default frequency, v or point. Each combination of values
      on the other axes is a group.
    - `by`: columns of a table (a CSV, or a sweep of points) whose values distinguish the groups. If `along` is a
      column, the default is all columns except `along` and mean_force.
    - `robust`: "soft-l1" or "huber", a loss for data with outliers, scaled by the median absolute deviation. R² and
      AIC are still computed from the plain residuals.
    - `progress`: whether to report on stderr when the fit is done.
    - `columns`: by quantity, the column of a CSV and its unit, such as {"rate_of_penetration": "ROP (m/h)",
      "mean_force": "WOB (kN)"}, or a constant value for all rows, such as {"threshold": "150 kN"}.
      {"rock": "granite"} takes the threshold of that rock. {"threshold": "unknown"} is the default of logs: eta is then
      the force over its median (attribute `reference_force` [N]), and `onset_force` [N] is the force at the onset.
    - `dialect`, `fastest`: of a rig log, as in `read_log`.
    - `segments`: whether to split a log into intervals of depth with laws of their own, as many as the data suggest.

    **Returns:** a dataset over the groups and `form`: C [m/s], eta0 [1] and exponent [1], each with its standard error;
    r_squared, aic, degrees_of_freedom, used, left_out, and `reason`. A coefficient is NaN if the form does not have it
    or the lanes do not identify it. r_squared is NaN if the rates do not vary; `r_squared_reason` explains it. The
    dataset also contains the data, over the groups and `lane`: data_relief [1], data_rate_of_penetration [m/s], and
    `data_use` (fitted, censored, left-out).

    **Raises:** `InputError`.

    **Example:**

    >>> axes = {"force": [400e3, 500e3], "frequency": [10.0, 20.0, 30.0, 40.0]}
    >>> rates = vj.run_sweep({"scene": "penetration", "parameters": {"rock": "granite"}, "grid": axes}, progress=False)
    >>> fit = vj.fit_rop(rates, along="frequency", progress=False)
    >>> fit.exponent.sel(form="power").round(3).values.tolist()  # along frequency the rate is in proportion to P/D
    [1.0, 1.0]
    """
    place, data, groups = read_groups(data, along, by, columns, segments, dialect=dialect, fastest=fastest)
    if robust is not None:
        choice(place.at("robust"), robust, LOSSES)
    return fit_groups(place, data, groups, robust, progress)


def read_groups(
    data: Data,
    along: str | None,
    by: str | Sequence[str],
    columns: Columns,
    segments: bool = False,
    **reading: str | None,
) -> tuple[Place, xr.Dataset, xr.Dataset]:
    """Return the data of a fit and their groups, and the `Place` for messages; the arguments are those of `fit_rop`.

    **Raises:** `InputError`.
    """
    place, data = open_data(data, "fit_rop", columns=columns, **reading)
    lanes, by = usable_lanes(data), (by,) if isinstance(by, str) else tuple(by)
    if segments:
        if "dialect" not in data.attrs:
            raise place.at("segments").error("is for the rows of a log; leave out segments")
        if by or along:
            raise place.at("segments").error("makes the groups; leave out along and by")
        valid, numbers = lanes["valid"].values, np.zeros(lanes["valid"].size, int)
        numbers[valid] = find_segments(lanes["relief"].values[valid], lanes["rate"].values[valid])
        lanes = lanes.assign_coords(segment=("point", np.maximum.accumulate(numbers), {"units": "1"}))
        by = ("segment",)
    return place, data, group_lanes(place, lanes, along, by)


def fit_groups(
    place: Place, data: xr.Dataset, groups: xr.Dataset, robust: str | None = None, progress: bool = False
) -> xr.Dataset:
    """Fit every form to every group; return the dataset that `fit_rop` describes."""
    along, (*dims, _) = groups.attrs["along"], groups["rate"].dims
    sizes, counts = tuple(groups.sizes[dim] for dim in dims), groups["is_lane"].sum("lane").values.ravel()
    LOG.info("chosen: along %s, %d groups, loss %s", along, counts.size, robust or "squares")
    start = time.monotonic()
    ordered, unknown = "dialect" in data.attrs, "reference_force" in data.attrs
    fits: list[dict[str, float | int]] = []
    lanes = (groups[name].values.reshape(counts.size, -1) for name in ("relief", "rate", "valid"))
    for relief, rate, valid in zip(*lanes, strict=True):
        fits += _fit_group(relief[valid], rate[valid], robust, ordered, unknown)
    if progress:
        fitted = f"{counted(counts.size, 'group')} of {counted(counts.max(), 'lane')} along {along} fitted"
        print("\n".join([*log_lines(data), f"{fitted} in {time.monotonic() - start:.1f} s"]), file=sys.stderr)
    values = {name: np.array([fit[name] for fit in fits]) for name in fits[0]}
    values["left_out"] = np.repeat(counts, len(FORMS)) - values["used"]
    values["r_squared_reason"] = r_squared_reason(values["r_squared"], values["reason"])
    shaped = {name: value.reshape(*sizes, len(FORMS)) for name, value in values.items()}
    form = ("form", [form.name for form in FORMS], {"units": "1", "long_name": "form of the law"})
    more = {"along": along, "formulas": "; ".join(f"{form.name}: {form.formula}" for form in FORMS)}
    more |= {"robust": robust} if robust else {}
    schema_dims, coordinates = dict.fromkeys(_SCHEMA, (*dims, "form")), {**groups.coords, "form": form}
    fit = fit_dataset(place, data, "fit", LAW_TITLE, _SCHEMA, shaped, schema_dims, coordinates, **more)
    if unknown:
        for name in ("", "_stderr"):
            about = {"units": "N", "long_name": "standard error of " * bool(name) + "the force at the onset, eta0 D"}
            fit[f"onset_force{name}"] = (data.attrs["reference_force"] * fit[f"eta0{name}"]).assign_attrs(about)
    return fit.assign(data_variables(groups))


def _fit_group(
    relief: Lanes, rate: Lanes, robust: str | None, ordered: bool, unknown: bool
) -> list[dict[str, float | int]]:
    """Fit every form to a group, and compare the forms by cross-validation over blocks if its rows are `ordered`.

    `unknown`: whether the threshold is unknown.
    """
    ordered = ordered and rate.size >= LEAST_ROWS and bool(np.ptp(relief) > 0)
    fits: list[dict[str, float | int]] = []
    minima: dict[int, tuple[Model, Minimum]] = {}
    for index, form in enumerate(FORMS):
        if unknown and form.name in SAME_AS_ONSET:
            fits.append(_no_fit(rate) | {"reason": Reason.UNKNOWN_THRESHOLD})
            continue
        fit, model_and_minimum = _fit_form(form, relief, rate, robust, ordered)
        fits.append(fit)
        if model_and_minimum is not None:
            minima[index] = model_and_minimum
    noise = min((minimum.residual for _, minimum in minima.values()), key=np.linalg.norm, default=rate)
    if not ordered or (block := blocks_of(noise)) is None:
        return fits
    unit = float(rate.max())
    errors = np.full((len(FORMS), int(block[-1]) + 1), np.nan)
    for index, (model, minimum) in minima.items():
        errors[index] = prediction_errors(model, minimum.theta, rate / unit, rate <= 0, block)
    standing = compare(errors, [form.name for form in FORMS], [form.size for form in FORMS])
    for fit, value, squares in zip(fits, standing.tolist(), errors.mean(axis=1).tolist(), strict=True):
        fit |= {"standing": value, "cv_error": unit * float(np.sqrt(squares))}
    return fits


def _no_fit(rate: Lanes) -> dict[str, float | int]:
    names = [name for name, variable in _SCHEMA.items() if variable.dtype is np.float64]
    return {**dict.fromkeys(names, np.nan), "degrees_of_freedom": 0, "used": rate.size, "standing": 0}


def _fit_form(
    form: Form, relief: Lanes, rate: Lanes, robust: str | None, ordered: bool
) -> tuple[dict[str, float | int], tuple[Model, Minimum] | None]:
    """Fit a form to one group; return its values by name, NaN with a `reason` if the lanes do not identify them.

    `ordered`: whether the noise of neighbouring lanes is correlated. The second result is the model and its minimum,
    with rates in units of the greatest one.
    """
    seen, fit = rate > 0, _no_fit(rate)
    if (reason := reason_of_no_fit(seen, form.size, np.log(relief))) is not None:
        return fit | {"reason": reason}, None
    unit = float(rate.max())  # scaled rates: squares of very small or large rates would underflow or overflow
    y, censored = rate / unit, ~seen
    model, frame = form.model(relief, seen)
    minimum, spread = minimise(model, y, censored), 1.0
    if robust:
        minimum, spread = minimise_loss(LOSSES[robust], model, y, censored, minimum)
    if not minimum.converged:
        return fit | {"reason": Reason.NOT_CONVERGED}, None
    theta, lanes = minimum.theta, minimum.active
    noise = minimum.residual[lanes]
    if robust:  # the residual is replaced by psi (the derivative of the loss), divided by the mean of its slope
        (weight, slope), scaled = LOSSES[robust], noise / spread
        noise = noise * weight(scaled) / np.mean(slope(scaled))
    if ordered:
        rows = np.zeros(rate.size)
        rows[lanes] = noise
        square = block_covariance(np.where(lanes[:, None], minimum.jacobian, 0.0), rows)
    else:
        square = covariance(minimum.jacobian[lanes], noise)
    values, slopes = form.coefficients(theta, *frame)
    errors = np.sqrt(np.einsum("ci,ij,cj->c", slopes, square, slopes))
    reason = Reason.IDENTIFIED
    if form.kind == "onset":  # a horizontal line has C close to zero, and no onset
        least = max(_LEAST_SLOPE, _LEAST_SLOPE_IN_ERRORS * float(np.sqrt(square[1, 1])))
        if abs(theta[1]) <= least or not np.isfinite(values[1]):
            values[1], reason = np.nan, Reason.NO_SLOPE
    errors[np.isnan(values)] = np.nan
    for name, scale, value, error in zip(("C", "eta0", "exponent"), (unit, 1.0, 1.0), values, errors, strict=True):
        fit[name], fit[f"{name}_stderr"] = scale * value, scale * error
    return fit | goodness(minimum, y, unit) | {"reason": reason}, (model, minimum)
