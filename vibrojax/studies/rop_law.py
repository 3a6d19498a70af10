"""Fits of every form of the rate-of-penetration law to every group of lanes (a lane: one relief and its rate)."""

import json
import sys
import time
import warnings
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from vibrojax.errors import Place, counted
from vibrojax.io.attributes import title_of
from vibrojax.io.kinds import dataset_attributes
from vibrojax.io.log_columns import FORCE
from vibrojax.io.log_filters import Where, line_ranges
from vibrojax.io.riglog import Nulls, log_lines
from vibrojax.io.variables import Variable, described
from vibrojax.progress import LOG
from vibrojax.settings.values import choice
from vibrojax.studies.rop_blocks import (
    AIC_LIMIT,
    BLOCK_LIMIT,
    LEAST_CLEANED,
    LEAST_ROWS,
    STANDINGS,
    Founder,
    block_covariance,
    blocks_of,
    correlation,
    decay_of,
    find_founder,
    predictions_without,
    standings,
    supported,
    wrong_rows,
)
from vibrojax.studies.rop_data import LANE_VARIABLES, Columns, Data, group_lanes, is_measured, open_data, usable_lanes
from vibrojax.studies.rop_forms import (
    FORMS,
    LEAST_SPREAD,
    LOSSES,
    REASONS,
    SAME_AS_ONSET,
    LaneBlocks,
    LaneFlags,
    Lanes,
    Minimum,
    Reason,
    moves_without,
    search,
    whiten,
)

LEAST_DEGREES_OF_FREEDOM = 2
"""Degrees of freedom below which forms are not compared: the correction of AIC for small samples, 2k(k + 1)/(n - k - 1)
for k = 2 coefficients, is finite from n = 4 lanes on."""

USES = ("no-lane", "fitted", "censored", "left-out", "above-founder")
"""Flags of the variable `data_use`."""

_LEAST_SLOPE = 1e-10
"""Slope theta_1 of rate/greatest rate below which there is no onset, since the slope is a rounding error."""

_LEAST_SLOPE_IN_ERRORS = 2.0
"""Slope theta_1 in standard errors below which there is no onset: its Fieller confidence interval is unbounded."""

_EPSILON = float(np.finfo(float).eps)
_SAME = 1e-6  # relative difference of thresholds of a group that are one
_KEPT = (
    *("scene", "sweep", "parameters", "columns"),
    *("dialect", "dropped", "rows_read", "notes", "reference_force"),
)
"""Attributes of the data that a fit keeps."""

_SCHEMA = {
    "C": Variable("m s-1", "coefficient of the rate-of-penetration law"),
    "C_stderr": Variable("m s-1", "standard error of C"),
    "eta0": Variable("1", "relief at the onset"),
    "eta0_stderr": Variable("1", "standard error of eta0"),
    "exponent": Variable("1", "exponent of the relief"),
    "exponent_stderr": Variable("1", "standard error of the exponent"),
    "r_squared": Variable("1", "share of the rate's variance that the form explains"),
    "aic": Variable("1", "n ln(RSS/n) + 2k, RSS in m2 s-2"),
    "cv_error": Variable("m s-1", "error of rates predicted from the other blocks of rows of a log"),
    "evidence_against": Variable(
        "1", "n ln(e/least e), e the error of predicted rates, or by AIC; rejected above 5.4, of a sweep above 2"
    ),
    "degrees_of_freedom": Variable("1", "lanes with a residual less coefficients", np.int32),
    "used": Variable("1", "lanes that the fit used, those at zero rate among them", np.int32),
    "left_out": Variable("1", "lanes left out: failed, irregular, wrong, or above the founder weight", np.int32),
    "reason": Variable("1", "why a coefficient is not a number", np.int8, REASONS),
    "r_squared_reason": Variable("1", "why r_squared is not a number", np.int8, REASONS),
    "standing": Variable("1", "result of the comparison of the forms", np.int8, STANDINGS),
}
_GROUP_SCHEMA = {
    "founder_weight": Variable("N", "mean force above which the rate does not rise"),
    "founder_weight_stderr": Variable("N", "standard error of the founder weight"),
    "founder_fall": Variable("m s-1 N-1", "fall of the rate per mean force above the founder weight"),
    "founder_fall_stderr": Variable("m s-1 N-1", "standard error of the fall"),
    "noise_correlation": Variable("1", "correlation of the noise of neighbouring rows"),
    "data_threshold": Variable("N", "mean force at a relief of 1"),
}
_DATA_SCHEMA = {
    "data_relief": Variable("1", "relief of the lanes that were fitted"),
    "data_rate_of_penetration": Variable("m s-1", "rate of penetration of the lanes that were fitted"),
    "data_use": Variable("1", "what became of a lane", np.int8, USES),
}


def fit_rop(
    data: Data,
    along: str | None = None,
    by: str | Sequence[str] = (),
    robust: str | None = None,
    progress: bool = True,
    columns: Columns = None,
    where: Where = None,
    nulls: Nulls = None,
) -> xr.Dataset:
    """Fit the rate-of-penetration law (source, eq. 6.4) in three readings, and three rivals, to each group of lanes.

    A lane at zero rate is censored: it contributes only if a form predicts a positive rate. Lanes that failed, are
    irregular or have no usable values are left out and counted. Standard errors follow from the Jacobian and the
    residual of each lane (HC3). They are therefore valid for noise of constant size as well as for noise proportional
    to the rate.

    Rows of a rig log differ from lanes of a sweep:

    - The loss of a residual is robust. From 30 rows on, rows are left out and listed (attribute `left_out_rows`) if
      their rate is far from the law and from all rates at that weight, or if their weight is far from all others.
    - The law ends at the founder weight, if the data show one: above it the rate stays or falls. The data show one if
      a form with a founder weight describes them better than every form without, beyond chance. All forms are then
      fitted to the rows below it.
    - The noise of neighbouring rows is correlated. From 50 rows on, a fit subtracts from each row what the preceding
      one predicts of its noise. Leaving out blocks of rows gives the standard errors, and the forms are compared by
      the rates of each block, predicted from all other blocks (`cv_error`).

    **Arguments:**

    - `data`: dataset with rate_of_penetration [m/s], relief [1] and optionally regime, or the path of such a dataset
      (.nc) or of a rig log (see `read_log`), or a DataFrame with the columns of such a log.
    - `along`: axis along which the lanes of a group vary, by default frequency, v or point. Each combination of values
      on the other axes is a group.
    - `by`: columns of a table (a CSV, or a sweep of points) whose values distinguish the groups. If `along` is a
      column, the default is all columns except `along` and mean_force.
    - `robust`: the loss, "soft-l1", "huber" or "squares", scaled by the median absolute deviation; by default soft-l1
      for rows of a log and squares for a sweep. R² and AIC are computed from the plain residuals.
    - `progress`: whether to report on stderr when the fit is done.
    - `columns`: by quantity, the column of a CSV and its unit, such as {"rate_of_penetration": "ROP (m/h)",
      "mean_force": "WOB (kN)"}, or a constant value for all rows, such as {"threshold": "150 kN"}.
      {"rock": "granite"} takes the threshold of that rock. {"threshold": "unknown"} is the default of logs: eta is then
      the force over its median (attribute `reference_force` [N]), and `onset_force` [N] is the force at the onset.
    - `where`, `nulls`: of a rig log, as in `read_log`.

    **Returns:** a dataset over the groups and `form`: C [m/s], eta0 [1] and exponent [1], each with its standard error;
    r_squared, aic, degrees_of_freedom, used, left_out, `standing` and `reason`. A coefficient is NaN if the form does
    not have it or the lanes do not identify it. Over the groups: `founder_weight` [N] with its standard error, NaN if
    there is none, and `founder_fall` [m/s/N], the fall above it. The attribute `verdict` is the form that the data of
    all groups support, or "none". The dataset also contains the data, over the groups and `lane`: data_relief [1],
    data_rate_of_penetration [m/s], and `data_use`.

    **Raises:** `InputError`.

    **Example:**

    >>> axes = {"force": [400e3, 500e3], "frequency": [10.0, 20.0, 30.0, 40.0]}
    >>> rates = vj.run_sweep({"scene": "penetration", "parameters": {"rock": "granite"}, "grid": axes}, progress=False)
    >>> fit = vj.fit_rop(rates, along="frequency", progress=False)
    >>> fit.exponent.sel(form="power").round(3).values.tolist()  # along frequency the rate is in proportion to P/D
    [1.0, 1.0]
    """
    place, data, groups = read_groups(data, along, by, columns, where=where, nulls=nulls)
    if robust is not None:
        choice(place.at("robust"), robust, LOSSES)
    return fit_groups(place, data, groups, robust, progress)


def read_groups(
    data: Data, along: str | None, by: str | Sequence[str], columns: Columns, **reading: Any
) -> tuple[Place, xr.Dataset, xr.Dataset]:
    """Return the data of a fit and their groups, and the `Place` for messages; the arguments are those of `fit_rop`.

    **Raises:** `InputError`.
    """
    place, data = open_data(data, columns, **reading)
    return place, data, group_lanes(place, usable_lanes(data), along, (by,) if isinstance(by, str) else tuple(by))


class _GroupFit(NamedTuple):
    """Fit of a group: values by form, the founder, and masks of the lanes that were left out, by reason."""

    forms: list[dict[str, float | int]]
    founder: Founder
    left_out: Mapping[str, LaneFlags]
    above: LaneFlags


NO_VALUES = "without values, or with a negative rate"


def fit_groups(
    place: Place, data: xr.Dataset, groups: xr.Dataset, robust: str | None = None, progress: bool = False
) -> xr.Dataset:
    """Fit every form to every group; return the dataset that `fit_rop` describes."""
    along, dims = groups.attrs["along"], groups["rate"].dims[:-1]
    sizes, counts = [groups.sizes[dim] for dim in dims], groups["is_lane"].sum("lane").values.ravel()
    measured, unknown = is_measured(data), "reference_force" in data.attrs
    has_force = measured and FORCE in data.coords
    loss = robust or ("soft-l1" if measured else "squares")
    LOG.info("chosen: along %s, %d groups, loss %s", along, counts.size, loss)
    start = time.monotonic()
    flat = {name: groups[name].values.reshape(counts.size, -1) for name in LANE_VARIABLES}
    valid, is_lane = flat["valid"], flat["is_lane"]
    use = np.select([~is_lane, valid & (flat["rate"] > 0), valid], [0, 1, 2], USES.index("left-out"))
    fits: list[_GroupFit] = []
    left_out: defaultdict[str, list[int]] = defaultdict(list)
    for group in range(counts.size):
        rows, line = np.flatnonzero(valid[group]), flat["number"][group].astype(int)
        relief, weight, rate = (flat[name][group, rows] for name in ("relief", "weight", "rate"))
        fits.append(fit_lanes(relief, weight, rate, loss, measured, unknown, has_force))
        for reason, mask in fits[-1].left_out.items():
            use[group, rows[mask]] = USES.index("left-out")
            left_out[reason] += line[rows[mask]].tolist()
        left_out[NO_VALUES] += line[is_lane[group] & ~valid[group] & measured].tolist()
        use[group, rows[fits[-1].above]] = USES.index("above-founder")
    if progress:
        fitted = f"{counted(counts.size, 'group')} of {counted(counts.max(), 'lane')} along {along} fitted"
        print("\n".join([*log_lines(data), f"{fitted} in {time.monotonic() - start:.1f} s"]), file=sys.stderr)
    values = {name: np.array([[form[name] for form in fit.forms] for fit in fits]) for name in fits[0].forms[0]}
    values["left_out"] = counts[:, None] - values["used"]
    ratio = np.where(valid, flat["weight"], np.nan) / np.where(valid, flat["relief"], 1.0)
    with warnings.catch_warnings(action="ignore"):  # groups without valid lanes
        is_one = np.nanmax(ratio, 1) - np.nanmin(ratio, 1) <= _SAME * np.nanmax(ratio, 1)
        threshold = np.where(is_one & has_force, np.nanmedian(ratio, 1), np.nan)
    of_groups = dict(zip(_GROUP_SCHEMA, [*zip(*(fit.founder for fit in fits), strict=True), threshold], strict=True))
    of_lanes = *(np.where(is_lane, flat[name], np.nan) for name in ("relief", "rate")), use
    variables: dict[str, Any] = {name: ((*dims, "form"), np.reshape(x, (*sizes, -1))) for name, x in values.items()}
    variables |= {name: (dims, np.array(x).reshape(sizes)) for name, x in of_groups.items()}
    variables |= {
        name: ((*dims, "lane"), x.reshape(*sizes, -1)) for name, x in zip(_DATA_SCHEMA, of_lanes, strict=True)
    }
    names = [form.name for form in FORMS]
    form = ("form", names, {"units": "1", "long_name": "form of the law"})
    attributes = dataset_attributes(
        "fit",
        f"rate-of-penetration law: {title_of(data, place.file)}",
        "\n".join(filter(None, (f"fit {place.file}", str(data.attrs.get("history", ""))))),
        **{name: data.attrs[name] for name in _KEPT if name in data.attrs},
        along=along,
        formulas="; ".join(f"{form.name}: {form.formula}" for form in FORMS),
        verdict=supported(
            values["standing"], values["evidence_against"], names, BLOCK_LIMIT if measured else AIC_LIMIT
        ),
        robust=loss,
    )
    if lines := {reason: np.unique(lines) for reason, lines in left_out.items() if lines}:
        about = {reason: {"rows": x.size, "lines": line_ranges(x)} for reason, x in lines.items()}
        attributes["left_out_rows"] = json.dumps(about)
    schema = _SCHEMA | _GROUP_SCHEMA | _DATA_SCHEMA
    fit = xr.Dataset(described(variables, schema), {**groups.coords, "form": form}, attributes)
    for name, text in (("", ""), ("_stderr", "standard error of ")) if unknown else ():
        onset = {"units": "N", "long_name": f"{text}the force at the onset, eta0 D"}
        fit[f"onset_force{name}"] = (data.attrs["reference_force"] * fit[f"eta0{name}"]).assign_attrs(onset)
    return fit


def fit_lanes(
    relief: Lanes, weight: Lanes, rate: Lanes, loss: str, measured: bool, unknown: bool, has_force: bool = True
) -> _GroupFit:
    """Fit every form to the lanes of a group.

    `measured`: whether they are rows of a log, in order of depth; `unknown`: whether the threshold is unknown;
    `has_force`: whether `weight` is the mean force, without which no founder weight is sought.
    """
    above, founder, left_out = np.zeros(rate.size, bool), Founder(), {}
    if measured and rate.size >= LEAST_CLEANED and (rate > 0).any():
        left_out = wrong_rows(relief, weight, rate, loss)
    keep = ~np.any([above, *left_out.values()], axis=0)
    if left_out and has_force:
        founder = find_founder(relief[keep], weight[keep], rate[keep], np.flatnonzero(keep))
        above = keep & (weight > founder.end)  # none, if that is NaN
    fitted = keep & ~above
    row = np.flatnonzero(fitted) if measured else None
    return _GroupFit(_fit_forms(relief[fitted], rate[fitted], loss, unknown, row), founder, left_out, above)


def _fit_forms(
    relief: Lanes, rate: Lanes, loss: str, unknown: bool, row: LaneBlocks | None
) -> list[dict[str, float | int]]:
    """Return the values of `_SCHEMA` of every form, and compare the forms; `row`: the number of each row of a log."""
    forms = {k: form for k, form in enumerate(FORMS) if not (unknown and form.name in SAME_AS_ONSET)}

    found = {k: search(form, relief, rate, loss) for k, form in forms.items()}
    minima, rho, block = {k: x for k, x in found.items() if isinstance(x, Minimum)}, 0.0, None
    if row is not None and minima:
        rho = correlation(min((minimum.residual for minimum in minima.values()), key=np.linalg.norm), row)
        if rate.size >= LEAST_ROWS and np.ptp(relief) > 0:
            block, decay = blocks_of(rate.size), decay_of(rho, row)
            found = {k: search(form, relief, rate, loss, decay) for k, form in forms.items()}
            minima = {k: x for k, x in found.items() if isinstance(x, Minimum)}
    fits: list[dict[str, float | int]] = []
    for k in range(len(FORMS)):
        fit: dict[str, float | int] = {name: np.nan for name, about in _SCHEMA.items() if about.dtype is np.float64}
        fit |= {"degrees_of_freedom": 0, "used": rate.size, "standing": 0}
        if k in minima:
            fit |= _coefficients(minima[k], rate, block)
        else:
            failed = found.get(k)
            reason = failed if isinstance(failed, Reason) else Reason.UNKNOWN_THRESHOLD
            fit |= {"reason": reason, "r_squared_reason": reason}
        fits.append(fit)
    if block is not None:
        evidence, limit = np.full(len(FORMS), np.nan), BLOCK_LIMIT
        for k, minimum in minima.items():
            residual = predictions_without(minimum, rate / rate.max(), block)
            fits[k]["cv_error"] = float(rate.max() * np.sqrt(np.mean(residual**2)))
            evidence[k] = rate.size * np.log(max(np.mean(whiten(residual, decay) ** 2), _EPSILON**2))
    else:
        least = min((fits[k]["degrees_of_freedom"] for k in minima), default=0)
        if len(minima) < len(forms) or least < LEAST_DEGREES_OF_FREEDOM:
            return fits
        size = np.array([2 * form.size for form in FORMS])
        exact = rate.size * 2 * np.log(LEAST_SPREAD * rate.max())  # below it, forms are equally exact
        independent = (1 - rho) / (1 + rho)  # correlated rows count as fewer independent ones
        evidence = independent * np.maximum([fit["aic"] for fit in fits] - size, exact) + size
        limit = AIC_LIMIT if row is None else BLOCK_LIMIT
    standing = standings(evidence, [form.name for form in FORMS], limit)
    for fit, value, against in zip(fits, standing.tolist(), (evidence - np.nanmin(evidence)).tolist(), strict=True):
        fit |= {"standing": value, "evidence_against": against}
    return fits


def _coefficients(minimum: Minimum, rate: Lanes, block: LaneBlocks | None) -> dict[str, float | int]:
    """Return the coefficients of a form with standard errors, R², AIC, and degrees of freedom.

    R² is NaN if the rates do not vary. RSS/n has a lower bound, the squared rounding error of the greatest rate, so
    that the AIC of exact data is finite.
    """
    unit = float(rate.max())
    if block is None:
        moves = moves_without(minimum, np.arange(rate.size))
        square = moves.T @ moves
    else:
        square = block_covariance(minimum, block)
    values, slopes = minimum.model.coefficients(minimum.theta)
    errors = np.sqrt(np.einsum("ci,ij,cj->c", slopes, square, slopes))
    fit: dict[str, float | int] = {"reason": Reason.IDENTIFIED}
    if minimum.model.form.size == 2 and minimum.model.form.name != "power":
        # A horizontal line has C close to zero, and no onset.
        least = max(_LEAST_SLOPE, _LEAST_SLOPE_IN_ERRORS * float(np.sqrt(square[1, 1])))
        if abs(minimum.theta[1]) <= least or not np.isfinite(values[1]):
            values[1], fit["reason"] = np.nan, Reason.NO_SLOPE
    errors[np.isnan(values)] = np.nan
    for name, scale, value, error in zip(("C", "eta0", "exponent"), (unit, 1.0, 1.0), values, errors, strict=True):
        fit[name], fit[f"{name}_stderr"] = scale * value, scale * error
    y, size = rate / unit, minimum.theta.size
    squares, about_mean = float(np.sum(minimum.residual**2)), float(np.sum((y - y.mean()) ** 2))
    varies = about_mean > rate.size * LEAST_SPREAD**2
    fit["r_squared"] = 1 - squares / about_mean if varies else np.nan
    fit["r_squared_reason"] = Reason.IDENTIFIED if varies else Reason.CONSTANT_RATES
    fit["aic"] = rate.size * (np.log(max(squares / rate.size, _EPSILON**2)) + 2 * np.log(unit)) + 2 * size
    return fit | {"degrees_of_freedom": int(minimum.active.sum()) - size}
