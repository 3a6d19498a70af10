"""Summary of a fitted rate-of-penetration law, as text and as JSON: tables, the comparison of forms, the recommended C.

A *group* is a set of lanes with a law of its own; a *form* is a formula of the law.
"""

import math
from collections import Counter
from collections.abc import Hashable, Mapping
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Shaped
from scipy.special import stdtrit

from vibrojax.errors import counted
from vibrojax.io.attributes import attribute_of, table_of
from vibrojax.io.log_columns import RATE
from vibrojax.io.riglog import LIMITS_OF_LOGS, is_log
from vibrojax.physics.units import factor
from vibrojax.studies.rop_blocks import Founder, Standing
from vibrojax.studies.rop_forms import LOGARITHMIC
from vibrojax.studies.rop_law import LEAST_DEGREES_OF_FREEDOM

_ONSET_STANDARD_ERRORS = 2.0  # by which an onset is below 1 before the verdict says so
_GROUPS_LISTED = 12
_PER_HOUR, _PER_STEP = 3600.0, 10e3  # the fall of the rate in m/h per 10 kN


def table(fit: xr.Dataset, name: str) -> Shaped[np.ndarray, "groups forms"]:
    """Return a variable of a dataset that `fit_rop` returned as an array with one row per group."""
    return np.asarray(fit[name].transpose(*group_dims(fit), "form").values.reshape(-1, fit.sizes["form"]))


def group_dims(fit: xr.Dataset) -> list[Hashable]:
    """Return the dimensions of the groups of a fit."""
    return [dim for dim in fit["aic"].dims if dim != "form"]


def group_names(fit: xr.Dataset) -> list[str]:
    """Return the coordinates of each group as text, such as "force=200000 N, rock=granite"."""

    def text(name: Hashable, index: int) -> str:
        value, unit = fit[name].values[index].item(), fit[name].attrs.get("units", "1")
        number = f"{value:.6g}" if isinstance(value, float) else str(value)
        return f"{name}={number}" + ("" if unit == "1" else f" {unit}")

    along = []
    for dim in group_dims(fit):
        names = [name for name in fit.coords if fit[name].dims == (dim,)]
        texts = ([text(name, k) for name in names] or [f"{dim}={k}"] for k in range(fit.sizes[dim]))
        along.append([", ".join(parts) for parts in texts])
    return [", ".join(parts) or "all lanes" for parts in product(*along)]


def formulas_of(fit: xr.Dataset) -> dict[str, str]:
    """Return the formula of each form, by name; empty if the dataset contains none."""
    return dict(part.split(": ", 1) for part in str(fit.attrs.get("formulas", "")).split("; ") if ": " in part)


def founders(fit: xr.Dataset) -> list[Founder]:
    """Return the founder weight of each group."""
    names = ("founder_weight", "founder_weight_stderr", "founder_fall", "founder_fall_stderr")
    return [Founder(*numbers) for numbers in np.array([fit[name].values.ravel() for name in names]).T.tolist()]


def _forms(fit: xr.Dataset) -> list[str]:
    return [str(name) for name in fit["form"].values]


def _by_blocks(fit: xr.Dataset) -> bool:
    return bool(fit["cv_error"].notnull().any())


# Tables


def law_facts(fit: xr.Dataset) -> dict[str, Any]:
    """Return the summary of a fit as a dictionary of JSON values: of each group, the values of every form.

    **Arguments:** `fit`: a dataset that `fit_rop` returned.
    """
    dims, forms = group_dims(fit), _forms(fit)
    values = {str(name): table(fit, str(name)) for name, v in fit.items() if set(v.dims) == {*dims, "form"}}
    for name in ("reason", "r_squared_reason", "standing"):
        values[name] = np.array(str(fit[name].attrs["flag_meanings"]).split())[values[name]]
    parts = zip(group_names(fit), founders(fit), recommended(fit), strict=True)
    groups: list[dict[str, Any]] = []
    for index, (name, founder, choice) in enumerate(parts):
        position = np.unravel_index(index, [fit.sizes[dim] for dim in dims])
        at = fit.coords.to_dataset().isel(dict(zip(dims, position, strict=True)))
        groups.append(
            {
                "name": name,
                "coordinates": {str(x): at[x].item() for x in at.coords if not at[x].ndim},
                "forms": {
                    form: {name: v[index, k].item() for name, v in values.items()} for k, form in enumerate(forms)
                },
                **{f"founder_{x}": number for x, number in founder._asdict().items() if x != "correlation"},
                "recommended": choice,
            }
        )
    facts: dict[str, Any] = {"along": str(fit.attrs["along"]), "columns": table_of(fit, "columns") or None}
    if "dialect" in fit.attrs:
        facts |= {name: attribute_of(fit, name) for name in ("dialect", "rows_read", "dropped", "notes")}
        facts["left_out_rows"] = table_of(fit, "left_out_rows")
    return {**facts, "groups": groups, "supported": str(fit.attrs["verdict"]), "verdict": verdict(fit)}


def law_table(facts: Mapping[str, Any]) -> list[str]:
    """Return lines of text: a table of the forms for each of the first groups, then the number of other groups."""
    lines: list[str] = []
    for group in facts["groups"][:_GROUPS_LISTED]:
        forms = group["forms"]
        first, reasons = next(iter(forms.values())), {str(values["reason"]) for values in forms.values()}
        left_out = f", {first['left_out']} left out" if first["left_out"] else ""
        head = f"{group['name']}: {counted(first['used'], 'lane')} along {facts['along']}{left_out}"
        if len(reasons) == 1 and not any(math.isfinite(values["C"]) for values in forms.values()):
            lines.append(f"{head}: {reasons.pop()}")
            continue
        by_blocks = any(math.isfinite(values["cv_error"]) for values in forms.values())
        names = f"  {'form':<9}{'C [m/s]':<24}{'eta0':<22}{'exponent':<20}{'R2':>8}{'AIC':>12}"
        lines += [""] * bool(lines) + [head, names + f"{'CV [m/s]':>11}" * by_blocks]
        lines += [f"  {form:<9}{_table_row(values)}".rstrip() for form, values in forms.items()]
    return lines + _further(len(facts["groups"]))


def _further(groups: int) -> list[str]:
    """Return a line with the number of groups that are not listed, if there are any."""
    return [f"and {counted(groups - _GROUPS_LISTED, 'group')} more"] * (groups > _GROUPS_LISTED)


def _table_row(values: Mapping[str, Any]) -> str:
    """Return a table row: the coefficients with standard errors, R², AIC, and the reasons for missing values."""
    if not math.isfinite(values["C"]):
        return str(values["reason"])
    c, eta0, exponent = (
        f"{values[name]:.4g} ± {values[f'{name}_stderr']:.2g}" if math.isfinite(values[name]) else ""
        for name in ("C", "eta0", "exponent")
    )
    row = f"{c:<24}{eta0:<22}{exponent:<20}{values['r_squared']:>8.4f}{values['aic']:>12.2f}"
    reasons = [values[name] for name in ("reason", "r_squared_reason") if values[name] != "identified"]
    if math.isfinite(values["cv_error"]):
        row += f"{values['cv_error']:>11.4g}"
        reasons += [values["standing"]] * (values["standing"] in ("chosen", "undecided"))
    return f"{row}  {', '.join(reasons)}"


# The recommended C and the comparison of the forms


def recommended(fit: xr.Dataset) -> list[dict[str, Any] | None]:
    """Return the recommended C of each group, or None if there is none.

    For a log whose forms were compared over blocks of rows, it is that of the form that the data support. Otherwise it
    is that of the likeliest reading of the log law, if the log law holds and C is positive.

    A dictionary holds `form`, `C` [m/s] and the ends `low` and `high` of its 95 % interval [m/s], by Student's
    distribution, and, with rig data, the `unit` of the data's rate and these three in it (`in_unit`).
    """
    names, standing, against = _forms(fit), table(fit, "standing"), table(fit, "evidence_against")
    c, error, freedom, reason = (table(fit, name) for name in ("C", "C_stderr", "degrees_of_freedom", "reason"))
    readings = [names.index(name) for name in LOGARITHMIC]
    unit = str(table_of(fit, "columns").get(RATE, {}).get("unit", "m/s"))
    scale = factor(unit, "m s-1") or 1.0
    choices: list[dict[str, Any] | None] = []
    for group, row in enumerate(standing):
        form = int(np.argmax(row))
        if not _by_blocks(fit) or (row == Standing.UNDECIDED).any():
            form = readings[int(np.argmin(np.nan_to_num(against[group, readings], nan=np.inf)))]
        if row[form] < Standing.UNDECIDED or reason[group, form] or c[group, form] <= 0:
            choices.append(None)
            continue
        half = float(stdtrit(freedom[group, form], 0.975) * error[group, form])
        values = {name: float(c[group, form]) + sign * half for name, sign in (("C", 0), ("low", -1), ("high", 1))}
        in_unit = {name: value / scale for name, value in values.items()}
        choices.append({"form": names[form], **values} | ({"unit": unit, "in_unit": in_unit} if scale != 1 else {}))
    return choices


def verdict(fit: xr.Dataset) -> list[str]:
    """Return lines of text: the form that describes the data best, the founder weight, and the recommended C.

    The log law holds if one of its three readings is not rejected.

    **Arguments:** `fit`: a dataset that `fit_rop` returned.
    """
    names, standing, titles = _forms(fit), table(fit, "standing"), group_names(fit)
    judged, missing = (standing > 0).any(axis=1), ~np.isfinite(table(fit, "aic"))
    lost, lines = missing.any(axis=1) & ~judged, []
    if lost.any():  # count the reason of the first missing form in each group
        reasons = np.array(str(fit["reason"].attrs["flag_meanings"]).split())[table(fit, "reason")[lost]]
        counts = Counter(reasons[np.arange(len(reasons)), np.argmax(missing[lost], axis=1)].tolist())
        listed = ", ".join(f"{meaning} {count}" for meaning, count in sorted(counts.items()))
        lines.append(f"not every form can be told in {lost.sum()} of {judged.size}: {listed}")
    if (short := ~judged & ~lost).any():
        needed = f"at least {LEAST_DEGREES_OF_FREEDOM + 2} with a rate are needed"
        lines.append(f"too few lanes to compare the forms in {short.sum()} of {judged.size}; {needed}")
    if judged.any():
        lines += _comparison(fit, names, standing, titles)
    else:
        lines.append("no form can be told from the lanes that are there")
    founder_lines, choices = [], []
    for title, founder, choice in zip(titles, founders(fit), recommended(fit), strict=True):
        if founder.is_known:
            fall, error = (_PER_HOUR * _PER_STEP * value for value in (founder.fall, founder.fall_stderr))
            above = f"falls by {fall:.3g} ± {error:.2g} m/h per 10 kN" if founder.falls else "does not rise"
            weight = f"{founder.weight / 1e3:.4g} ± {founder.weight_stderr / 1e3:.2g} kN"
            founder_lines.append(f"  {title}: {weight}; above it the rate {above}")
        if choice:
            scales = [(choice, "m/s"), *([(choice["in_unit"], choice["unit"])] if "unit" in choice else [])]
            texts = [f"{x['C']:.4g} {unit} ({x['low']:.4g} to {x['high']:.4g})" for x, unit in scales]
            choices.append(f"  {title}: C = {' = '.join(texts)}, {choice['form']}")
    how = "), of the likeliest reading of the log law"
    if _by_blocks(fit):
        how = ", by blocks of rows), of the form that the data support, or else of the likeliest log law"
    lines += _listed("founder weight; the coefficients of every form are of the rows below it:", founder_lines)
    rows = table_of(fit, "left_out_rows").items()
    lines += [f"left out, {reason}: {counted(about['rows'], 'row')} (line {about['lines']})" for reason, about in rows]
    lines += _unknown_threshold(fit, titles) + [LIMITS_OF_LOGS] * is_log(fit)
    return lines + _listed(f"recommended C (95 % interval{how}:", choices)


def _listed(title: str, lines: list[str]) -> list[str]:
    """Return a title above the first lines and the number of further ones; nothing without lines."""
    return [title, *lines[:_GROUPS_LISTED], *_further(len(lines))] if lines else []


def _comparison(
    fit: xr.Dataset, names: list[str], standing: Shaped[np.ndarray, "groups forms"], titles: list[str]
) -> list[str]:
    """Return lines of text: the form that each group supports, its rivals, and where the log law holds."""
    judged, formulas, lines = np.flatnonzero((standing > 0).any(axis=1)), formulas_of(fit), []
    for group in judged.tolist():
        chosen = names[int(np.argmax(standing[group]))]
        rivals = ", ".join(np.array(names)[standing[group] == Standing.UNDECIDED])
        contains = (standing[group] == Standing.CONTAINS_CHOSEN).any()
        others = "every form that does not contain it" if contains else "the other forms"
        text = f"the data support {chosen}, {formulas[chosen]}, against {others}"
        lines.append(f"  {titles[group]}: {f'these data cannot tell {chosen} from {rivals}' if rivals else text}")
    how = "by the rates of each block of rows, predicted from the other blocks (CV)"
    lines = _listed(f"{how if _by_blocks(fit) else 'by AIC'}, in {judged.size} of {len(titles)}:", lines)
    if judged.size > 1:
        together = str(fit.attrs["verdict"]).replace("none", "no single form")
        lines.append(f"all groups together: the data support {together}")
    kept, r_squared = standing[judged] >= Standing.UNDECIDED, table(fit, "r_squared")[judged]
    holds = {name: kept[:, names.index(name)] for name in LOGARITHMIC if kept[:, names.index(name)].any()}
    count = np.any([*holds.values()], axis=0).sum() if holds else 0
    lines.append(f"the log law holds in {count} of {judged.size}{':' if holds else ''}")
    for name, mask in holds.items():
        spread = _range_text(r_squared[mask, names.index(name)])
        lines.append(f"  as {name}, {formulas[name]}, in {mask.sum()}: R2 {spread}")
    eta0, error = (table(fit, name)[judged, names.index("onset")] for name in ("eta0", "eta0_stderr"))
    early = kept[:, names.index("onset")] & (eta0 + _ONSET_STANDARD_ERRORS * error < 1)
    if early.any() and "reference_force" not in fit.attrs:
        lines.append(
            f"the onset eta0 {_range_text(eta0[early])} is below 1 in {early.sum()} of {early.size}: penetration "
            "begins at a mean force P below D, as the peaks of the force exceed its mean; "
            "the literal form has no rate there"
        )
    return lines


def _unknown_threshold(fit: xr.Dataset, titles: list[str]) -> list[str]:
    """Return lines of text: the combinations that the data determine if the threshold is unknown."""
    force = attribute_of(fit, "reference_force")
    if force is None:
        return []
    onset, error = (fit[f"onset_force{name}"].sel(form="onset").values.ravel() / 1e3 for name in ("", "_stderr"))
    slope = 1e3 * fit["C"].sel(form="line").values.ravel() / force
    lines = [
        f"  {titles[group]}: onset eta0 D = {onset[group]:.4g} ± {error[group]:.2g} kN; "
        f"line C/D = {slope[group]:.4g} m/s per kN"
        for group in np.flatnonzero(np.isfinite(onset)).tolist()
    ]
    about = (
        f"the threshold D is unknown, so that eta = P/{force / 1e3:.4g} kN, by the median of the mean force P. "
        "The data determine C and eta0 D of onset, C/D and eta0 D of line, the exponent and C/D^exponent of power:"
    )
    same = "  literal and percent have the curve of onset: D would be eta0 D, or 100 times as much"
    return [about, *_listed("", lines)[1:], *[same] * bool(lines)]


def _range_text(values: np.ndarray) -> str:
    """Return the least, the greatest and the median of values, or that there are none."""
    values = values[np.isfinite(values)]
    if not len(values):
        return "is not defined, since no rate varies"
    low, middle, high = np.min(values), np.median(values), np.max(values)
    return f"{low:.4g}" if len(values) == 1 else f"{low:.4g} to {high:.4g} (median {middle:.4g})"
