"""Fits of every form of the rate-of-penetration law to every group of lanes (a lane: one relief and its rate).

The source's law, rate = C ln(P/D) (eq. 6.4), gives a negative rate if the relief P/D is below 1. It is therefore read
in three ways ("forms"): as printed, with P/D in percent, and as C ln((P/D)/eta0) with a fitted onset eta0, the relief
at which penetration begins. A straight line, a power law and a constant serve as comparison.
"""

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.analyses.rop_law.blocks import (
    LEAST_ROWS,
    STANDINGS,
    block_covariance,
    blocks_of,
    compare,
    prediction_errors,
)
from vibrojax.analyses.rop_law.data import Columns, Data, open_data
from vibrojax.analyses.rop_law.groups import Groups, group_lanes, usable_lanes
from vibrojax.analyses.rop_law.least_squares import (
    LOSSES,
    ExponentialRates,
    Jacobian,
    LaneFlags,
    Lanes,
    LinearRates,
    Minimum,
    Reason,
    Theta,
    covariance,
    goodness,
    minimise,
    minimise_loss,
    r_squared_reason,
    reason_of_no_fit,
)
from vibrojax.analyses.rop_law.results import GOODNESS_SCHEMA, LAW_TITLE, fit_dataset
from vibrojax.analyses.rop_law.segments import segments as find_segments
from vibrojax.errors import Place, counted, shown, suggestion
from vibrojax.io.riglog import log_lines
from vibrojax.io.variables import Variable
from vibrojax.progress import LOG

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

Model = LinearRates | ExponentialRates
Coefficients = Float[np.ndarray, " 3"]
"""C (in the unit of the rate), eta0 and exponent; NaN for a coefficient that the formula does not have."""

Slopes = Float[np.ndarray, "3 coefficients"]
"""Derivatives of `Coefficients` with respect to the fitted parameters theta."""


@dataclass(frozen=True)
class Form:
    """A formula of the law: the rate as a function of z = (t - centre)/spread, a variable t(eta) scaled in each group.

    eta is the relief P/D. `variable` is the function t, and `inverse` converts t to eta. `kind` is one of

    - "proportional": rate = theta_0 z,
    - "onset": rate = theta_0 + theta_1 z,
    - "power": rate = exp(theta_0 + theta_1 z).

    `rate` is the formula as a function of eta and the coefficients C, eta0 and exponent.
    """

    name: str
    formula: str
    kind: str
    variable: Callable[[Lanes], Lanes]
    rate: Callable[[Lanes, float, float, float], Lanes]
    inverse: Callable[[float], float] = float

    @property
    def size(self) -> int:
        return 1 if self.kind == "proportional" else 2

    def model(self, relief: Lanes, seen: LaneFlags) -> tuple[Model, tuple[float, float]]:
        """Return the model of a group's rates, and the centre and spread of t over `seen`, the lanes that penetrate."""
        t = self.variable(relief)
        centre = 0.0 if self.kind == "proportional" else float(t[seen].mean())
        spread = float(np.sqrt(np.mean((t[seen] - centre) ** 2)))
        z = (t - centre) / spread
        columns: Jacobian = z[:, None] if self.size == 1 else np.stack([np.ones_like(z), z], axis=1)
        return (ExponentialRates if self.kind == "power" else LinearRates)(columns), (centre, spread)

    def coefficients(self, theta: Theta, centre: float, spread: float) -> tuple[Coefficients, Slopes]:
        """Return the coefficients of the law, and their derivatives with respect to theta."""
        none = [np.nan] * self.size
        if self.kind == "proportional":
            return np.array([theta[0] / spread, np.nan, np.nan]), np.array([[1 / spread], none, none])
        if self.kind == "power":
            exponent = theta[1] / spread
            c = np.exp(theta[0] - exponent * centre)
            return np.array([c, np.nan, exponent]), np.array([[c, -c * centre / spread], none, [0.0, 1 / spread]])
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            onset = centre - spread * theta[0] / theta[1]
            eta0 = self.inverse(onset)
            slope = (eta0 if self.variable is np.log else 1.0) * spread / theta[1]
            slopes = [[0.0, 1 / spread], [-slope, slope * theta[0] / theta[1]], none]
        return np.array([theta[1] / spread, eta0, np.nan]), np.array(slopes)


FORMS = (
    Form("literal", "C ln(eta)", "proportional", np.log, lambda eta, C, eta0, exponent: C * np.log(eta)),
    Form(
        "percent",
        "C ln(100 eta)",
        "proportional",
        lambda eta: np.log(100 * eta),
        lambda eta, C, eta0, exponent: C * np.log(100.0 * eta),
    ),
    Form("onset", "C ln(eta/eta0)", "onset", np.log, lambda eta, C, eta0, exponent: C * np.log(eta / eta0), np.exp),
    Form("line", "C (eta - eta0)", "onset", np.asarray, lambda eta, C, eta0, exponent: C * (eta - eta0)),
    Form("power", "C eta^exponent", "power", np.log, lambda eta, C, eta0, exponent: C * eta**exponent),
    Form("constant", "C", "proportional", np.ones_like, lambda eta, C, eta0, exponent: C * np.ones_like(eta)),
)

SAME_AS_ONSET = ("literal", "percent")
"""Forms that have the same curve as the onset form if the threshold is unknown."""


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

    The noise of neighbouring rows of a rig log is correlated. From 50 rows on, their standard errors are those of a
    bootstrap of blocks of rows, and forms are compared by the error of the rates of a block of rows, predicted from all
    other blocks (`cv_error`, `standing`). AIC takes rows for independent and is overconfident there.

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
    if robust is not None and robust not in LOSSES:
        raise place.at("robust").error(f"{shown(robust)} is unknown; {suggestion(str(robust), LOSSES)}")
    return fit_groups(place, data, groups, robust, progress)


def read_groups(
    data: Data,
    along: str | None,
    by: str | Sequence[str],
    columns: Columns,
    segments: bool = False,
    **reading: str | None,
) -> tuple[Place, xr.Dataset, Groups]:
    """Return the data of a fit and their groups, and the `Place` for messages; the arguments are those of `fit_rop`.

    **Raises:** `InputError`.
    """
    place, data = open_data(data, "fit_rop", rates=True, columns=columns, **reading)
    lanes, by = usable_lanes(data), (by,) if isinstance(by, str) else tuple(by)
    if segments:
        if by or along or "dialect" not in data.attrs:
            fault = "is for the rows of a log" if "dialect" not in data.attrs else "makes the groups"
            raise place.at("segments").error(f"{fault}; leave out {'segments' if 'log' in fault else 'along and by'}")
        valid, numbers = lanes["valid"].values, np.zeros(lanes["valid"].size, int)
        numbers[valid] = find_segments(lanes["relief"].values[valid], lanes["rate"].values[valid])
        lanes = lanes.assign_coords(segment=("point", np.maximum.accumulate(numbers), {"units": "1"}))
        by = ("segment",)
    return place, data, group_lanes(place, lanes, along, by)


def fit_groups(
    place: Place, data: xr.Dataset, groups: Groups, robust: str | None = None, progress: bool = False
) -> xr.Dataset:
    """Fit every form to every group; return the dataset that `fit_rop` describes."""
    LOG.info("chosen: along %s, %d groups, loss %s", groups.along, groups.count.size, robust or "squares")
    start = time.monotonic()
    rows = zip(groups.relief, groups.rate, groups.valid, strict=True)
    unknown = "reference_force" in data.attrs
    fits = [
        fit
        for relief, rate, valid in rows
        for fit in _fit_group(relief[valid], rate[valid], robust, "dialect" in data.attrs, unknown)
    ]
    if progress:
        for line in log_lines(data):
            print(line, file=sys.stderr)
        number, size, seconds = groups.count.size, groups.count.max(), time.monotonic() - start
        print(
            f"{counted(number, 'group')} of {counted(size, 'lane')} along {groups.along} fitted in {seconds:.1f} s",
            file=sys.stderr,
        )
    values = {name: np.array([fit[name] for fit in fits]) for name in fits[0]}
    values["left_out"] = np.repeat(groups.count, len(FORMS)) - values["used"]
    values["r_squared_reason"] = r_squared_reason(values["r_squared"], values["reason"])
    shaped = {name: value.reshape(*groups.sizes.values(), len(FORMS)) for name, value in values.items()}
    form = ("form", [form.name for form in FORMS], {"units": "1", "long_name": "form of the law"})
    more = {"along": groups.along, "formulas": "; ".join(f"{form.name}: {form.formula}" for form in FORMS)}
    more |= {"robust": robust} if robust else {}
    dims, coordinates = dict.fromkeys(_SCHEMA, (*groups.sizes, "form")), {**groups.coordinates, "form": form}
    fit = fit_dataset(place, data, "fit", LAW_TITLE, _SCHEMA, shaped, dims, coordinates, **more)
    if unknown:
        for name in ("", "_stderr"):
            about = {"units": "N", "long_name": "standard error of " * bool(name) + "the force at the onset, eta0 D"}
            fit[f"onset_force{name}"] = (data.attrs["reference_force"] * fit[f"eta0{name}"]).assign_attrs(about)
    return fit.assign(groups.data_variables())


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
        fit, model, minimum = _fit_form(form, relief, rate, robust, ordered)
        fits.append(fit)
        if model is not None and minimum is not None:
            minima[index] = model, minimum
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
) -> tuple[dict[str, float | int], Model | None, Minimum | None]:
    """Fit a form to one group; return its values by name, NaN with a `reason` if the lanes do not identify them.

    `ordered`: whether the noise of neighbouring lanes is correlated. The other results are the model and its minimum,
    with rates in units of the greatest one.
    """
    seen, fit = rate > 0, _no_fit(rate)
    if (reason := reason_of_no_fit(seen, form.size, np.log(relief))) is not None:
        return fit | {"reason": reason}, None, None
    unit = float(rate.max())  # scaled rates: squares of very small or large rates would underflow or overflow
    y, censored = rate / unit, ~seen
    model, frame = form.model(relief, seen)
    minimum, spread = minimise(model, y, censored), 1.0
    if robust:
        minimum, spread = minimise_loss(LOSSES[robust], model, y, censored, minimum)
    if not minimum.converged:
        return fit | {"reason": Reason.NOT_CONVERGED}, None, None
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
    return fit | goodness(minimum, y, unit) | {"reason": reason}, model, minimum
