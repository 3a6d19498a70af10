"""Fits of every form of the rate-of-penetration law to every group of lanes (a lane: one relief and its rate).

The source's law, rate = C ln(P/D) (eq. 6.4), gives a negative rate if the relief P/D is below 1. It is therefore read
in three ways ("forms"): as printed, with P/D in percent, and as C ln((P/D)/eta0) with a fitted onset eta0, the relief
at which penetration begins. A straight line and a power law serve as comparison.
"""

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.analyses.rop_law.data import Columns, Data, open_data
from vibrojax.analyses.rop_law.groups import Groups, group_lanes, usable_lanes
from vibrojax.analyses.rop_law.least_squares import (
    LOSSES,
    ExponentialRates,
    Jacobian,
    LaneFlags,
    Lanes,
    LinearRates,
    RateModel,
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
from vibrojax.errors import Place, counted, shown, suggestion
from vibrojax.io.riglog.columns import columns_lines
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
}

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

    def model(self, relief: Lanes, seen: LaneFlags) -> tuple[RateModel, tuple[float, float]]:
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
)


def fit_rop(
    data: Data,
    along: str | None = None,
    by: Sequence[str] = (),
    robust: str | None = None,
    progress: bool = True,
    columns: Columns = None,
) -> xr.Dataset:
    """Fit the rate-of-penetration law (source, eq. 6.4) in three readings, and two rival forms, to each group of lanes.

    The fit minimises the squared residuals of the rate. A lane at zero rate is censored: it contributes only if a form
    predicts a positive rate. Lanes that failed, are irregular or have no usable values are left out and counted.
    Standard errors follow from the Jacobian and the residual of each lane. They are therefore valid for noise of
    constant size as well as for noise proportional to the rate.

    **Arguments:**

    - `data`: dataset with rate_of_penetration [m/s], relief [1] and optionally regime, or the path of such a dataset
      (.nc) or of a .csv with one row per lane, or a DataFrame with the columns of such a .csv.
    - `along`: axis along which the lanes of a group vary, by default frequency, v or point. Each combination of values
      on the other axes is a group.
    - `by`: columns of a table (a CSV, or a sweep of points) whose values distinguish the groups. If `along` is a
      column, the default is all columns except `along` and mean_force.
    - `robust`: "soft-l1" or "huber", a loss for data with outliers, scaled by the median absolute deviation. R² and
      AIC are still computed from the plain residuals.
    - `progress`: whether to report on stderr when the fit is done.
    - `columns`: by quantity, the column of a CSV and its unit, such as {"rate_of_penetration": "ROP (m/h)",
      "mean_force": "WOB (kN)"}, or a constant value for all rows, such as {"threshold": "150 kN"}.
      {"rock": "granite"} takes the threshold of that rock.

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
    place, data, groups = read_groups(data, along, by, columns)
    if robust is not None and robust not in LOSSES:
        raise place.at("robust").error(f"{shown(robust)} is unknown; {suggestion(str(robust), LOSSES)}")
    return fit_groups(place, data, groups, robust, progress)


def read_groups(
    data: Data, along: str | None, by: str | Sequence[str], columns: Columns
) -> tuple[Place, xr.Dataset, Groups]:
    """Return the data of a fit and their groups, and the `Place` for messages; the arguments are those of `fit_rop`.

    **Raises:** `InputError`.
    """
    place, data = open_data(data, "fit_rop", rates=True, columns=columns)
    return place, data, group_lanes(place, usable_lanes(data), along, (by,) if isinstance(by, str) else tuple(by))


def fit_groups(
    place: Place, data: xr.Dataset, groups: Groups, robust: str | None = None, progress: bool = False
) -> xr.Dataset:
    """Fit every form to every group; return the dataset that `fit_rop` describes."""
    LOG.info("chosen: along %s, %d groups, loss %s", groups.along, groups.count.size, robust or "squares")
    start = time.monotonic()
    rows = zip(groups.relief, groups.rate, groups.valid, strict=True)
    fits = [_fit_form(form, relief[valid], rate[valid], robust) for relief, rate, valid in rows for form in FORMS]
    if progress:
        for line in columns_lines(data):
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
    return fit.assign(groups.data_variables())


def _fit_form(form: Form, relief: Lanes, rate: Lanes, robust: str | None) -> dict[str, float | int]:
    """Fit a form to one group; return its values by name, NaN with a `reason` if the lanes do not identify them."""
    seen = rate > 0
    names = [name for name, variable in _SCHEMA.items() if variable.dtype is np.float64]
    fit: dict[str, float | int] = {**dict.fromkeys(names, np.nan), "degrees_of_freedom": 0, "used": rate.size}
    if (reason := reason_of_no_fit(seen, form.size, np.log(relief))) is not None:
        return fit | {"reason": reason}
    unit = float(rate.max())  # scaled rates: squares of very small or large rates would underflow or overflow
    y, censored = rate / unit, ~seen
    model, frame = form.model(relief, seen)
    minimum, spread = minimise(model, y, censored), 1.0
    if robust:
        minimum, spread = minimise_loss(LOSSES[robust], model, y, censored, minimum)
    if not minimum.converged:
        return fit | {"reason": Reason.NOT_CONVERGED}
    theta, lanes = minimum.theta, minimum.active
    noise = minimum.residual[lanes]
    if robust:  # the residual is replaced by psi (the derivative of the loss), divided by the mean of its slope
        (weight, slope), scaled = LOSSES[robust], noise / spread
        noise = noise * weight(scaled) / np.mean(slope(scaled))
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
    return fit | goodness(minimum, y, unit) | {"reason": reason}
