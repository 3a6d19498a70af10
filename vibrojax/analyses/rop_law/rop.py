"""The rate-of-penetration law fitted in every form to every group of lanes."""

import sys
import time
from collections.abc import Iterator, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from vibrojax.analyses.rop_law.columns import columns_lines
from vibrojax.analyses.rop_law.data import Columns, Data, open_rates
from vibrojax.analyses.rop_law.fitted_data import fitted_data
from vibrojax.analyses.rop_law.forms import FORMS, Coefficients, Form, Frame, WithOnset
from vibrojax.analyses.rop_law.groups import Groups, grouped, usable_lanes
from vibrojax.analyses.rop_law.least_squares import (
    LOSSES,
    Count,
    Flag,
    LaneFlags,
    LaneValues,
    Loss,
    Minimum,
    Number,
    Theta,
    residuals,
    reweighted,
)
from vibrojax.analyses.rop_law.results import law_title, provenance, reason, with_attributes
from vibrojax.analyses.rop_law.uncertainty import (
    ALL_CENSORED,
    IDENTIFIED,
    LEAST_SPREAD,
    NO_SLOPE,
    NO_SPREAD,
    NOT_CONVERGED,
    TOO_FEW_LANES,
    covariance,
    goodness,
    r_squared_reason,
)
from vibrojax.compile.devices import precision
from vibrojax.errors import shown, suggestion
from vibrojax.io.variables import Variable
from vibrojax.models.arrays import Array
from vibrojax.progress import LOG

LEAST_SLOPE = 1e-10
"""Change of the rate over the lanes as a share of the greatest rate: below it there is no onset."""

LEAST_SLOPE_IN_ERRORS = 2.0
"""The same in standard errors of that change: an interval of the onset (Fieller's) then has no ends."""

_MOST_GROUPS, _FEWEST_LANES, _BLOCK = 64, 32, 2**16
"""Of a block: groups, lanes of each, and all lanes together."""

_VARIABLES = {
    "C": Variable("m s-1", "coefficient of the rate-of-penetration law"),
    "C_stderr": Variable("m s-1", "standard error of C"),
    "eta0": Variable("1", "relief at the onset"),
    "eta0_stderr": Variable("1", "standard error of eta0"),
    "exponent": Variable("1", "exponent of the relief"),
    "exponent_stderr": Variable("1", "standard error of the exponent"),
    "r_squared": Variable("1", "share of the rate's variance that the form explains"),
    "aic": Variable("1", "n ln(RSS/n) + 2k, RSS in m2 s-2"),
    "degrees_of_freedom": Variable("1", "lanes with a residual less coefficients", np.int32),
    "used": Variable("1", "lanes that the fit used, those at zero rate among them", np.int32),
    "left_out": Variable("1", "lanes left out: failed, irregular, or without usable values", np.int32),
    "reason": reason("why a coefficient is not a number"),
    "r_squared_reason": reason("why r_squared is not a number"),
}


class GroupFit(NamedTuple):
    """One form fitted to one group; NaN where the form has no such coefficient or the lanes do not identify it."""

    C: Float[Array, "*groups"]
    C_stderr: Float[Array, "*groups"]
    eta0: Float[Array, "*groups"]
    eta0_stderr: Float[Array, "*groups"]
    exponent: Float[Array, "*groups"]
    exponent_stderr: Float[Array, "*groups"]
    r_squared: Float[Array, "*groups"]
    aic: Float[Array, "*groups"]
    degrees_of_freedom: Int[Array, "*groups"]
    used: Int[Array, "*groups"]
    reason: Int[Array, "*groups"]


def fit_rop(
    data: Data,
    along: str | None = None,
    by: Sequence[str] = (),
    robust: str | None = None,
    progress: bool = True,
    columns: Columns = None,
) -> xr.Dataset:
    """The rate-of-penetration law, eq. 6.4, in three readings and beside two rivals, fitted to each group of lanes.

    Least squares of the rate. A lane at zero rate is censored: it counts only where a form predicts a rate above zero.
    Lanes that failed or are irregular, or have no usable values, are left out and counted. Standard errors follow from
    the Jacobian and each lane's own residual, so that they hold for noise of one size and for noise in proportion.

    **Arguments:**

    - `data`: a dataset with rate_of_penetration [m/s] and relief [1], and perhaps regime; or the path of such a .nc,
      or of a CSV with columns rate_of_penetration, and relief or mean_force and threshold [N].
    - `along`: the axis to fit along; by default frequency, else v, else the rows. One fit per point of the others.
    - `by`: of a table (a CSV, or a sweep of points), the columns whose values distinguish the groups; all but `along`
      and mean_force where `along` is a column itself.
    - `robust`: "soft-l1" or "huber", for data with outliers; the scale comes from the median absolute deviation. R² and
      AIC stay those of plain residuals.
    - `progress`: say on stderr what was fitted.
    - `columns`: of a CSV, by the names above the file's own column with its unit: {"rate_of_penetration": "ROP (m/h)",
      "mean_force": "WOB (kN)"}, or a value that all rows have: {"threshold": "150 kN"}.

    **Returns:** a dataset over the groups and `form`: C [m/s], eta0 [1] and exponent [1], each with its standard error;
    r_squared, aic, degrees_of_freedom, used, left_out, and `reason`; NaN where a form has no such coefficient or the
    lanes do not identify it. r_squared is NaN where the rates do not vary, and `r_squared_reason` says so. Beside
    them the data, over the groups and `lane`: data_relief [1], data_rate_of_penetration [m/s], and `data_use` (fitted,
    censored, left-out).

    **Raises:** `InputError`.

    **Example:**

    >>> axes = {"force": [400e3, 500e3], "frequency": [10.0, 20.0, 30.0, 40.0]}
    >>> rates = vj.run_sweep({"scene": "penetration", "parameters": {"rock": "granite"}, "grid": axes}, progress=False)
    >>> fit = vj.fit_rop(rates, along="frequency", progress=False)
    >>> fit.exponent.sel(form="power").round(3).values.tolist()  # along frequency the rate is in proportion to P/D
    [1.0, 1.0]
    """
    place, data = open_rates(data, "fit_rop", columns)
    if robust is not None and robust not in LOSSES:
        raise place.at("robust").error(f"{shown(robust)} is unknown; {suggestion(str(robust), LOSSES)}")
    groups = grouped(place, usable_lanes(data), along, (by,) if isinstance(by, str) else tuple(by))
    LOG.info("chosen: along %s, %d groups, loss %s", groups.along, groups.count.size, robust or "squares")
    start = time.monotonic()
    fit = _fit_groups(groups, robust)
    if progress:
        for line in columns_lines(data):
            print(line, file=sys.stderr)
        number, size, seconds = groups.count.size, groups.count.max(), time.monotonic() - start
        print(f"{number} groups of {size} lanes along {groups.along} fitted in {seconds:.1f} s", file=sys.stderr)
    values = {
        **fit._asdict(),
        "left_out": groups.count[:, None] - fit.used,
        "r_squared_reason": r_squared_reason(np.asarray(fit.r_squared), np.asarray(fit.reason)),
    }
    shape = (*groups.sizes.values(), len(FORMS))
    variables = with_attributes(
        _VARIABLES,
        {name: np.asarray(value).reshape(shape) for name, value in values.items()},
        dict.fromkeys(_VARIABLES, (*groups.sizes, "form")),
    )
    variables |= fitted_data(groups)
    form = ("form", [form.name for form in FORMS], {"units": "1", "long_name": "form of the law"})
    more = {"along": groups.along, "formulas": "; ".join(f"{form.name}: {form.formula}" for form in FORMS)}
    more |= {"robust": robust} if robust else {}
    attributes = provenance(place, data, "fit", law_title(place, data), more)
    return xr.Dataset(variables, {**groups.coordinates, "form": form}, attributes)


def _fit_groups(groups: Groups, robust: str | None) -> GroupFit:
    """All forms fitted to all groups, block by block; arrays (groups, forms)."""
    with precision("float64"):
        blocks = [jax.device_get(_fit_block(*block, robust)) for block in _blocks(groups)]
    over_forms = [[np.stack(values, axis=-1) for values in zip(*block, strict=True)] for block in blocks]
    return GroupFit(*(np.concatenate(values)[: len(groups.rate)] for values in zip(*over_forms, strict=True)))


def _blocks(groups: Groups) -> Iterator[tuple[np.ndarray, ...]]:
    """Relief, rate and valid of some groups at a time, filled up with what is not valid.

    Blocks are of one shape, lanes of a power of two: data of about one size share a program, and memory is bounded.
    """
    number, longest = groups.rate.shape
    width = max(_FEWEST_LANES, 1 << (longest - 1).bit_length())
    height = min(_MOST_GROUPS, max(1, _BLOCK // width))
    for first in range(0, number, height):
        block = [x[first : first + height] for x in (groups.relief, groups.rate, groups.valid)]
        yield tuple(np.pad(x, [(0, height - len(x)), (0, width - longest)]) for x in block)


@partial(jax.jit, static_argnames="robust")
def _fit_block(
    relief: Float[Array, "groups lanes"],
    rate: Float[Array, "groups lanes"],
    valid: Bool[Array, "groups lanes"],
    robust: str | None,
) -> list[GroupFit]:
    """Every form fitted to the groups of a block."""
    return [jax.vmap(partial(fit_group, form, robust=robust))(relief, rate, valid) for form in FORMS]


def fit_group(form: Form, relief: LaneValues, rate: LaneValues, valid: LaneFlags, robust: str | None) -> GroupFit:
    """Fit `form` to the valid lanes of one group; a lane at zero rate is censored.

    Everything is of fixed shape, so that one program fits all groups; lanes that are not valid have no weight.

    **Arguments:** `relief` [1], `rate` [m/s]: finite, and relief above zero, where valid; `robust`: a name in `LOSSES`.
    """
    relief, rate = jnp.where(valid, relief, 1.0), jnp.where(valid, rate, 0.0)
    censored, seen = valid & (rate == 0), valid & (rate > 0)
    unit = jnp.max(rate)
    y = rate / unit
    t = form.variable(relief)
    frame = form.frame(t, seen)
    z = (t - frame.centre) / frame.spread

    def residual(theta: Theta) -> tuple[LaneValues, LaneFlags]:
        predicted = form.predict(theta, z)
        return jnp.where(valid, residuals(predicted, y, censored), 0.0), seen | (censored & (predicted > 0))

    def solve(weight: LaneValues, start: Theta) -> Minimum:
        return form.minimum(z, y, weight, censored, start)

    theta, converged = solve(valid * 1.0, form.start(z, y, seen))
    loss_and_scale = None
    if robust:
        loss = LOSSES[robust]
        (theta, settled), scale = reweighted(loss, solve, residual, theta, valid)
        converged &= settled
        loss_and_scale = loss, scale
    left, lanes = residual(theta)
    square, freedom = _covariance(form, theta, z, left, lanes, loss_and_scale)
    values, errors = _coefficients(form, theta, frame, unit, square)

    used = jnp.sum(valid)
    why = _why(form, relief, seen, used, converged & (freedom > 0))
    known = why == IDENTIFIED
    values, errors = jnp.where(known, values, jnp.nan), jnp.where(known, errors, jnp.nan)
    if isinstance(form, WithOnset):  # a level line has a C of about zero, but no onset
        least = jnp.maximum(LEAST_SLOPE, LEAST_SLOPE_IN_ERRORS * jnp.sqrt(square[1, 1]))
        level = (jnp.abs(theta[1]) <= least) | ~jnp.isfinite(values[1])
        onset = jnp.array([False, True, False]) & level
        values, errors = jnp.where(onset, jnp.nan, values), jnp.where(onset, jnp.nan, errors)
        why = jnp.where(known & level, NO_SLOPE, why)
    r_squared, aic = goodness(left, y, unit, valid, form.size)
    return GroupFit(
        C=values[0],
        C_stderr=errors[0],
        eta0=values[1],
        eta0_stderr=errors[1],
        exponent=values[2],
        exponent_stderr=errors[2],
        r_squared=jnp.where(known, r_squared, jnp.nan),
        aic=jnp.where(known, aic, jnp.nan),
        degrees_of_freedom=jnp.where(known, freedom, 0),
        used=used,
        reason=why,
    )


def _why(form: Form, relief: LaneValues, seen: LaneFlags, used: Count, converged: Flag) -> Count:
    """Whether the form is identified, and why not; an index into `REASONS`."""
    spread = jnp.std(jnp.log(relief), where=seen)
    return jnp.select(
        [used == 0, ~jnp.any(seen), jnp.sum(seen) <= form.size, ~(spread > LEAST_SPREAD), ~converged],
        [TOO_FEW_LANES, ALL_CENSORED, TOO_FEW_LANES, NO_SPREAD, NOT_CONVERGED],
        IDENTIFIED,
    )


def _covariance(
    form: Form,
    theta: Theta,
    z: LaneValues,
    residual: LaneValues,
    lanes: LaneFlags,
    robust: tuple[Loss, Number] | None,
) -> tuple[Float[Array, "coefficients coefficients"], Count]:
    """Covariance of theta over the lanes that have a residual, and how many more than coefficients these are.

    A censored lane below the onset pins nothing, so it is in neither. For a robust loss Huber's psi over the mean of
    its slope stands for the residual.
    """
    jacobian = jax.jacfwd(lambda theta: form.predict(theta, z))(theta) * lanes[:, None]
    count = jnp.sum(lanes)
    if robust:
        loss, scale = robust
        scaled = residual / scale
        slope = jnp.sum(jnp.where(lanes, loss.slope(scaled), 0.0)) / count
        residual = residual * loss.weight(scaled) / slope
    residual = jnp.where(lanes, residual, 0.0)
    return covariance(jnp.linalg.inv(jacobian.T @ jacobian), jacobian, residual, lanes), count - form.size


def _coefficients(
    form: Form, theta: Theta, frame: Frame, unit: Number, square: Float[Array, "coefficients coefficients"]
) -> tuple[Coefficients, Coefficients]:
    """C [m/s], eta0 and exponent, and their standard errors by the delta method; NaN where the form has none."""

    def coefficients(theta: Theta) -> Coefficients:
        return form.coefficients(theta, frame)

    values, slopes = coefficients(theta), jax.jacfwd(coefficients)(theta)
    errors = jnp.sqrt(jnp.einsum("ci,ij,cj->c", slopes, square, slopes))
    units = jnp.array([unit, 1.0, 1.0])  # last, because the squares of extreme rates underflow or overflow
    return values * units, jnp.where(jnp.isnan(values), jnp.nan, errors * units)
