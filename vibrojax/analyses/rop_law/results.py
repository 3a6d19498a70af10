"""Datasets of fits: variables with units, provenance, the summary as text or JSON, and the comparison of the forms."""

import math
from collections.abc import Hashable, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Shaped
from scipy.special import stdtrit

from vibrojax.analyses.rop_law.blocks import CONTAINED, Standing
from vibrojax.analyses.rop_law.least_squares import REASONS
from vibrojax.errors import Place, counted
from vibrojax.io.attributes import attribute_of, table_of, title_of
from vibrojax.io.kinds import dataset_attributes
from vibrojax.io.riglog.columns import RATE
from vibrojax.io.variables import Variable
from vibrojax.models.physics.units import factor

CLEAR_AIC_DIFFERENCE = 2.0
"""Difference in AIC above which another form describes the data better (Burnham and Anderson's rule of thumb)."""

LEAST_DEGREES_OF_FREEDOM = 2
"""Degrees of freedom below which forms are not compared: the correction of AIC for small samples, 2k(k + 1)/(n - k - 1)
for k = 2 coefficients, is finite from n = 4 lanes on."""

ONSET_STANDARD_ERRORS = 2.0
"""Number of standard errors by which an onset is below 1 before the verdict says so."""

_KEPT = (
    *("scene", "sweep", "parameters", "columns"),
    *("dialect", "detected", "dropped", "rows_read", "nulls", "notes", "reference_force"),
)
"""Attributes of the data that a fit keeps."""

_GROUPS_BEATEN_SHOWN = 5
_GROUPS_TABULATED = 12


def reason_variable(long_name: str) -> Variable:
    """Return the schema of a flag variable, with the meanings `REASONS`, that explains NaN in other variables."""
    return Variable("1", long_name, np.int8, REASONS)


GOODNESS_SCHEMA = {
    "r_squared": Variable("1", "share of the rate's variance that the law explains"),
    "aic": Variable("1", "n ln(RSS/n) + 2k, RSS in m2 s-2"),
    "degrees_of_freedom": Variable("1", "lanes with a residual less coefficients", np.int32),
    "used": Variable("1", "lanes that the fit used, those at zero rate among them", np.int32),
    "left_out": Variable("1", "lanes left out: failed, irregular, or without usable values", np.int32),
    "reason": reason_variable("why a coefficient is not a number"),
    "r_squared_reason": reason_variable("why r_squared is not a number"),
}
"""Schema of the variables that every fit of a rate-of-penetration law contains."""


LAW_TITLE = "rate-of-penetration law"
LOGARITHMIC = ("literal", "percent", "onset")
"""Names of the three readings of the source's law, eq. 6.4."""


def to_variables(
    schema: Mapping[str, Variable], values: Mapping[str, object], dims: Mapping[str, Sequence[Hashable]]
) -> dict[str, xr.Variable]:
    """Return xarray variables with the dtypes and attributes of `schema`; variables without `dims` are scalars."""
    return {
        name: xr.Variable(dims.get(name, ()), np.asarray(values[name], variable.dtype), variable.attributes())
        for name, variable in schema.items()
    }


def fit_dataset(
    place: Place,
    data: xr.Dataset,
    step: str,
    title: str,
    schema: Mapping[str, Variable],
    values: Mapping[str, object],
    dims: Mapping[str, Sequence[Hashable]],
    coordinates: Mapping[Any, Any],
    **more: str | float,
) -> xr.Dataset:
    """Return the dataset of a fit, with its provenance and the attributes of the data that remain valid.

    **Arguments:** `step`: name of the computation, for the attribute `history`; `title`: title, which is followed by
    that of the data; `schema`, `values`, `dims`: as in `to_variables`; `more`: further attributes.
    """
    own = dataset_attributes("fit", f"{title}: {title_of(data, place.file)}", f"{step} {place.file}")
    if "history" in data.attrs:
        own["history"] = f"{own['history']}\n{data.attrs['history']}"
    kept = {name: data.attrs[name] for name in _KEPT if name in data.attrs}
    return xr.Dataset(to_variables(schema, values, dims), coordinates, {**own, **kept, **more})


def law_facts(fit: xr.Dataset) -> dict[str, Any]:
    """Return the summary of a fitted rate-of-penetration law as a dictionary of JSON values.

    It contains the name and the coordinates of each group and, by form, the fitted values, with the meanings of flags.

    **Arguments:** `fit`: a dataset that `fit_rop` returned.
    """
    dims = [dim for dim in fit["aic"].dims if dim != "form"]
    values = {str(name): table(fit, str(name)) for name, v in fit.items() if set(v.dims) == {*dims, "form"}}
    for name in ("reason", "r_squared_reason", "standing"):
        values[name] = np.array(str(fit[name].attrs["flag_meanings"]).split())[values[name]]
    groups: list[dict[str, Any]] = []
    choices, names = recommended(fit), _group_names(fit)
    for index, position in enumerate(np.ndindex(*(fit.sizes[dim] for dim in dims))):
        lanes = fit.isel(dict(zip(dims, position, strict=True)))
        coordinates = {str(name): lanes[name].item() for name in lanes.coords if lanes[name].ndim == 0}
        forms = {
            str(form): {name: rows[index, column].item() for name, rows in values.items()}
            for column, form in enumerate(fit["form"].values)
        }
        group = {"name": names[index], "coordinates": coordinates, "forms": forms}
        groups.append({**group, "recommended": choices[index]})
    facts: dict[str, Any] = {"along": str(fit.attrs["along"]), "columns": table_of(fit, "columns") or None}
    if "dialect" in fit.attrs:
        facts |= {name: attribute_of(fit, name) for name in ("dialect", "detected", "rows_read", "dropped", "notes")}
    return {**facts, "groups": groups, "verdict": verdict(fit)}


def law_table(facts: Mapping[str, Any]) -> list[str]:
    """Return lines of text: a table of the forms for each of the first groups, then the number of other groups."""
    lines: list[str] = []
    for group in facts["groups"][:_GROUPS_TABULATED]:
        first = next(iter(group["forms"].values()))
        left_out = f", {first['left_out']} left out" if first["left_out"] else ""
        head = f"{group['name']}: {counted(first['used'], 'lane')} along {facts['along']}{left_out}"
        reasons = {str(values["reason"]) for values in group["forms"].values()}
        if len(reasons) == 1 and not any(math.isfinite(values["C"]) for values in group["forms"].values()):
            lines.append(f"{head}: {reasons.pop()}")
            continue
        lines += [""] * bool(lines) + [head]
        is_compared = any(values["standing"] == "chosen" for values in group["forms"].values())
        by_blocks = f"{'CV [m/s]':>11}" * is_compared
        lines.append(f"  {'form':<9}{'C [m/s]':<24}{'eta0':<22}{'exponent':<20}{'R2':>8}{'AIC':>10}{by_blocks}")
        lines += [f"  {form:<9}{_table_row(values)}".rstrip() for form, values in group["forms"].items()]
    further = len(facts["groups"]) - _GROUPS_TABULATED
    return lines + ([f"and {counted(further, 'group')} more"] if further > 0 else [])


def _table_row(values: Mapping[str, float | int | str]) -> str:
    """Return a table row: the coefficients with standard errors, R², AIC, and the reasons for missing values."""
    if not math.isfinite(float(values["C"])):
        return str(values["reason"])
    cells = [
        f"{values[name]:.4g} ± {values[f'{name}_stderr']:.2g}" if math.isfinite(float(values[name])) else ""
        for name in ("C", "eta0", "exponent")
    ]
    row = f"{cells[0]:<24}{cells[1]:<22}{cells[2]:<20}{values['r_squared']:>8.4f}{values['aic']:>10.2f}"
    row += f"{values['cv_error']:>11.4g}" if math.isfinite(float(values["cv_error"])) else ""
    reasons = [str(values[name]) for name in ("reason", "r_squared_reason") if values[name] != "identified"]
    reasons += [str(values["standing"])] * (values["standing"] in ("chosen", "undecided"))
    return f"{row}  {', '.join(reasons)}" if reasons else row


def table(fit: xr.Dataset, name: str) -> Shaped[np.ndarray, "groups forms"]:
    """Return a variable of a dataset that `fit_rop` returned as an array with one row per group."""
    dims = [dim for dim in fit[name].dims if dim != "form"]
    return np.asarray(fit[name].transpose(*dims, "form").values.reshape(-1, fit.sizes["form"]))


def recommended(fit: xr.Dataset) -> list[dict[str, Any] | None]:
    """Return the recommended C of each group.

    For a log whose forms were compared over blocks of rows, it is that of the chosen form. Otherwise it is that of the
    reading of the log law with the lowest AIC, if the log law holds.

    A dictionary holds `form`, `C` [m/s] and the ends `low` and `high` of its 95 % confidence interval [m/s], by
    Student's distribution. With rig data it also holds these three in the unit of the data's rate, as `in_unit`, and
    this `unit`. It is None if the log law does not hold, its C is not positive, or the lanes cannot
    decide it.
    """
    names = [str(name) for name in fit["form"].values]
    judged, above_best = _judged(fit)
    c, error, freedom, reason = (table(fit, name) for name in ("C", "C_stderr", "degrees_of_freedom", "reason"))
    forms: dict[int, int] = {}
    for row, group in zip(above_best, np.flatnonzero(judged).tolist(), strict=True):
        form = min((names.index(name) for name in LOGARITHMIC), key=lambda column: row[column])
        if row[form] <= CLEAR_AIC_DIFFERENCE:
            forms[group] = form
    forms |= {group: form for group, form in np.argwhere(_standing(fit) == Standing.CHOSEN).tolist()}
    unit = str(table_of(fit, "columns").get(RATE, {}).get("unit", "m/s"))
    scale = factor(unit, "m s-1") or 1.0
    choices: list[dict[str, Any] | None] = [None] * len(judged)
    for group, form in forms.items():
        if reason[group, form] or c[group, form] <= 0:
            continue
        half = float(stdtrit(freedom[group, form], 0.975) * error[group, form])
        values = {"C": float(c[group, form]), "low": float(c[group, form]) - half, "high": float(c[group, form]) + half}
        in_unit = {name: value / scale for name, value in values.items()}
        choices[group] = {"form": names[form], **values} | ({"unit": unit, "in_unit": in_unit} if scale != 1 else {})
    return choices


def _standing(fit: xr.Dataset) -> Shaped[np.ndarray, "groups forms"]:
    """Return the `Standing` of each form; all 0 in a fit that is older than it."""
    return table(fit, "standing") if "standing" in fit else np.zeros_like(table(fit, "reason"))


def _judged(fit: xr.Dataset) -> tuple[Bool[np.ndarray, " groups"], Float[np.ndarray, "judged forms"]]:
    """Return a mask of the groups with enough lanes to compare all forms, and there the AIC above the lowest one."""
    aic = table(fit, "aic")
    judged = np.isfinite(aic).all(axis=1) & (table(fit, "degrees_of_freedom") >= LEAST_DEGREES_OF_FREEDOM).all(axis=1)
    return judged, aic[judged] - aic[judged].min(axis=1, keepdims=True)


def verdict(fit: xr.Dataset) -> list[str]:
    """Return lines of text: which form describes the data best by AIC, and for which groups the log law holds.

    For a log whose forms were compared over blocks of rows, they say which form the data support, and from which others
    they cannot tell it. Otherwise, a form holds in a group if its AIC exceeds the lowest by at most
    `CLEAR_AIC_DIFFERENCE`. The log law holds if one of its three readings holds. Groups with fewer than four lanes with
    a rate cannot decide it. The last lines state the recommended C.

    **Arguments:** `fit`: a dataset that `fit_rop` returned.
    """
    names = [str(name) for name in fit["form"].values]
    aic, r_squared = table(fit, "aic"), table(fit, "r_squared")
    missing = ~np.isfinite(aic)
    judged, above_best = _judged(fit)
    is_short, lost = ~judged & ~missing.any(axis=1), missing.any(axis=1)
    lines = []
    if lost.any():  # count the reason of the first missing form in each group
        meanings = str(fit["reason"].attrs["flag_meanings"]).split()
        reasons = table(fit, "reason")[lost, np.argmax(missing[lost], axis=1)]
        counts = {meanings[flag]: int((reasons == flag).sum()) for flag in np.unique(reasons)}
        listed = ", ".join(f"{meaning} {count}" for meaning, count in sorted(counts.items()))
        lines.append(f"not every form can be told in {reasons.size} of {judged.size}: {listed}")
    if is_short.any():
        needed = f"at least {LEAST_DEGREES_OF_FREEDOM + 2} with a rate are needed"
        lines.append(f"too few lanes to compare the forms in {is_short.sum()} of {judged.size}; {needed}")
    if (_standing(fit) == Standing.CHOSEN).any():
        return [*(lines if is_short.any() else []), *_choices(fit), *_determined(fit), *_recommendation(fit)]
    if not judged.any():
        return [*lines, "no form can be told from the lanes that are there", *_determined(fit)]
    best = np.argmin(above_best, axis=1)
    lines.append(f"along {fit.attrs['along']}, over {judged.sum()} of {judged.size}:")
    holds = above_best <= CLEAR_AIC_DIFFERENCE
    rows = [(int((best == form).sum()), int(holds[:, form].sum()), form) for form in range(len(names))]
    for lowest, close, form in sorted(rows, reverse=True):
        share = _range(r_squared[judged, form])
        counts_of_form = f"lowest AIC in {lowest}, within {CLEAR_AIC_DIFFERENCE:g} of it in {close}"
        lines.append(f"  {names[form]:<8} {counts_of_form}; R2 {share}")
    readings = {name: holds[:, names.index(name)] for name in LOGARITHMIC}
    log_law = above_best[:, [names.index(name) for name in LOGARITHMIC]].min(axis=1)
    beaten = log_law > CLEAR_AIC_DIFFERENCE
    region = _region(fit, np.flatnonzero(judged)[~beaten]) if beaten.any() else ""
    colon = "" if beaten.all() else ":"
    lines.append(f"the log law holds in {(~beaten).sum()} of {judged.sum()}{region}{colon}")
    for name, mask in sorted(readings.items(), key=lambda reading: not reading[1].any()):
        share = f"R2 {_range(r_squared[judged, names.index(name)][mask if mask.any() else slice(None)])}"
        if mask.any():
            lines.append(f"  as {name}, {formulas_of(fit)[name]}, in {mask.sum()}: {share}")
        elif name == "literal" and not beaten.all():
            lines.append(f"  not as literal, {formulas_of(fit)[name]}, which is how the source writes it: {share}")
    onset = names.index("onset")
    eta0, error = (table(fit, name)[judged, onset] for name in ("eta0", "eta0_stderr"))
    if (early := readings["onset"] & (eta0 + ONSET_STANDARD_ERRORS * error < 1)).any():
        where = "" if early.all() else f" in {early.sum()} of {early.size}"
        lines.append(
            f"the onset eta0 {_range(eta0[early])} is below 1{where}: penetration begins at a mean force P below D, "
            "as the peaks of the force exceed its mean; the literal form has no rate there"
        )
    if beaten.any():
        lines.append(f"it is beaten in {beaten.sum()}, by an AIC of {_range(log_law[beaten])}:")
        worst = np.argsort(-log_law, kind="stable")[: min(_GROUPS_BEATEN_SHOWN, beaten.sum())]
        groups = _group_names(fit)
        for row in worst:
            lines.append(f"  {groups[np.flatnonzero(judged)[row]]}: {names[best[row]]} by {log_law[row]:.3g}")
        lines += [f"  and {beaten.sum() - len(worst)} more"] if beaten.sum() > len(worst) else []
    return [*lines, *_recommendation(fit)]


def _choices(fit: xr.Dataset) -> list[str]:
    """Return lines of text: the form that each of the first groups supports, and forms that may be the truth too."""
    standing, aic = _standing(fit), table(fit, "aic")
    names, lines = np.array([str(name) for name in fit["form"].values]), []
    groups = np.flatnonzero((standing == Standing.CHOSEN).any(axis=1))
    for group in groups[:_GROUPS_TABULATED].tolist():
        [chosen] = names[standing[group] == Standing.CHOSEN]
        rivals = ", ".join(names[standing[group] == Standing.UNDECIDED])
        name = _group_names(fit)[group]
        if rivals:
            lines.append(f"{name}: these data cannot tell {chosen} from {rivals}")
        else:
            contains = (standing[group] == Standing.CONTAINS_CHOSEN).any()
            others = "every form that does not contain it" if contains else "the other forms"
            lines.append(f"{name}: the data support {chosen}, {formulas_of(fit)[str(chosen)]}, against {others}")
        best = str(names[np.nanargmin(aic[group])])
        if best != chosen and best not in CONTAINED.get(str(chosen), ()):
            lines.append(f"  AIC is lowest for {best}, but takes neighbouring rows for independent")
    more = groups.size - _GROUPS_TABULATED
    lines += [f"and {counted(more, 'group')} more"] if more > 0 else []
    return ["by the rates of each block of rows, predicted from the other blocks (CV):", *(f"  {x}" for x in lines)]


def _determined(fit: xr.Dataset) -> list[str]:
    """Return lines of text: what the data determine if the threshold is unknown."""
    force = attribute_of(fit, "reference_force")
    if force is None:
        return []
    onset, error = (fit[f"onset_force{name}"].sel(form="onset").values.ravel() for name in ("", "_stderr"))
    slope = fit["C"].sel(form="line").values.ravel() / force
    known = np.isfinite(onset)
    lines = [
        f"the threshold D is unknown, so that eta = P/{force / 1e3:.4g} kN, by the median of the mean force P. "
        "The data determine C and eta0 D of onset, C/D and eta0 D of line, the exponent and C/D^exponent of power:"
    ]
    for group in np.flatnonzero(known)[:_GROUPS_TABULATED].tolist():
        lines.append(
            f"  {_group_names(fit)[group]}: onset eta0 D = {onset[group] / 1e3:.4g} ± {error[group] / 1e3:.2g} kN; "
            f"line C/D = {1e3 * slope[group]:.4g} m/s per kN"
        )
    if known.any():
        lines.append("  literal and percent have the curve of onset: D would be eta0 D, or 100 times as much")
    return lines


def _recommendation(fit: xr.Dataset) -> list[str]:
    """Return lines of text with the recommended C of the first groups, in m/s and in the unit of the data's rate."""
    choices = recommended(fit)
    if not any(choices):
        return []
    lines = []
    for name, choice in zip(_group_names(fit), choices, strict=True):
        if choice:
            texts = [_interval(choice, "m/s")]
            texts += [_interval(choice["in_unit"], choice["unit"])] if "unit" in choice else []
            lines.append(f"{name}: C = {' = '.join(texts)}, {choice['form']}")
    more = [f"  and {len(lines) - _GROUPS_TABULATED} more"] if len(lines) > _GROUPS_TABULATED else []
    by_blocks = (_standing(fit) == Standing.CHOSEN).any()
    how = "of the chosen form" if by_blocks else "of the reading of the log law with the lowest AIC"
    title = f"recommended C (95 % interval{', by a bootstrap of blocks' * bool(by_blocks)}), {how}:"
    return [title, *(f"  {line}" for line in lines[:_GROUPS_TABULATED]), *more]


def _interval(values: Mapping[str, Any], unit: str) -> str:
    return f"{values['C']:.4g} {unit} ({values['low']:.4g} to {values['high']:.4g})"


def formulas_of(fit: xr.Dataset) -> dict[str, str]:
    """Return the formula of each form, by name; empty if the dataset contains none."""
    return dict(part.split(": ", 1) for part in str(fit.attrs.get("formulas", "")).split("; ") if ": " in part)


def _group_names(fit: xr.Dataset) -> list[str]:
    """Return the coordinates of each group as text, such as "force=200000 N, rock=granite"."""
    along = []
    for dim in (dim for dim in fit["aic"].dims if dim != "form"):
        names = [name for name in fit.coords if fit[name].dims == (dim,)]
        texts = ([f"{name}={_value(fit[name], k)}" for name in names] or [f"{dim}={k}"] for k in range(fit.sizes[dim]))
        along.append([", ".join(parts) for parts in texts])
    return [", ".join(parts) or "all lanes" for parts in product(*along)]


def _value(coordinate: xr.DataArray, index: int) -> str:
    value, unit = coordinate.values[index].item(), coordinate.attrs.get("units", "1")
    return (f"{value:.6g}" if isinstance(value, float) else str(value)) + ("" if unit == "1" else f" {unit}")


def _range(values: Float[np.ndarray, " groups"]) -> str:
    values = values[np.isfinite(values)]
    if not len(values):
        return "is not defined, since no rate varies"
    low, middle, high = np.min(values), np.median(values), np.max(values)
    return f"{low:.4g}" if len(values) == 1 else f"{low:.4g} to {high:.4g} (median {middle:.4g})"


def _region(fit: xr.Dataset, groups: Shaped[np.ndarray, " groups"]) -> str:
    """Return text that describes the smallest box over the groups' axes that contains `groups`, flat indices."""
    dims = [dim for dim in fit["aic"].dims if dim != "form"]
    positions = np.unravel_index(groups, [fit.sizes[dim] for dim in dims]) if dims else ()
    ranges = []
    for dim, indices in zip(dims, positions, strict=True):
        if dim in fit.coords and len(indices):
            low, high = (_value(fit[dim], int(index)) for index in (indices.min(), indices.max()))
            ranges.append(f"{dim} {low}" + (f" to {high}" if high != low else ""))
    return f", all of them within {', '.join(ranges)}" if ranges else ""
