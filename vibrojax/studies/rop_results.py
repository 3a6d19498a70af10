"""Summary of a fitted rate-of-penetration law, as text and as JSON: tables, the comparison of forms, the recommended C.

A *group* is a set of lanes with a law of its own; a *form* is a formula of the law.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int
from scipy.special import stdtrit

from vibrojax.errors import counted
from vibrojax.io.attributes import attribute_of, table_of
from vibrojax.io.log_columns import RATE
from vibrojax.io.riglog import LIMITS_OF_LOGS, is_log
from vibrojax.physics.units import factor
from vibrojax.studies.rop_blocks import CONTAINED, Standing
from vibrojax.studies.rop_dataset import (
    formulas_of,
    group_dims,
    group_names,
    standings,
    table,
    value_text,
)

CLEAR_AIC_DIFFERENCE = 2.0
"""Difference in AIC above which another form describes the data better (Burnham and Anderson's rule of thumb)."""

LEAST_DEGREES_OF_FREEDOM = 2
"""Degrees of freedom below which forms are not compared: the correction of AIC for small samples, 2k(k + 1)/(n - k - 1)
for k = 2 coefficients, is finite from n = 4 lanes on."""

ONSET_STANDARD_ERRORS = 2.0
"""Number of standard errors by which an onset is below 1 before the verdict says so."""

LOGARITHMIC = ("literal", "percent", "onset")
"""Names of the three readings of the source's law, eq. 6.4."""

_GROUPS_LISTED, _BEATEN_LISTED = 12, 5


# Tables


def law_facts(fit: xr.Dataset) -> dict[str, Any]:
    """Return the summary of a fitted rate-of-penetration law as a dictionary of JSON values.

    It contains the name and the coordinates of each group and, by form, the fitted values, with the meanings of flags.

    **Arguments:** `fit`: a dataset that `fit_rop` returned.
    """
    dims = group_dims(fit)
    values = {str(name): table(fit, str(name)) for name, v in fit.items() if set(v.dims) == {*dims, "form"}}
    for name in ("reason", "r_squared_reason", "standing"):
        values[name] = np.array(str(fit[name].attrs["flag_meanings"]).split())[values[name]]
    groups: list[dict[str, Any]] = []
    choices, names = recommended(fit), group_names(fit)
    for index, position in enumerate(np.ndindex(*(fit.sizes[dim] for dim in dims))):
        lanes = fit.isel(dict(zip(dims, position, strict=True)))
        coordinates = {str(name): lanes[name].item() for name in lanes.coords if lanes[name].ndim == 0}
        forms = {
            form: {name: rows[index, column].item() for name, rows in values.items()}
            for column, form in enumerate(_forms(fit))
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
    for group in facts["groups"][:_GROUPS_LISTED]:
        first = next(iter(group["forms"].values()))
        left_out = f", {first['left_out']} left out" if first["left_out"] else ""
        head = f"{group['name']}: {counted(first['used'], 'lane')} along {facts['along']}{left_out}"
        reasons = {str(values["reason"]) for values in group["forms"].values()}
        if len(reasons) == 1 and not any(math.isfinite(values["C"]) for values in group["forms"].values()):
            lines.append(f"{head}: {reasons.pop()}")
            continue
        by_blocks = any(values["standing"] == "chosen" for values in group["forms"].values())
        lines += [""] * bool(lines) + [head]
        lines.append(f"  {'form':<9}{'C [m/s]':<24}{'eta0':<22}{'exponent':<20}{'R2':>8}{'AIC':>12}")
        lines[-1] += f"{'CV [m/s]':>11}" * by_blocks
        lines += [f"  {form:<9}{_table_row(values)}".rstrip() for form, values in group["forms"].items()]
    return lines + _further(len(facts["groups"]))


def _further(groups: int) -> list[str]:
    """Return a line with the number of groups that are not listed, if there are any."""
    more = groups - _GROUPS_LISTED
    return [f"and {counted(more, 'group')} more"] if more > 0 else []


def _table_row(values: Mapping[str, float | int | str]) -> str:
    """Return a table row: the coefficients with standard errors, R², AIC, and the reasons for missing values."""
    if not math.isfinite(float(values["C"])):
        return str(values["reason"])
    cells = [
        f"{values[name]:.4g} ± {values[f'{name}_stderr']:.2g}" if math.isfinite(float(values[name])) else ""
        for name in ("C", "eta0", "exponent")
    ]
    row = f"{cells[0]:<24}{cells[1]:<22}{cells[2]:<20}{values['r_squared']:>8.4f}{values['aic']:>12.2f}"
    row += f"{values['cv_error']:>11.4g}" if math.isfinite(float(values["cv_error"])) else ""
    reasons = [str(values[name]) for name in ("reason", "r_squared_reason") if values[name] != "identified"]
    reasons += [str(values["standing"])] * (values["standing"] in ("chosen", "undecided"))
    return f"{row}  {', '.join(reasons)}" if reasons else row


# The recommended C


def recommended(fit: xr.Dataset) -> list[dict[str, Any] | None]:
    """Return the recommended C of each group.

    For a log whose forms were compared over blocks of rows, it is that of the chosen form. Otherwise it is that of the
    reading of the log law with the lowest AIC, if the log law holds.

    A dictionary holds `form`, `C` [m/s] and the ends `low` and `high` of its 95 % confidence interval [m/s], by
    Student's distribution. With rig data it also holds these three in the unit of the data's rate, as `in_unit`, and
    this `unit`. It is None if the log law does not hold, its C is not positive, or the lanes cannot decide it.
    """
    names = _forms(fit)
    judged, above_best = _judged(fit)
    c, error, freedom, reason = (table(fit, name) for name in ("C", "C_stderr", "degrees_of_freedom", "reason"))
    forms: dict[int, int] = {}
    for row, group in zip(above_best, np.flatnonzero(judged).tolist(), strict=True):
        form = min((names.index(name) for name in LOGARITHMIC), key=lambda column: row[column])
        if row[form] <= CLEAR_AIC_DIFFERENCE:
            forms[group] = form
    forms |= {group: form for group, form in np.argwhere(standings(fit) == Standing.CHOSEN).tolist()}
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


def _recommendation(fit: xr.Dataset) -> list[str]:
    """Return lines of text with the recommended C of the first groups, in m/s and in the unit of the data's rate."""
    lines = []
    for name, choice in zip(group_names(fit), recommended(fit), strict=True):
        if choice:
            scales = [(choice, "m/s"), *([(choice["in_unit"], choice["unit"])] if "unit" in choice else [])]
            texts = [f"{x['C']:.4g} {unit} ({x['low']:.4g} to {x['high']:.4g})" for x, unit in scales]
            lines.append(f"{name}: C = {' = '.join(texts)}, {choice['form']}")
    if not lines:
        return []
    title = "recommended C (95 % interval), of the reading of the log law with the lowest AIC:"
    if (standings(fit) == Standing.CHOSEN).any():
        title = "recommended C (95 % interval, by a bootstrap of blocks), of the chosen form:"
    return [title, *(f"  {line}" for line in lines[:_GROUPS_LISTED] + _further(len(lines)))]


# The comparison of the forms


def verdict(fit: xr.Dataset) -> list[str]:
    """Return lines of text: the form that describes the data best, where the log law holds, and the recommended C.

    For a log whose forms were compared over blocks of rows, they say which form the data support, and from which others
    they cannot tell it. Otherwise, a form holds in a group if its AIC exceeds the lowest by at most
    `CLEAR_AIC_DIFFERENCE`. The log law holds if one of its three readings holds. Groups with fewer than four lanes with
    a rate cannot decide it.

    **Arguments:** `fit`: a dataset that `fit_rop` returned.
    """
    judged, _ = _judged(fit)
    missing = ~np.isfinite(table(fit, "aic"))
    lost, by_blocks = missing.any(axis=1), (standings(fit) == Standing.CHOSEN).any()
    lines = []
    if lost.any() and not by_blocks:  # count the reason of the first missing form in each group
        meanings = str(fit["reason"].attrs["flag_meanings"]).split()
        reasons = table(fit, "reason")[lost, np.argmax(missing[lost], axis=1)]
        counts = {meanings[flag]: int((reasons == flag).sum()) for flag in np.unique(reasons)}
        listed = ", ".join(f"{meaning} {count}" for meaning, count in sorted(counts.items()))
        lines.append(f"not every form can be told in {reasons.size} of {judged.size}: {listed}")
    if (short := ~judged & ~lost).any():
        needed = f"at least {LEAST_DEGREES_OF_FREEDOM + 2} with a rate are needed"
        lines.append(f"too few lanes to compare the forms in {short.sum()} of {judged.size}; {needed}")
    if by_blocks:
        lines += _forms_by_blocks(fit)
    elif judged.any():
        lines += _forms_by_aic(fit)
    else:
        lines.append("no form can be told from the lanes that are there")
    limits = [LIMITS_OF_LOGS] if is_log(fit) else []
    return [*lines, *_determined_combinations(fit), *limits, *_recommendation(fit)]


def _forms_by_blocks(fit: xr.Dataset) -> list[str]:
    """Return lines of text: the form that each of the first groups supports, and forms that may be the truth too."""
    standing, aic, names, titles = standings(fit), table(fit, "aic"), np.array(_forms(fit)), group_names(fit)
    groups, lines = np.flatnonzero((standing == Standing.CHOSEN).any(axis=1)), []
    for group in groups[:_GROUPS_LISTED].tolist():
        chosen = str(names[standing[group] == Standing.CHOSEN][0])
        if rivals := ", ".join(names[standing[group] == Standing.UNDECIDED]):
            lines.append(f"{titles[group]}: these data cannot tell {chosen} from {rivals}")
        else:
            contains = (standing[group] == Standing.CONTAINS_CHOSEN).any()
            others = "every form that does not contain it" if contains else "the other forms"
            lines.append(f"{titles[group]}: the data support {chosen}, {formulas_of(fit)[chosen]}, against {others}")
        best = str(names[np.nanargmin(aic[group])])
        if best != chosen and best not in CONTAINED.get(chosen, ()):
            lines.append(f"  AIC is lowest for {best}, but takes neighbouring rows for independent")
    title = "by the rates of each block of rows, predicted from the other blocks (CV):"
    return [title, *(f"  {line}" for line in lines + _further(groups.size))]


def _forms_by_aic(fit: xr.Dataset) -> list[str]:
    """Return lines of text: the forms with the lowest AIC, and where the log law holds or is beaten."""
    names, (judged, above_best), r_squared = _forms(fit), _judged(fit), table(fit, "r_squared")
    best, holds = np.argmin(above_best, axis=1), above_best <= CLEAR_AIC_DIFFERENCE
    lines = [f"along {fit.attrs['along']}, over {judged.sum()} of {judged.size}:"]
    rows = [(int((best == form).sum()), int(holds[:, form].sum()), form) for form in range(len(names))]
    for lowest, close, form in sorted(rows, reverse=True):
        counts = f"lowest AIC in {lowest}, within {CLEAR_AIC_DIFFERENCE:g} of it in {close}"
        lines.append(f"  {names[form]:<8} {counts}; R2 {_range_text(r_squared[judged, form])}")
    readings = {name: holds[:, names.index(name)] for name in LOGARITHMIC}
    log_law = above_best[:, [names.index(name) for name in LOGARITHMIC]].min(axis=1)
    beaten = log_law > CLEAR_AIC_DIFFERENCE
    region = _region_text(fit, np.flatnonzero(judged)[~beaten]) if beaten.any() else ""
    lines.append(f"the log law holds in {(~beaten).sum()} of {judged.sum()}{region}{'' if beaten.all() else ':'}")
    for name, mask in sorted(readings.items(), key=lambda reading: not reading[1].any()):
        share = f"R2 {_range_text(r_squared[judged, names.index(name)][mask if mask.any() else slice(None)])}"
        if mask.any():
            lines.append(f"  as {name}, {formulas_of(fit)[name]}, in {mask.sum()}: {share}")
        elif name == "literal" and not beaten.all():
            lines.append(f"  not as literal, {formulas_of(fit)[name]}, which is how the source writes it: {share}")
    eta0, error = (table(fit, name)[judged, names.index("onset")] for name in ("eta0", "eta0_stderr"))
    if (early := readings["onset"] & (eta0 + ONSET_STANDARD_ERRORS * error < 1)).any():
        where = "" if early.all() else f" in {early.sum()} of {early.size}"
        lines.append(
            f"the onset eta0 {_range_text(eta0[early])} is below 1{where}: penetration begins at a mean force P below "
            "D, as the peaks of the force exceed its mean; the literal form has no rate there"
        )
    if beaten.any():
        lines.append(f"it is beaten in {beaten.sum()}, by an AIC of {_range_text(log_law[beaten])}:")
        titles = group_names(fit)
        for row in np.argsort(-log_law, kind="stable")[: min(_BEATEN_LISTED, beaten.sum())]:
            lines.append(f"  {titles[np.flatnonzero(judged)[row]]}: {names[best[row]]} by {log_law[row]:.3g}")
        lines += [f"  and {beaten.sum() - _BEATEN_LISTED} more"] if beaten.sum() > _BEATEN_LISTED else []
    return lines


def _judged(fit: xr.Dataset) -> tuple[Bool[np.ndarray, " groups"], Float[np.ndarray, "judged forms"]]:
    """Return a mask of the groups with enough lanes to compare all forms, and there the AIC above the lowest one."""
    aic = table(fit, "aic")
    judged = np.isfinite(aic).all(axis=1) & (table(fit, "degrees_of_freedom") >= LEAST_DEGREES_OF_FREEDOM).all(axis=1)
    return judged, aic[judged] - aic[judged].min(axis=1, keepdims=True)


def _determined_combinations(fit: xr.Dataset) -> list[str]:
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
    for group in np.flatnonzero(known)[:_GROUPS_LISTED].tolist():
        lines.append(
            f"  {group_names(fit)[group]}: onset eta0 D = {onset[group] / 1e3:.4g} ± {error[group] / 1e3:.2g} kN; "
            f"line C/D = {1e3 * slope[group]:.4g} m/s per kN"
        )
    if known.any():
        lines.append("  literal and percent have the curve of onset: D would be eta0 D, or 100 times as much")
    return lines


def _forms(fit: xr.Dataset) -> list[str]:
    return [str(name) for name in fit["form"].values]


def _range_text(values: Float[np.ndarray, " groups"]) -> str:
    """Return the least, the greatest and the median of values, or that there are none."""
    values = values[np.isfinite(values)]
    if not len(values):
        return "is not defined, since no rate varies"
    low, middle, high = np.min(values), np.median(values), np.max(values)
    return f"{low:.4g}" if len(values) == 1 else f"{low:.4g} to {high:.4g} (median {middle:.4g})"


def _region_text(fit: xr.Dataset, groups: Int[np.ndarray, " groups"]) -> str:
    """Return text that describes the smallest box over the groups' axes that contains `groups`, flat indices."""
    dims = group_dims(fit)
    positions = np.unravel_index(groups, [fit.sizes[dim] for dim in dims]) if dims else ()
    ranges = []
    for dim, indices in zip(dims, positions, strict=True):
        if dim in fit.coords and len(indices):
            low, high = (value_text(fit[dim], int(index)) for index in (indices.min(), indices.max()))
            ranges.append(f"{dim} {low}" + (f" to {high}" if high != low else ""))
    return f", all of them within {', '.join(ranges)}" if ranges else ""
