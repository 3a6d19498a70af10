"""Fits of every form of the rate-of-penetration law to every group of lanes of a sweep, or of rows of a rig log.

A *lane* is one pair of relief and rate of penetration: a lane of a sweep, or a row of a log. Lanes of a *group* have a
law of their own.
"""

import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pandas as pd
import xarray as xr

from vibrojax.errors import InputError, Place, counted, nearest, shell_assignment, shown, suggestion
from vibrojax.io import log_columns as known
from vibrojax.io.attributes import title_of
from vibrojax.io.kinds import dataset_attributes
from vibrojax.io.log_columns import FORCE, KNOWN, LINE, RATE, RELIEF, THRESHOLD, WEIGHT
from vibrojax.io.riglog import Nulls, Where, log_lines, read_log, to_dataset
from vibrojax.io.tables import line_ranges
from vibrojax.io.variables import Variable, described
from vibrojax.measures.labels import FAILED, IRREGULAR
from vibrojax.physics.meanings import suggest_coordinate
from vibrojax.physics.units import UNITS, factor, stated_scale, stated_unit
from vibrojax.progress import LOG
from vibrojax.settings.values import choice, warn_if_far
from vibrojax.studies.rop_forms import AIC_LIMIT, BLOCK_LIMIT, FORMULAS, REASONS, STANDINGS, supported
from vibrojax.studies.rop_group import NAMES, Founder, fit_lanes

if TYPE_CHECKING:
    Data: TypeAlias = xr.Dataset | str | PathLike[str] | pd.DataFrame
    Columns = Mapping[str, str] | None
else:
    Data = Columns = object  # at run time the user's argument is checked, with a one-line error message

LOG_ENDINGS = (".csv", ".txt", ".tsv", ".las", ".xml", ".xlsx", ".xlsm", ".xls")
"""Endings of the files that a fit takes for logs."""

DEFAULT_AXES = ("frequency", "v", "point")
"""Default axes to fit along; the first of them that exists in the data is used."""

LOSSES = ("soft-l1", "squares")
"""Losses of a residual: SciPy's "soft_l1", scaled by the median absolute deviation, or its square."""

USES = ("no-lane", "fitted", "censored", "left-out", "above-founder")  # flags of the variable `data_use`

NO_VALUES = "without values, or with a negative rate"
_FOR_LAW = frozenset((*known.LAW, WEIGHT, known.ROTATION_SPEED))  # faults in other columns do not stop a fit
_SAME = 1e-6  # relative difference of thresholds of a group that are one
_LISTED = 8  # variables of a dataset that a message lists
_KEPT = ("scene", "sweep", "parameters", "columns", "dialect", "dropped", "rows_read", "notes", "reference_force")
"""Attributes of the data that a fit keeps."""

_FORM, _LANE, _GROUP = "form", "lane", "group"
SCHEMA = {
    "C": Variable("m s-1", "coefficient of the rate-of-penetration law", along=_FORM),
    "eta0": Variable("1", "relief (mean force divided by D) at which penetration begins", along=_FORM),
    "exponent": Variable("1", "exponent of the relief", along=_FORM),
    "r_squared": Variable("1", "share of the rate's variance that the form explains", along=_FORM),
    "aic": Variable("1", "Akaike criterion n ln(RSS/n) + 2k of n lanes and k coefficients, RSS in m2 s-2", along=_FORM),
    "cv_error": Variable(
        *("m s-1", "root mean square error of the predictions of each block of rows by a fit to all other blocks"),
        along=_FORM,
    ),
    "evidence_against": Variable(
        "1",
        "AIC minus the least AIC; a difference above 2 rejects the form (rig log: 5.4, with AIC = 2 n ln(cv_error))",
        along=_FORM,
    ),
    "degrees_of_freedom": Variable("1", "number of residuals minus number of coefficients", np.int32, along=_FORM),
    "used": Variable("1", "number of lanes that the fit used, including those at zero rate", np.int32, along=_FORM),
    "left_out": Variable(
        *("1", "number of lanes that are left out: failed, irregular, outlying, or above the founder weight", np.int32),
        along=_FORM,
    ),
    "reason": Variable("1", "reason why a coefficient is NaN", np.int8, REASONS, along=_FORM),
    "r_squared_reason": Variable("1", "reason why r_squared is NaN", np.int8, REASONS, along=_FORM),
    "standing": Variable("1", "result of the comparison of the forms", np.int8, STANDINGS, along=_FORM),
    "onset_force": Variable("N", "mean force at which penetration begins, eta0 D", along=_FORM),
    "founder_weight": Variable("N", "mean force above which the rate of penetration does not rise"),
    "founder_fall": Variable(
        "m s-1 N-1", "decrease of the rate of penetration per unit of mean force above the founder weight"
    ),
    "noise_correlation": Variable("1", "correlation of the noise of neighbouring rows"),
    "data_threshold": Variable("N", "mean force at which the relief is 1: D, or reference_force if D is unknown"),
    "data_relief": Variable("1", "relief of the lanes that were fitted", along=_LANE),
    "data_rate_of_penetration": Variable("m s-1", "rate of penetration of the lanes that were fitted", along=_LANE),
    "data_use": Variable("1", "treatment of the lane by the fit", np.int8, USES, along=_LANE),
}
"""Variables of a fit over its groups, and `along` its forms or lanes. `onset_force` needs an unknown threshold."""

SCHEMA |= {
    f"{name}_stderr": replace(SCHEMA[name], long_name=f"standard error of {name}")
    for name in ("C", "eta0", "exponent", "onset_force", "founder_weight", "founder_fall")
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
    """Fit six forms of the rate-of-penetration law to groups of lanes.

    A *form* is a formula for the rate of penetration as a function of the relief. Three forms are interpretations of
    eq. 6.4 of Batako's thesis. A lane with zero rate of penetration is censored: it contributes to the residuals only
    if the form predicts a positive rate. Lanes that failed, are irregular or have no usable values are left out and
    counted. Standard errors (HC3) are valid for noise of constant size and for noise proportional to the rate.

    A rig log is fitted with a robust loss. If the log shows a founder weight, above which the rate of penetration does
    not rise, the forms are fitted to the rows below this weight. In logs of 30 rows or more, standard errors come from
    a jackknife over blocks of rows; in logs of 50 rows or more, the forms are compared by their cross-validation errors
    `cv_error`.

    **Arguments:**

    - `data`: a dataset with rate_of_penetration [m/s], relief [1] and optionally regime; the path of such a dataset
      (.nc); the path of a rig log (see `read_log`); or a DataFrame with the columns of a rig log.
    - `along`: axis along which the lanes of a group vary, by default frequency, else v, else point, else the only axis
      of the data. Lanes with equal values on all other axes form a group.
    - `by`: columns of a table (a CSV, or a sweep of points); rows with equal values in these columns form a group. If
      `along` names a column, `by` defaults to all other columns except mean_force.
    - `robust`: the loss function, "squares" (default for a sweep) or "soft-l1", scaled by the median absolute deviation
      (default for a log).
    - `columns`: by quantity, the column of a CSV and its unit, such as {"rate_of_penetration": "ROP (m/h)",
      "mean_force": "WOB (kN)"}, or a constant value for all rows, such as {"threshold": "150 kN"}.
      {"rock": "granite"} takes the threshold of that rock. {"threshold": "unknown"} is the default of logs: the median
      force (attribute `reference_force` [N]) then replaces the threshold in the relief, and `onset_force` [N] is the
      force at the onset of penetration.
    - `where`, `nulls`: as in `read_log`, for a rig log only.

    **Returns:** a dataset with the dimensions `form` and `lane`, and the dimensions of the groups. The main variables
    of a fit are the coefficients C [m/s], eta0 [1] and exponent [1] with standard errors, and `standing`, the result of
    the comparison of the forms. A coefficient is NaN if the form lacks it or the lanes do not identify it. The
    attribute `verdict` is the form that the data of all groups support, or "none".

    **Raises:** `InputError` if the data cannot be read or hold nothing to fit.

    **Example:**

    >>> axes = {"force": [400e3, 500e3], "frequency": [10.0, 20.0, 30.0, 40.0]}
    >>> rates = vj.run_sweep({"scene": "penetration", "parameters": {"rock": "granite"}, "grid": axes}, progress=False)
    >>> fit = vj.fit_rop(rates, along="frequency", progress=False)
    >>> fit.exponent.sel(form="power").round(3).values.tolist()  # along frequency the rate is in proportion to P/D
    [1.0, 1.0]
    """
    place, data = _read(data, columns, where, nulls)
    measured, unknown = "dialect" in data.attrs, "reference_force" in data.attrs
    loss = choice(place.at("robust"), robust or ("soft-l1" if measured else "squares"), LOSSES)
    by = (by,) if isinstance(by, str) else tuple(by)
    lanes, along, sizes, coordinates = _grouped(place, _lanes(place, data), along, by)
    counts, has_force = np.bincount(lanes[_GROUP]), measured and FORCE in data.coords
    LOG.info("chosen: along %s, %d groups, loss %s", along, counts.size, loss)
    start = time.monotonic()
    valid, threshold = lanes["valid"], np.full(counts.size, np.nan)
    use = np.select([valid & (lanes["rate"] > 0), valid], [1, 2], USES.index("left-out"))
    left_out, fits, rows_of = {NO_VALUES: ~valid}, [], lanes.index[valid].groupby(lanes[_GROUP][valid])
    for group in range(counts.size):
        rows = np.array(rows_of.get(group, ()), int)
        relief, weight, rate = lanes.loc[rows, ["relief", "weight", "rate"]].to_numpy().T
        if has_force and rows.size and np.ptp(weight / relief) <= _SAME * (weight / relief).max():
            threshold[group] = np.median(weight / relief)
        fits.append(fit_lanes(relief, weight, rate, loss != "squares", measured, unknown, has_force))
        for reason, mask in fits[-1].wrong.items():
            left_out.setdefault(reason, np.zeros_like(valid))[rows[mask]] = True
            use[rows[mask]] = USES.index("left-out")
        use[rows[fits[-1].above]] = USES.index("above-founder")
    if progress:
        fitted = f"{counted(counts.size, 'group')} of {counted(counts.max(), 'lane')} along {along} fitted"
        print("\n".join([*log_lines(data), f"{fitted} in {time.monotonic() - start:.1f} s"]), file=sys.stderr)
    values: dict[str, Any] = {name: np.array([fit.forms[name] for fit in fits]) for name in fits[0].forms}
    values["left_out"] = counts[:, None] - values["used"]
    for name in ("", "_stderr") if unknown else ():
        values[f"onset_force{name}"] = data.attrs["reference_force"] * values[f"eta0{name}"]
    of_founder = [*(f"founder_{name}" for name in Founder._fields[:4]), "noise_correlation"]
    values |= zip(of_founder, np.array([fit.founder for fit in fits]).T, strict=True)
    values["data_threshold"] = threshold
    for name, column in ((f"data_{RELIEF}", lanes["relief"]), (f"data_{RATE}", lanes["rate"]), ("data_use", use)):
        values[name] = np.full((counts.size, counts.max()), 0 if column is use else np.nan)
        values[name][lanes[_GROUP], lanes[_LANE]] = column
    limit = BLOCK_LIMIT if measured else AIC_LIMIT
    about = {name: data.attrs[name] for name in _KEPT if name in data.attrs} | {"along": along, "robust": loss}
    about["formulas"] = "; ".join(f"{name}: {formula}" for name, formula in FORMULAS.items())
    about["verdict"] = supported(values["standing"], values["evidence_against"], NAMES, limit)
    numbers = {reason: np.unique(lanes["number"][mask].astype(int)) for reason, mask in left_out.items() if mask.any()}
    if measured and numbers:
        rows_left_out = {reason: {"rows": x.size, "lines": line_ranges(x)} for reason, x in numbers.items()}
        about["left_out_rows"] = json.dumps(rows_left_out)
    variables = {}
    for name, x in values.items():
        further = [SCHEMA[name].along] if SCHEMA[name].along else []
        variables[name] = (*sizes, *further), np.reshape(x, [*sizes.values(), *x.shape[1:]])
    form = (_FORM, NAMES, {"units": "1", "long_name": "form of the law"})
    command = "\n".join(filter(None, (f"fit {place.file}", str(data.attrs.get("history", "")))))
    about = dataset_attributes("fit", f"Rate-of-penetration law: {title_of(data, place.file)}", command, **about)
    return xr.Dataset(described(variables, SCHEMA), {**coordinates, _FORM: form}, about)


# Data


def _read(data: Data, columns: Columns, where: Where, nulls: Nulls) -> tuple[Place, xr.Dataset]:
    """Return the name of the data in messages, and a dataset with rate_of_penetration [m/s] and relief [1]."""
    if not isinstance(data, (xr.Dataset, pd.DataFrame, str, PathLike)):
        raise InputError(f"fit_rop: {shown(data)} is not data; give a dataset or a path")
    is_path = isinstance(data, (str, PathLike))
    place, suffix = Place(str(data) if is_path else "fit_rop"), Path(data).suffix.lower() if is_path else ""
    if isinstance(data, pd.DataFrame) or suffix in LOG_ENDINGS:
        return place, _read_rows(place, Path(data) if is_path else data, columns, where, nulls)
    if is_path and suffix != ".nc":
        fault = "ends in neither .nc nor .csv nor .las"
        raise place.error(f"{fault}; give a sweep's dataset or a rig log (also .txt, .xml, .xlsx)")
    if columns:
        raise place.error("has its names and units already; `columns` is for a CSV")
    if where or nulls:
        fault = f"`{'where' if where else 'nulls'}` is for a rig log"
        raise place.error(f"{fault}; select lanes of a dataset by its method sel")
    from vibrojax.io.dataset import open_dataset  # a log needs no netCDF

    return place, data if isinstance(data, xr.Dataset) else open_dataset(Path(str(data)))


def _read_rows(place: Place, source: Path | pd.DataFrame, columns: Columns, where: Where, nulls: Nulls) -> xr.Dataset:
    """Read a rig log into a dataset along `point`, the rows.

    Without a relief, it is mean_force/threshold; a weight on bit is a mean force. If the threshold is "unknown", or not
    given with a log of a rig, the relief is mean_force over its median, the attribute `reference_force` [N].
    """
    columns = known.checked_columns(columns)
    if is_unknown := columns.get(THRESHOLD, "").strip() == "unknown":
        del columns[THRESHOLD]
    log = read_log(source, columns, where, nulls, _FOR_LAW)
    for header, name, median, likely in log.attrs["unusual"]:
        warn_if_far(place.at(f"column {header}"), KNOWN[name], median, likely)
    if FORCE not in log and WEIGHT in log:
        log = log.rename(columns={WEIGHT: FORCE})
        for about in (log.attrs["units"], log.attrs["sources"]):
            about[FORCE] = about.pop(WEIGHT)
    is_given = bool({THRESHOLD, RELIEF} & set(log.attrs["units"]))
    if is_unknown and is_given:
        raise Place("columns", THRESHOLD).error(f"is unknown, but {place.file} has a threshold or relief; give one")
    is_unknown |= log.attrs["rig"] and not is_given
    by_force = RELIEF not in log or (RELIEF not in columns and bool({FORCE, THRESHOLD} & set(columns)))
    needed = (RATE, FORCE, *([] if is_unknown else [THRESHOLD])) if by_force else (RATE, RELIEF)
    if missing := [name for name in needed if name not in log]:
        name, free = missing[0], [str(name) for name in log if name not in (*log.attrs["units"], LINE)]
        likely = [cell for cell in free if factor(known.split_unit(cell)[1] or "1", KNOWN[name].unit) is not None]
        hint = f"of other columns, the file has {', '.join(free)}" if free else "name its column with --columns"
        if like := likely[0] if likely else nearest(name, free):
            hint = f"if {shown(like)} is it, name it with its unit: --columns {shell_assignment(name, like)}"
        if missing == [THRESHOLD]:
            hint += f', or for all rows: --columns {THRESHOLD}="150 kN", rock=granite or {THRESHOLD}=unknown'
        names = " and ".join(f"{name} [{UNITS[KNOWN[name].unit][0]}]" for name in missing)
        raise place.error(f"column {names} is missing{'' if RATE in missing else f', or {RELIEF}'}; {hint}")
    data = to_dataset(log, "point")
    if by_force:
        reference = float(np.nanmedian(data[FORCE])) or 1.0
        with np.errstate(divide="ignore", invalid="ignore"):
            data[RELIEF] = data[FORCE] / (reference if is_unknown else data[THRESHOLD])
        data[RELIEF].attrs = {"units": KNOWN[RELIEF].unit, "long_name": KNOWN[RELIEF].long_name}
        data.attrs |= {"reference_force": reference} if is_unknown else {}
    number = ("point", np.arange(data.sizes["point"]), {"units": "1", "long_name": "number of the row"})
    return data.assign_coords(point=number).set_coords([str(name) for name in data if name not in (RATE, RELIEF)])


def _lanes(place: Place, data: xr.Dataset) -> xr.Dataset:
    """Return the lanes, broadcast, with their coordinates: `relief`, `rate`, `weight`, `number` and `valid`.

    `weight` is the mean force where it is known, else the relief; `number` is the line of a row. A lane is valid unless
    it failed or is irregular, a value is not finite, its relief is not positive, or its rate is negative.
    """
    for name in (RATE, RELIEF):
        if name not in data:
            held = list(map(str, data.data_vars))
            names = ", ".join(held[:_LISTED]) + ", ..." * (len(held) > _LISTED) or "nothing"
            raise place.at(name).error(f"missing; a sweep of a scene with rock has it, this holds {names}")
        if data[name].dtype.kind not in "fiu":
            raise place.at(name).error("does not hold numbers; the data of a sweep are needed")
    columns = {name: data[name] for name in (RELIEF, RATE, FORCE) if name in data}
    for name, x in columns.items():
        if (unit := stated_unit(x)) is not None:
            columns[name] = x * stated_scale(place.at(name).error, unit, KNOWN[name].unit)
    relief, rate = xr.broadcast(columns[RELIEF].astype(float), columns[RATE].astype(float))
    valid = (relief > 0) & (relief < np.inf) & (rate >= 0) & (rate < np.inf)
    if "regime" in data:
        valid = valid & ~data["regime"].isin([FAILED, IRREGULAR])
    if "status" in data:
        valid = valid & (data["status"] == 0)
    weight = columns[FORCE].astype(float) if "dialect" in data.attrs and FORCE in data.coords else relief
    number = data[LINE] if LINE in data.coords else xr.zeros_like(relief)
    parts = {"relief": relief, "rate": rate, "weight": weight, "number": number, "valid": valid}
    together = zip(parts, xr.broadcast(*parts.values()), strict=True)
    # Broadcasting adds the dimensions of the other variable, but not its non-index coordinates.
    return xr.Dataset({name: x.variable for name, x in together}, {**rate.coords, **relief.coords})


def _grouped(
    place: Place, lanes: xr.Dataset, along: str | None, by: Sequence[str]
) -> tuple[pd.DataFrame, str, dict[str, int], Mapping[Any, Any]]:
    """Return a row per lane with its `group` and its place there, the axis along, and sizes and coordinates of groups.

    A group is one combination of values on the axes other than `along`. Rows of a table (data with one dimension) are
    grouped by the columns `by`, or if `along` is a column, by all other columns except the mean force; those of a log
    from top to bottom.
    """
    dims = [str(dim) for dim in lanes["rate"].dims]
    if not dims:
        raise place.at("along").error("there is one lane only; a law needs an axis of several")
    for dim in dims:
        if not lanes.sizes[dim]:
            raise place.at(dim).error("has no values, so there are no lanes; give at least one")
    row = dims[0]
    columns = [str(name) for name, x in lanes.coords.items() if len(dims) == 1 and x.dims == (row,) != (name,)]
    if is_table := bool(by) or along in columns:
        for name in (*by, *({along} - {None, row})):
            if name not in columns:
                own = [column for column in columns if not lanes[column].attrs] or columns  # not the quantities
                hint = f"; {suggestion(str(name), own)}" if own else ": the data are not a table with columns"
                here = place.at("by" if name in by else "along")
                raise here.error(f"{shown(name)} is not a column of the data{hint}")
    along = along or next((name for name in DEFAULT_AXES if name in dims), row if len(dims) == 1 else None)
    if along is None:
        raise place.at("along").error(f"missing; choose the axis to fit along from {', '.join(dims)}")
    if not is_table and along not in dims:
        hint = suggest_coordinate(str(along), {dim: lanes[dim].attrs for dim in dims})
        raise place.at("along").error(f"{shown(along)} is not an axis of the data; {hint}")
    if not is_table:
        sizes = {dim: lanes.sizes[dim] for dim in dims if dim != along}
        table = pd.DataFrame({name: x.values.ravel() for name, x in lanes.transpose(*sizes, along).items()})
        table[_GROUP], table[_LANE] = np.divmod(np.arange(len(table)), lanes.sizes[along])
        return table, along, sizes, lanes.drop_dims(along).coords
    table = pd.DataFrame({name: x.values for name, x in lanes.items()})
    keys = list(by) or [name for name in columns if name not in (along, FORCE, LINE, *known.RIG)]
    of_keys = pd.DataFrame({name: lanes[name].values for name in keys}, index=table.index)
    grouped = of_keys.groupby(keys or np.zeros(len(table)), sort=known.DEPTH not in lanes.coords, dropna=False)
    table[_GROUP], table[_LANE] = grouped.ngroup(), grouped.cumcount()
    first = table[table[_LANE] == 0].sort_values(_GROUP).index
    coordinates = {name: xr.Variable(_GROUP, lanes[name].values[first], lanes[name].attrs) for name in keys}
    return table, along, {_GROUP: first.size}, coordinates
