"""One law fitted to all lanes: C and eta0 are power laws of the parameters, with coefficients shared by all lanes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float
from scipy.linalg import block_diag

from vibrojax.errors import Place, suggestion
from vibrojax.io.variables import Variable
from vibrojax.settings.values import choice
from vibrojax.studies.rop_data import Columns, Data, open_data
from vibrojax.studies.rop_dataset import GOODNESS_SCHEMA, LAW_TITLE, fit_dataset, reason_variable
from vibrojax.studies.rop_groups import check_axis, usable_lanes
from vibrojax.studies.rop_least_squares import (
    LARGEST_EXPONENT,
    LEAST_SPREAD,
    Jacobian,
    Lanes,
    Reason,
    Square,
    Theta,
    confounded_coefficients,
    covariance,
    goodness,
    minimise,
    r_squared_reason,
    reason_of_no_fit,
)

DEFAULT_PARAMETERS = ("force", "k3", "zeta", "threshold")
ONSETS = ("power-law", "shared")

_OUTSIDE = 1e-6
"""Fraction of a parameter's direction outside the space spanned by the lanes, above which it is not identified.

Smaller fractions are rounding errors.
"""

_SCHEMA = {
    "C": Variable("m s-1", "coefficient of the rate-of-penetration law at the reference"),
    "C_stderr": Variable("m s-1", "standard error of C"),
    "C_exponent": Variable("1", "exponent of the parameter in C"),
    "C_exponent_stderr": Variable("1", "standard error of the parameter's exponent in C"),
    "eta0": Variable("1", "relief at the onset, at the reference"),
    "eta0_stderr": Variable("1", "standard error of eta0"),
    "eta0_exponent": Variable("1", "exponent of the parameter in eta0"),
    "eta0_exponent_stderr": Variable("1", "standard error of the parameter's exponent in eta0"),
    "reference": Variable("1", "value of the parameter at the reference, in its own unit"),
    **GOODNESS_SCHEMA,
    "exponent_reason": reason_variable("why the parameter's exponents are not numbers"),
}

Positions = Float[np.ndarray, "lanes directions"]
"""ln(parameter/reference) of the lanes, as components along the directions in which the parameters vary."""
Coefficients = Float[np.ndarray, " all"]
"""Coefficients of the joint law: ln C, the exponents in C, ln eta0, the exponents in eta0.

There are 2 + 2n coefficients for n parameters.
"""


def fit_joint(
    data: Data,
    along: str | None = None,
    over: Sequence[str] = DEFAULT_PARAMETERS,
    onset: str = "power-law",
    columns: Columns = None,
) -> xr.Dataset:
    """Fit one law to all lanes together, with C and eta0 as power laws of the parameters x_j.

        rate = C ln(eta/eta0),  C = C_ref prod (x_j/ref_j)^a_j,  eta0 = eta0_ref prod (x_j/ref_j)^b_j

    The fit minimises the squared residuals of the rate. Its initial guess is a power law through onset fits to lanes
    with equal parameters. Censored lanes (at zero rate) and lanes that are left out are treated as in `fit_rop`.

    **Arguments:**

    - `data`: data as in `fit_rop`; the parameters x_j are its coordinates (columns of a CSV).
    - `along`: an axis that cannot be a parameter of the law; None excludes no axis.
    - `over`: names of the parameters x_j.
    - `onset`: "power-law", or "shared" for the same eta0 at all lanes (b_j = 0).
    - `columns`: sources of the quantities in a CSV, as in `fit_rop`.

    **Returns:** a dataset with

    - `C` [m/s] and `eta0` at the reference, which is the geometric mean of each parameter over the penetrating lanes;
    - the exponents `C_exponent` and `eta0_exponent` along `parameter`; each coefficient has a standard error;
    - `r_squared`, `aic`, `degrees_of_freedom`, `used`, `left_out`;
    - `reason`: why all coefficients are NaN; `exponent_reason`: why the exponents of one parameter are NaN. The latter
      happens if the parameter is constant or varies only together with another; the other coefficients remain valid.

    The attribute `not_identified` lists the coefficients that are not identified.

    **Raises:** `InputError`.

    **Example:**

    >>> axes = {"force": [300e3, 400e3, 500e3], "frequency": [10.0, 20.0, 30.0]}
    >>> rates = vj.run_sweep({"scene": "penetration", "parameters": {"rock": "granite"}, "grid": axes}, progress=False)
    >>> joint = vj.fit_joint(rates, over=["force"])
    >>> f"C = {1e3 * float(joint.C):.0f} mm/s, in proportion to force^{joint.C_exponent.item():.1f}"
    'C = 14 mm/s, in proportion to force^2.9'
    """
    place, data = open_data(data, "fit_joint", columns=columns)
    choice(place.at("onset"), onset, ONSETS)
    lanes = usable_lanes(data)
    if along is not None:
        check_axis(place, lanes, along)
    relief, rate, valid = (lanes[name].values.ravel() for name in ("relief", "rate", "valid"))
    names, shared = tuple(over), onset == "shared"
    number, required = len(names), names != DEFAULT_PARAMETERS
    logs = np.zeros((rate.size, number))
    for index, name in enumerate(names):
        logs[:, index] = _log_parameter(place.at(f"over.{name}"), lanes, name, along, valid, required)
    relief, rate, logs = relief[valid], rate[valid], logs[valid]
    seen = rate > 0
    centre = logs[seen].mean(axis=0) if seen.any() else np.full(number, np.nan)
    logs = np.nan_to_num(logs - centre)
    # The law is fitted along the directions in which the logarithms of the parameters vary. The exponent of a parameter
    # is identified if these directions span the parameter's own direction.
    directions = np.zeros((0, number))
    if logs[seen].size:
        _, singular, directions = np.linalg.svd(logs[seen] - logs[seen].mean(axis=0), full_matrices=False)
        directions = directions[singular > LEAST_SPREAD * np.sqrt(seen.sum())]
    spanned = (directions**2).sum(axis=0) > 1 - _OUTSIDE
    # Matrix from the free to all coefficients: ln C and its exponents, ln eta0 and its exponents (0 if shared).
    half = np.zeros((1 + number, 1 + len(directions)))
    half[0, 0], half[1:, 1:] = 1, directions.T
    expansion = block_diag(half, half[:, :1] if shared else half)
    fit, theta, errors, lost = _calibrate(relief, rate, logs @ directions.T, expansion, shared)
    if fit["reason"] == Reason.IDENTIFIED:
        lost = ~np.concatenate([[True], spanned, [True], spanned])
        theta, errors = np.where(lost, np.nan, theta), np.where(lost, np.nan, errors)
    varies = np.abs(logs).max(axis=0, initial=0.0) > LEAST_SPREAD
    c, eta0 = rate.max(initial=0.0) * np.exp(theta[0]), np.exp(theta[1 + number])
    values = {
        **fit,
        "C": c,
        "C_stderr": c * errors[0],
        "C_exponent": theta[1 : 1 + number],
        "C_exponent_stderr": errors[1 : 1 + number],
        "eta0": eta0,
        "eta0_stderr": eta0 * errors[1 + number],
        "eta0_exponent": theta[2 + number :],
        "eta0_exponent_stderr": errors[2 + number :],
        "reference": np.exp(centre),
        "used": valid.sum(),
        "left_out": (~valid).sum(),
        "r_squared_reason": r_squared_reason(np.asarray(fit["r_squared"]), np.asarray(fit["reason"])),
        "exponent_reason": np.where(spanned, fit["reason"], np.where(varies, Reason.CONFOUNDED, Reason.NO_SPREAD)),
    }
    dims = {name: ("parameter",) for name in _SCHEMA if np.ndim(values[name])}
    labels = ["C", *(f"C_exponent {name}" for name in names), "eta0"]
    labels += [f"eta0_exponent {name}" for name in names if not shared]
    more = {
        "formula": "C ln(eta/eta0), C and eta0 power laws of the parameters",
        "onset": onset,
        "not_identified": ", ".join(label for label, flag in zip(labels, lost, strict=not shared) if flag) or "none",
    }
    coordinate = ("parameter", np.array(names, dtype=str), {"units": "1", "long_name": "parameter"})
    coordinates = {"parameter": coordinate}
    return fit_dataset(place, data, "joint fit", LAW_TITLE, _SCHEMA, values, dims, coordinates, **more)


def _log_parameter(
    place: Place, lanes: xr.Dataset, name: str, along: str | None, valid: Bool[np.ndarray, " lanes"], required: bool
) -> Lanes:
    """Return the logarithm of a parameter for every lane; NaN if it is neither in the data nor `required`."""
    if name not in lanes.coords or name == along:
        if required:
            choice = [str(coordinate) for coordinate in lanes.coords if coordinate != along]
            raise place.error(f"is not a coordinate of the data beside along; {suggestion(name, choice)}")
        return np.full(valid.size, np.nan)
    if lanes[name].dtype.kind not in "fiu":
        raise place.error("does not hold numbers; a power law needs them")
    on_lanes = xr.broadcast(lanes[name], lanes["rate"])[0].transpose(*lanes["rate"].dims)
    values = on_lanes.values.ravel().astype(np.float64)
    if not (np.isfinite(values[valid]) & (values[valid] > 0)).all():
        raise place.error("has values that are not above 0; a power law needs them above 0")
    return np.log(values, where=valid, out=np.full(valid.size, np.nan))


def _calibrate(
    relief: Lanes, rate: Lanes, positions: Positions, expansion: Float[np.ndarray, "all free"], shared: bool
) -> tuple[dict[str, float | int], Coefficients, Coefficients, Bool[np.ndarray, " all"]]:
    """Fit the joint law. Return the goodness of fit with a `reason`, and of all coefficients the values and errors.

    The last result is a mask of the coefficients that are not identified. If there are any, all values are NaN. C is in
    units of the greatest rate.
    """
    log, seen = np.log(relief), rate > 0
    size, free = expansion.shape
    fit: dict[str, float | int] = {"degrees_of_freedom": 0, "r_squared": np.nan, "aic": np.nan}
    nothing, every = np.full(size, np.nan), np.ones(size, bool)
    if (reason := reason_of_no_fit(seen, free, log)) is not None:
        return fit | {"reason": reason}, nothing, nothing, every
    unit = float(rate.max())
    minimum = minimise(JointRates(log, positions, shared), rate / unit, ~seen)
    jacobian = minimum.jacobian[minimum.active]
    if not np.isfinite(jacobian).all():
        return fit | {"reason": Reason.NOT_CONVERGED}, nothing, nothing, every
    confounded = confounded_coefficients(jacobian)
    if confounded.any():
        lost = (expansion[:, confounded] ** 2).sum(axis=1) > _OUTSIDE
        return fit | {"reason": Reason.CONFOUNDED}, nothing, nothing, lost
    if not minimum.converged:
        return fit | {"reason": Reason.NOT_CONVERGED}, nothing, nothing, every
    square = covariance(jacobian, minimum.residual[minimum.active])
    fit |= goodness(minimum, rate / unit, unit) | {"reason": Reason.IDENTIFIED}
    errors = np.sqrt(np.einsum("ci,ij,cj->c", expansion, square, expansion))
    return fit, expansion @ minimum.theta, errors, ~every


@dataclass(frozen=True)
class JointRates:
    """Model of the rates of the joint law.

    theta consists of ln C and its exponents, then ln eta0 and its exponents (no exponents of eta0 if `shared`). The
    exponents are components along the directions of `Positions`; `log` is ln(eta).
    """

    log: Lanes
    positions: Positions
    shared: bool

    def _terms(
        self, theta: Theta
    ) -> tuple[Lanes, Lanes, Float[np.ndarray, "lanes in_c"], Float[np.ndarray, "lanes in_eta0"]]:
        """Return C, ln(eta/eta0), and the design matrices of ln C and of ln eta0, both linear in theta."""
        constant = np.ones((self.log.size, 1))
        columns = np.hstack([constant, self.positions])
        onset_columns = constant if self.shared else columns
        c = np.exp(np.minimum(columns @ theta[: columns.shape[1]], LARGEST_EXPONENT))
        return c, self.log - onset_columns @ theta[columns.shape[1] :], columns, onset_columns

    def rates(self, theta: Theta) -> Lanes:
        c, above, _, _ = self._terms(theta)
        return c * above

    def jacobian(self, theta: Theta) -> Jacobian:
        c, above, columns, onset_columns = self._terms(theta)
        return c[:, None] * np.hstack([above[:, None] * columns, -onset_columns])

    def curvature(self, theta: Theta, weight: Lanes) -> Square:
        c, above, columns, onset_columns = self._terms(theta)
        mixed = -columns.T @ ((weight * c)[:, None] * onset_columns)
        own = columns.T @ ((weight * c * above)[:, None] * columns)
        return np.block([[own, mixed], [mixed.T, np.zeros((onset_columns.shape[1],) * 2)]])

    def start(self, rate: Lanes, weight: Lanes) -> Theta:
        """Return an initial guess with the same onset at all lanes.

        The exponents in C are those of a power law of the relief and the parameters. C and the onset follow from a
        straight line, rate over ln(eta), through the rates without the effect of the parameters.
        """
        lanes = np.flatnonzero(weight)
        log, positions, rate = self.log[lanes], self.positions[lanes], rate[lanes]
        design = np.column_stack([np.ones(lanes.size), log, positions])
        exponents = np.linalg.lstsq(design, np.log(rate))[0][2:]
        slope, level = np.polyfit(log - log.mean(), rate / np.exp(positions @ exponents), 1)
        if slope > 0:
            c, onset = np.log(slope), log.mean() - level / slope
        else:  # the rate decreases with the relief: guess C = 1 and an onset below all lanes
            c, onset = 0.0, self.log.min() - 1
        return np.array([c, *exponents, onset, *([] if self.shared else 0 * exponents)])
