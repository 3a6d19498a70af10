"""Summary of a fitted rate-of-penetration law, as text and as JSON: a table of the forms, the verdict, recommended C.

A *group* is a set of lanes with a law of its own; a *form* is a formula of the law.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from scipy.special import stdtrit

from vibrojax.errors import counted
from vibrojax.io.attributes import attribute_of, flags, table_of
from vibrojax.io.log_columns import RATE
from vibrojax.io.riglog import LIMITS_OF_LOGS, is_log
from vibrojax.physics.units import factor
from vibrojax.studies.rop_forms import LOGARITHMIC
from vibrojax.studies.rop_group import COEFFICIENTS, LEAST_DEGREES_OF_FREEDOM, Founder

_ONSET_STANDARD_ERRORS = 2.0  # by which an onset is below 1 before the verdict says so
_GROUPS_LISTED = 12
_PER_HOUR, _PER_STEP = 3600.0, 10e3  # the fall of the rate in m/h per 10 kN
_KEPT = ("undecided", "contains-chosen", "chosen")


def groups_of(fit: xr.Dataset) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield the name of each group, such as "force=200000 N, rock=granite", and a table of its forms, by name."""
    dims = [dim for dim in fit["aic"].dims if dim != "form"]
    whole = fit.drop_dims([dim for dim in fit.dims if dim not in (*dims, "form")])
    table = whole.to_dataframe(dim_order=[*dims, "form"]).reset_index()
    for name in ("reason", "r_squared_reason", "standing"):
        table[name] = table[name].map(flags(fit[name]))
    names = [name for name in table if name in dims or (name in fit.coords and name != "form" and fit[name].dims)]
    # A dimension without values of its own has a name only if nothing else distinguishes its groups.
    named = {dim for name in names if name in fit.coords for dim in fit[name].dims}
    names = [name for name in names if name in fit.coords or name not in named]
    for _, part in table.groupby(np.arange(len(table)) // fit.sizes["form"]):
        first = part.iloc[0]
        texts = [f"{name}={_text(fit, name, first[name])}" for name in names]
        yield ", ".join(texts) or "all lanes", part.set_index("form")


def _text(fit: xr.Dataset, name: str, value: Any) -> str:
    unit = fit[name].attrs.get("units", "1")
    return (f"{value:.6g}" if isinstance(value, float) else str(value)) + ("" if unit == "1" else f" {unit}")


def formulas_of(fit: xr.Dataset) -> dict[str, str]:
    """Return the formula of each form, by name; empty if the dataset contains none."""
    return dict(part.split(": ", 1) for part in str(fit.attrs.get("formulas", "")).split("; ") if ": " in part)


def founder_of(group: pd.DataFrame) -> Founder:
    """Return the founder weight of a group."""
    first = group.iloc[0]
    return Founder(*(float(first[f"founder_{name}"]) for name in Founder._fields[:4]))


def law_facts(fit: xr.Dataset) -> dict[str, Any]:
    """Return the summary of a fit as a dictionary of JSON values: of each group, the values of every form.

    **Arguments:** `fit`: a dataset that `fit_rop` returned.
    """
    of_forms = [str(name) for name, x in fit.items() if "form" in x.dims]
    groups = []
    for title, group in groups_of(fit):
        first = group.iloc[:1].to_dict("records")[0]
        founder = {f"founder_{name}": x for name, x in founder_of(group)._asdict().items() if name != "correlation"}
        coordinates = {str(name): first[str(name)] for name in fit.coords if name in first}
        forms = group[of_forms].to_dict("index")
        choice = recommended(fit, group)
        groups.append({"name": title, "coordinates": coordinates, "forms": forms, **founder, "recommended": choice})
    facts: dict[str, Any] = {"along": str(fit.attrs["along"]), "columns": table_of(fit, "columns") or None}
    if "dialect" in fit.attrs:
        facts |= {name: attribute_of(fit, name) for name in ("dialect", "rows_read", "dropped", "notes")}
        facts["left_out_rows"] = table_of(fit, "left_out_rows")
    return {**facts, "groups": groups, "supported": str(fit.attrs["verdict"]), "verdict": verdict(fit)}


def tables(fit: xr.Dataset) -> list[str]:
    """Return lines of text: a table of the forms for each of the first groups, then the number of other groups."""
    lines: list[str] = []
    groups = list(groups_of(fit))
    for title, group in groups[:_GROUPS_LISTED]:
        first = group.iloc[0]
        left_out = f", {first['left_out']} left out" if first["left_out"] else ""
        lines += [""] * bool(lines)
        lines.append(f"{title}: {counted(first['used'], 'lane')} along {fit.attrs['along']}{left_out}")
        if group["C"].isna().all() and group["reason"].nunique() == 1:
            lines[-1] += f": {first['reason']}"
            continue
        shown = pd.DataFrame(index=group.index.rename(None))
        for name, text in zip(COEFFICIENTS, ("C [m/s]", "eta0", "exponent"), strict=True):
            pairs = zip(group[name], group[f"{name}_stderr"], strict=True)
            shown[text] = [f"{value:.4g} ± {error:.2g}" if np.isfinite(value) else "" for value, error in pairs]
        for name, text, digits in (("r_squared", "R2", ".4f"), ("aic", "AIC", ".2f"), ("cv_error", "CV [m/s]", ".4g")):
            if name != "cv_error" or group[name].notna().any():
                shown[text] = [f"{value:{digits}}" if np.isfinite(value) else "" for value in group[name]]
        shown[""] = [_remark(values) for values in group.to_dict("records")]
        lines += [f"  {line}".rstrip() for line in shown.rename_axis(columns="form").to_string().splitlines()]
    return lines + _further(len(groups))


def _remark(values: dict[str, Any]) -> str:
    """Return why values of a form are missing, and whether a log's blocks of rows support the form."""
    reasons = [reason for reason in (values["reason"], values["r_squared_reason"]) if reason != "identified"]
    if np.isfinite(values["cv_error"]) and values["standing"] in ("chosen", "undecided"):
        reasons.append(values["standing"])
    return ", ".join(dict.fromkeys(reasons))


def _further(groups: int) -> list[str]:
    return [f"and {counted(groups - _GROUPS_LISTED, 'group')} more"] * (groups > _GROUPS_LISTED)


def _listed(title: str, lines: list[str]) -> list[str]:
    """Return a title above the first lines and the number of further ones; nothing without lines."""
    return [title, *(f"  {line}" for line in lines[:_GROUPS_LISTED]), *_further(len(lines))] if lines else []


def recommended(fit: xr.Dataset, group: pd.DataFrame) -> dict[str, Any] | None:
    """Return the recommended C of a group, or None if there is none.

    For a log whose forms were compared over blocks of rows, it is that of the form that the data support. Otherwise it
    is that of the likeliest reading of the log law, if the log law holds and C is positive.

    The dictionary holds `form`, `C` [m/s] and the ends `low` and `high` of its 95 % interval [m/s], by Student's
    distribution, and, with rig data, the `unit` of the data's rate and these three in it (`in_unit`).
    """
    standing, form = group["standing"], str(group["standing"].eq("chosen").idxmax())
    if group["cv_error"].isna().all() or (standing == "undecided").any():
        form = min(LOGARITHMIC, key=lambda name: np.nan_to_num(group["evidence_against"][name], nan=np.inf))
    values = group.loc[form]
    if values["standing"] not in _KEPT or values["reason"] != "identified" or values["C"] <= 0:
        return None
    c, half = float(values["C"]), float(stdtrit(values["degrees_of_freedom"], 0.975) * values["C_stderr"])
    interval = {"C": c, "low": c - half, "high": c + half}
    unit = str(table_of(fit, "columns").get(RATE, {}).get("unit", "m/s"))
    scale = factor(unit, "m s-1") or 1.0
    in_unit = {"unit": unit, "in_unit": {name: value / scale for name, value in interval.items()}}
    return {"form": form, **interval, **(in_unit if scale != 1 else {})}


def verdict(fit: xr.Dataset) -> list[str]:
    """Return lines of text: the form that describes the data best, the founder weight, and the recommended C.

    The log law holds if one of its three readings is not rejected.

    **Arguments:** `fit`: a dataset that `fit_rop` returned.
    """
    groups, formulas = dict(groups_of(fit)), formulas_of(fit)
    judged = {title: group for title, group in groups.items() if (group["standing"] != "not-compared").any()}
    others = [group for title, group in groups.items() if title not in judged]
    lost = [group.loc[group["aic"].isna(), "reason"].iloc[0] for group in others if group["aic"].isna().any()]
    by_blocks = bool(fit["cv_error"].notnull().any())
    lines = []
    if lost:
        counts = ", ".join(f"{reason} {count}" for reason, count in pd.Series(lost).value_counts().sort_index().items())
        lines.append(f"not every form can be told in {len(lost)} of {len(groups)}: {counts}")
    if short := len(others) - len(lost):
        needed = f"at least {LEAST_DEGREES_OF_FREEDOM + 2} with a rate are needed"
        lines.append(f"too few lanes to compare the forms in {short} of {len(groups)}; {needed}")
    if not judged:
        return [*lines, "no form can be told from the lanes that are there"] + [LIMITS_OF_LOGS] * is_log(fit)
    how = "by the rates of each block of rows, predicted from the other blocks (CV)" if by_blocks else "by AIC"
    compared = [f"{title}: {_comparison(group, formulas)}" for title, group in judged.items()]
    lines += _listed(f"{how}, in {len(judged)} of {len(groups)}:", compared)
    if len(judged) > 1:
        together = str(fit.attrs["verdict"]).replace("none", "no single form")
        lines.append(f"all groups together: the data support {together}")
    kept = pd.DataFrame({title: group["standing"].isin(_KEPT) for title, group in judged.items()}).loc[[*LOGARITHMIC]]
    lines.append(f"the log law holds in {kept.any().sum()} of {len(judged)}{':' * bool(kept.any().any())}")
    for name, holds in kept.iterrows():
        if holds.any():
            spread = _range_text([judged[title].loc[name, "r_squared"] for title in kept.columns[holds]])
            lines.append(f"  as {name}, {formulas[str(name)]}, in {holds.sum()}: R2 {spread}")
    unknown = "reference_force" in fit.attrs
    onsets = [judged[title].loc["onset"] for title in kept.columns[kept.loc["onset"]]]
    early = [x["eta0"] for x in onsets if x["eta0"] + _ONSET_STANDARD_ERRORS * x["eta0_stderr"] < 1]
    if early and not unknown:
        lines.append(
            f"the onset eta0 {_range_text(early)} is below 1 in {len(early)} of {len(judged)}: penetration begins at a "
            "mean force P below D, as the peaks of the force exceed its mean; the literal form has no rate there"
        )
    founders = {title: founder_of(group) for title, group in groups.items()}
    weights = [f"{title}: {_founder_text(founder)}" for title, founder in founders.items() if founder.is_known]
    lines += _listed("founder weight; the coefficients of every form are of the rows below it:", weights)
    rows = table_of(fit, "left_out_rows").items()
    lines += [f"left out, {reason}: {counted(about['rows'], 'row')} (line {about['lines']})" for reason, about in rows]
    lines += _unknown_threshold(fit, groups) if unknown else []
    lines += [LIMITS_OF_LOGS] * is_log(fit)
    choices = []
    for title, group in groups.items():
        if choice := recommended(fit, group):
            scales = [(choice, "m/s"), *([(choice["in_unit"], choice["unit"])] if "unit" in choice else [])]
            texts = [f"{x['C']:.4g} {unit} ({x['low']:.4g} to {x['high']:.4g})" for x, unit in scales]
            choices.append(f"{title}: C = {' = '.join(texts)}, {choice['form']}")
    how = ", by blocks of rows), of the form that the data support, or else" if by_blocks else "),"
    return lines + _listed(f"recommended C (95 % interval{how} of the likeliest reading of the log law:", choices)


def _comparison(group: pd.DataFrame, formulas: dict[str, str]) -> str:
    """Return the form that a group supports, or its rivals."""
    standing = group["standing"]
    chosen, rivals = str(standing.eq("chosen").idxmax()), list(standing.index[standing == "undecided"])
    if rivals:
        return f"these data cannot tell {chosen} from {', '.join(rivals)}"
    others = "every form that does not contain it" if (standing == "contains-chosen").any() else "the other forms"
    return f"the data support {chosen}, {formulas[chosen]}, against {others}"


def _founder_text(founder: Founder) -> str:
    fall, error = (_PER_HOUR * _PER_STEP * value for value in (founder.fall, founder.fall_stderr))
    above = f"falls by {fall:.3g} ± {error:.2g} m/h per 10 kN" if founder.falls else "does not rise"
    return f"{founder.weight / 1e3:.4g} ± {founder.weight_stderr / 1e3:.2g} kN; above it the rate {above}"


def _unknown_threshold(fit: xr.Dataset, groups: dict[str, pd.DataFrame]) -> list[str]:
    """Return lines of text: the combinations that the data determine if the threshold is unknown."""
    force = float(fit.attrs["reference_force"])
    lines = []
    for title, group in groups.items():
        onset, error = group.loc["onset", ["onset_force", "onset_force_stderr"]] / 1e3
        if np.isfinite(onset):
            slope = 1e3 * group.loc["line", "C"] / force
            lines.append(f"{title}: onset eta0 D = {onset:.4g} ± {error:.2g} kN; line C/D = {slope:.4g} m/s per kN")
    about = (
        f"the threshold D is unknown, so that eta = P/{force / 1e3:.4g} kN, by the median of the mean force P. "
        "The data determine C and eta0 D of onset, C/D and eta0 D of line, the exponent and C/D^exponent of power:"
    )
    same = "  literal and percent have the curve of onset: D would be eta0 D, or 100 times as much"
    return [about, *_listed("", lines)[1:], *[same] * bool(lines)]


def _range_text(numbers: list[float]) -> str:
    """Return the least, the greatest and the median of values, or that there are none."""
    values = np.array(numbers)[np.isfinite(numbers)]
    if not len(values):
        return "is not defined, since no rate varies"
    low, middle, high = np.min(values), np.median(values), np.max(values)
    return f"{low:.4g}" if len(values) == 1 else f"{low:.4g} to {high:.4g} (median {middle:.4g})"
