"""The analysis `fit`: a summary of the law as text and as JSON, and a picture of the law with its data.

A *group* is a set of lanes with a law of its own; a *form* is a formula of the law.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from scipy.special import stdtrit

from vibrojax.errors import counted
from vibrojax.io.attributes import attribute_of, table_of
from vibrojax.io.log_columns import RATE
from vibrojax.io.riglog import LIMITS_OF_LOGS, is_log, log_lines
from vibrojax.physics.units import factor
from vibrojax.pictures.axes import in_units, margins, pretty_unit, scale, with_unit
from vibrojax.pictures.colours import form_colour
from vibrojax.pictures.contents import FORM, POINT, law_in, named_groups
from vibrojax.pictures.lines import MOST_ROWS, longest_axis, rows_of
from vibrojax.pictures.plots import (
    FAINT,
    Area,
    Axis,
    Dash,
    Layer,
    Line,
    Look,
    Plot,
    Sheet,
    bars,
    dots,
    key,
    level,
    patch,
    upright,
)
from vibrojax.pictures.sheet import Facets, at, facets
from vibrojax.pictures.style import IMPACT
from vibrojax.studies.analysis import Analysis, PictureRule, SummaryPart
from vibrojax.studies.rop_forms import AIC_LIMIT, BLOCK_LIMIT, FORMS, FORMULAS, LOGARITHMIC, SAME_AS_ONSET, Standing
from vibrojax.studies.rop_group import COEFFICIENTS, LEAST_DEGREES_OF_FREEDOM, Founder, founder_of, groups_of

_ONSET_STANDARD_ERRORS = 2.0  # by which an onset is below 1 before the verdict says so
_GROUPS_LISTED = 12
_PER_HOUR, _PER_STEP = 3600.0, 10e3  # the fall of the rate in m/h per 10 kN
_KEPT = ("undecided", "contains-chosen", "chosen")

_MARKS = dict(zip(("onset", "literal", "percent", "line", "power", "constant"), "os^DvP", strict=True))
# The power law often coincides with the straight line, the literal form with the onset form: dashed and on top, they
# leave the colour of the other form visible.
_DASHES: dict[str, Dash] = {"power": (0.0, (2.5, 2.0)), "literal": (0.0, (1.5, 2.5))}
_RATES = {form.name: form.rate for form in FORMS}
_USES: dict[str, tuple[str, Look]] = {
    "fitted": ("data", {"edge_width": 0.0}),
    "censored": ("no penetration (censored)", {"face": "white", "edge_width": 0.9}),
    "above-founder": ("above the founder weight", {"marker": "+", "edge_width": 0.7, "size": 5.0}),
    "left-out": ("left out of the fit", {"marker": "x", "colour": IMPACT, "edge_width": 1.2, "size": 5.0}),
}
_RELIEF, _RATE, _USE, _THRESHOLD = "data_relief", "data_rate_of_penetration", "data_use", "data_threshold"
_MOST_GROUPS, _MOST_COLUMNS = 6, 3
_ROW_HEIGHT, _ONE_HEIGHT, _FORMS_HEIGHT = 2.6, 3.6, 1.8  # of rows of groups, of a single group, of forms [inch]
_LEAST_WIDTH = 8.5
_MANY_LANES, _CLOUD = 60, 300  # lanes from which on the markers are small, and a faint cloud below the curves
_CURVE_POINTS = 200
_SHIFT = 0.012  # between forms at the same abscissa, as a fraction of the axis
_MOST_EVIDENCE = 30  # against a form, up to which it is drawn
_CHOSEN_SIZE = 7.0
_Limits = tuple[float | None, float | None]


# Text


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
    groups = dict(groups_of(fit))
    judged = {title: group for title, group in groups.items() if (group["standing"] != "not-compared").any()}
    unknown, by_blocks = "reference_force" in fit.attrs, bool(fit["cv_error"].notnull().any())
    missed = [group["reason"][group["aic"].isna()].iloc[:1] for title, group in groups.items() if title not in judged]
    reasons = pd.concat(missed).value_counts().sort_index() if missed else pd.Series(dtype=int)
    lines = []
    if lost := reasons.sum():
        counts = ", ".join(f"{reason} {count}" for reason, count in reasons.items())
        lines.append(f"not every form can be told in {lost} of {len(groups)}: {counts}")
    if short := len(missed) - lost:
        needed = f"at least {LEAST_DEGREES_OF_FREEDOM + 2} with a rate are needed"
        lines.append(f"too few lanes to compare the forms in {short} of {len(groups)}; {needed}")
    if not judged:
        return [*lines, "no form can be told from the lanes that are there"] + [LIMITS_OF_LOGS] * is_log(fit)
    how = "by the rates of each block of rows, predicted from the other blocks (CV)" if by_blocks else "by AIC"
    compared = [f"{title}: {_comparison(group)}" for title, group in judged.items()]
    lines += _listed(f"{how}, in {len(judged)} of {len(groups)}:", compared)
    if len(judged) > 1:
        together = str(fit.attrs["verdict"]).replace("none", "no single form")
        lines.append(f"all groups together: the data support {together}")
    kept = pd.DataFrame({title: group["standing"].isin(_KEPT) for title, group in judged.items()}).loc[[*LOGARITHMIC]]
    readings = "".join(f", as {name} in {count}" for name, count in kept.sum(axis=1).items() if count)
    lines.append(f"the log law holds in {kept.any().sum()} of {len(judged)}{readings}")
    onsets = [judged[title].loc["onset"] for title in kept.columns[kept.loc["onset"]]]
    early = [x["eta0"] for x in onsets if x["eta0"] + _ONSET_STANDARD_ERRORS * x["eta0_stderr"] < 1]
    if early and not unknown:
        ends = " to ".join(dict.fromkeys(f"{end:.4g}" for end in (min(early), max(early))))
        lines.append(
            f"the onset eta0 {ends} is below 1 in {len(early)} of {len(judged)}: penetration begins at a mean force P "
            "below D, as the peaks of the force exceed its mean; the literal form has no rate there"
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


def _comparison(group: pd.DataFrame) -> str:
    """Return the form that a group supports, or its rivals."""
    standing = group["standing"]
    chosen, rivals = str(standing.eq("chosen").idxmax()), list(standing.index[standing == "undecided"])
    if rivals:
        return f"these data cannot tell {chosen} from {', '.join(rivals)}"
    others = "every form that does not contain it" if (standing == "contains-chosen").any() else "the other forms"
    return f"the data support {chosen}, {FORMULAS[chosen]}, against {others}"


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


# The picture


def law_lines(fit: xr.Dataset) -> Sheet:
    """Draw C and the evidence against each form over the longest axis of the groups, below the data and their curves.

    C is that of the forms that the data do not reject. Without an axis, the panels of the data say C, and the evidence
    is drawn over the forms.
    """
    fit = _law_of(fit)
    if "reference_force" in fit.attrs:  # the threshold is unknown: some forms are the same curve as another one
        fit = fit.sel({FORM: [name for name in _names(fit) if name not in SAME_AS_ONSET]})
    by_blocks = "cv_error" in fit and bool(fit["cv_error"].notnull().any())
    x, names, limit = longest_axis(fit), _names(fit), BLOCK_LIMIT if by_blocks else AIC_LIMIT
    fit = fit.sortby(x.name) if x.is_number else fit
    panels, (factor, unit) = facets(fit, (POINT, x.name), MOST_ROWS), _rate_scale(fit, "C")
    known = factor * fit["C"].where(fit["standing"] != Standing.REJECTED).values
    low, high = (float(end(known[np.isfinite(known)], initial=0.0)) for end in (np.min, np.max))
    room = 0.15 * (high - low) or 1.0  # error bars do not count for the limits: they are huge for a failed fit
    of_c = Axis(with_unit("C", unit), "C", (low - room * (low < 0), high + room * (high > 0)), group="C")
    ticks = [(float(k), str(k)) for k in range(0, _MOST_EVIDENCE, 5)] + [(float(_MOST_EVIDENCE), f"≥{_MOST_EVIDENCE}")]
    limits = -1.0, 1.07 * _MOST_EVIDENCE
    of_evidence = Axis("evidence against the form", "evidence_against", limits, ticks=ticks, group="evidence")
    over_forms = Axis(ticks=[(float(k), name) for k, name in enumerate(names)], limits=(-0.5, len(names) - 0.5))
    across = x.axis(fit) if x.name else replace(over_forms, group="across")
    plots = []
    for row, (title, facet) in enumerate(panels):
        of_c_layers: list[Layer] = [level(0.0, colour=FAINT, width=0.8)]
        layers: list[Layer] = [Area([-np.inf, np.inf], [0.0] * 2, [limit] * 2, FAINT, 0.25)]
        kept = facet[["C", "C_stderr"]].where(facet["standing"] != Standing.REJECTED)
        for k, name in enumerate(names):
            form, dash = facet.sel({FORM: name}), "-" if x.is_number else ""
            places = x.of(facet) if x.name else np.array([float(k)])
            c, error = (factor * np.atleast_1d(kept[part].sel({FORM: name}).values) for part in ("C", "C_stderr"))
            beside = places + _SHIFT * k * (float(np.ptp(places)) if x.is_number else 4.0)
            error = np.nan_to_num(error, posinf=0.0)
            of_c_layers.append(Line(*bars(beside, c - error, c + error), form_colour(name), 0.9, marker="_"))
            of_c_layers.append(Line(beside, c, dash=dash, **_form_mark(name)))
            evidence = np.minimum(np.atleast_1d(form["evidence_against"].values), _MOST_EVIDENCE)
            layers.append(Line(places, evidence, dash=dash, **_form_mark(name)))
            chosen = np.atleast_1d(form["standing"].values) == Standing.CHOSEN
            layers.append(dots(places[chosen], evidence[chosen], **_form_mark(name) | {"size": _CHOSEN_SIZE}))
        plots += [Plot(of_c_layers, across, of_c, title, (row, 0), at(facet))] if x.name else []
        plots.append(Plot(layers, across, of_evidence, "" if x.name else title, (row, int(bool(x.name))), at(facet)))
    groups = _groups_to_show(fit)
    along = fit.attrs.get("along")
    count, way = fit["C"].size // fit.sizes[FORM], "over the rows of the table" if along == POINT else f"along {along}"
    notes = [panels.note, f"Data and curves of {len(groups)} of {count} groups" * (0 < len(groups) < count)]
    notes += [f"Fitted {way}; bars and bands of one standard error of C" * bool(along), LIMITS_OF_LOGS * is_log(fit)]
    rows = rows_of(panels, 1 + bool(x.name))
    keys: list[Layer] = [patch(FAINT, f"not rejected: up to {limit:g}", alpha=0.25, edge="")]
    keys.append(dots(label="chosen form", size=_CHOSEN_SIZE))
    if not x.is_number:
        rows["size"] = rows["size"][0], _FORMS_HEIGHT * len(panels) + (1.2 if x.name else 0.8)
    sheet = Sheet(plots, keys=[_form_keys(fit), keys], **rows, **margins(fit, *notes))
    return _below(groups, sheet, with_c=not x.name) if len(groups) else sheet


class Fits(Analysis):
    """The fit of the rate-of-penetration law to a sweep's dataset or to rig data."""

    kind = "fit"
    pictures = (PictureRule("law", lambda held: held.law and {"aic", "C_stderr"} <= held.variables, law_lines),)

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        return [SummaryPart("columns", log_lines(ds))]

    def page_cells(self, ds: xr.Dataset) -> tuple[xr.Dataset, None] | None:
        """Return the groups, with rates in the unit of the plots; None if a map shows them."""
        groups = named_groups(ds).drop_dims("lane", errors="ignore")
        groups = in_units(groups, {"m s-1": _rate_scale(ds, "C")} if is_log(ds) else {})
        return (groups, None) if groups["aic"].ndim < 3 else None

    def page_text(self, ds: xr.Dataset) -> list[SummaryPart]:
        return [SummaryPart("forms of the law", verdict(ds)), *self.summary(ds)]


def _names(fit: xr.Dataset) -> list[str]:
    return [str(name) for name in fit[FORM].values]


def _law_of(fit: xr.Dataset) -> xr.Dataset:
    """Return the fit with axes of length 1 as scalars, and with the comparison that version 0.1 did not store."""
    fit = law_in(fit)
    if "standing" in fit:
        return fit
    evidence = fit["aic"] - fit["aic"].min(FORM)
    kept = xr.where(evidence <= AIC_LIMIT, int(Standing.UNDECIDED), int(Standing.REJECTED))
    return fit.assign(evidence_against=evidence, standing=xr.where(evidence == 0, int(Standing.CHOSEN), kept))


def _rate_scale(fit: xr.Dataset, name: str) -> tuple[float, str]:
    """Return the factor and the unit of rates: m/h for logs, as drillers write them."""
    return (_PER_HOUR, "m/h") if is_log(fit) else scale(fit[name])


def _form_mark(name: str) -> Look:
    return {"colour": form_colour(name), "marker": _MARKS.get(name, "P")}


def _form_keys(fit: xr.Dataset) -> list[Layer]:
    """Return the legend entries of the forms, with their formulas."""
    keys: list[Layer] = []
    for name in _names(fit):
        formula = FORMULAS.get(name, "")
        for text, sign in {"eta0": "η₀", "eta": "η", " - ": " − ", "^exponent": "ⁿ"}.items():
            formula = formula.replace(text, sign)
        keys.append(key("\n".join(filter(None, (name, formula))), dash=_DASHES.get(name, "-"), **_form_mark(name)))
    return keys


def _groups_to_show(fit: xr.Dataset) -> Facets:
    """Return one facet per group, of at most six groups; no facets if the fit does not contain its data."""
    return facets(fit, (), _MOST_GROUPS) if {_RELIEF, _RATE, _USE} <= set(fit.data_vars) else Facets((), ())


def _below(groups: Facets, sheet: Sheet, with_c: bool) -> Sheet:
    """Return the sheet below a panel for each group, with the data and the fitted curve of each form.

    `with_c`: whether the titles say C of the form that the data support, if it has no rival.
    """
    wide = min(len(groups), _MOST_COLUMNS)
    deep = -(-len(groups) // wide)
    most = max(int(sum(mask.sum() for mask in _use_masks(group).values())) for group in groups.data)
    is_cloud, size = most >= _CLOUD, 4.2 if most < _MANY_LANES else 2.2 if most < _CLOUD else 1.6
    looks: dict[str, Look] = {use: {"size": size, "order": 3.0} | look for use, (_, look) in _USES.items()}
    if is_cloud:  # below the curves
        looks = {use: look | {"order": 1.5} for use, look in looks.items()}
        looks["fitted"] |= {"colour": FAINT}
    plots, outside = [], dict.fromkeys(_USES, 0)
    for k, (title, group) in enumerate(zip(groups.titles, groups.data, strict=True)):
        (factor, unit), (across_factor, text) = _rate_scale(group, _RATE), _force_scale(group)
        layers, right, top = _group_layers(group, factor, looks)
        places = np.stack([across_factor * group[_RELIEF].values, factor * group[_RATE].values], axis=-1)
        low, high = np.array([right, top], float).T  # NaN without limits
        for use, mask in _use_masks(group).items():
            outside[use] += int(((places < low) | (places > high))[mask].any(axis=1).sum())
        across = Axis(text if k + wide >= len(groups) else "", limits=right, group="force" if layers else "")
        up = Axis(with_unit("rate of penetration", unit) if k % wide == 0 else "", limits=top, zero="no penetration")
        standing = group["standing"].values
        if with_c and Standing.CHOSEN in standing and Standing.UNDECIDED not in standing:
            form = group.isel({FORM: int(np.argmax(standing))})
            c, error = (factor * float(form[name]) for name in ("C", "C_stderr"))
            title = "\n".join(filter(None, (title, f"C = {c:.3g} ± {error:.1g} {pretty_unit(unit)}")))
        plots.append(Plot(layers, across, up, title, divmod(k, wide), at(group)))
    shown = {use for group in groups.data for use in _use_masks(group)}
    texts = {use: text + f",\n{outside[use]} beyond the panel" * bool(outside[use]) for use, (text, _) in _USES.items()}
    keys = [dots(label=texts[use], **looks[use] | {"size": 4.5}) for use in _USES if use in shown]
    height = (_ROW_HEIGHT if len(groups) > 1 else _ONE_HEIGHT) * deep
    above = Sheet(plots, (6.4, height), (1.0,) * wide, (1.0,) * deep)
    size_of_all = max(sheet.size[0], _LEAST_WIDTH), sheet.size[1] + height
    return replace(sheet, above=above, size=size_of_all, keys=[*sheet.keys, keys])


def _group_layers(group: xr.Dataset, factor: float, looks: dict[str, Look]) -> tuple[list[Layer], _Limits, _Limits]:
    """Return the lanes of a group and the curve of each form up to the founder weight and above it, and the limits."""
    across, relief, rate = _force_scale(group)[0], group[_RELIEF].values, factor * group[_RATE].values
    masks = _use_masks(group)
    seen = np.any([np.zeros(relief.size, bool), *(mask for use, mask in masks.items() if use != "left-out")], axis=0)
    if not (seen & (relief > 0)).any():
        return [], (None, None), (None, None)
    low, high = relief[seen & (relief > 0)].min(), relief[seen].max()
    founder = float(group["founder_weight"]) if "founder_fall" in group and across != 1.0 else np.nan
    end = min(high, founder / (1e3 * across)) if np.isfinite(founder) else high
    eta, layers = np.linspace(low, end, _CURVE_POINTS), list[Layer]()
    for name, standing in zip(_names(group), group["standing"].values, strict=True):
        form, kept = group.sel({FORM: name}), standing != Standing.REJECTED
        values = [float(form[part]) if part in form else np.nan for part in COEFFICIENTS]
        if name not in _RATES or not np.isfinite(values[0]):
            continue
        curve, dash = _RATES[name](eta, *values), _DASHES.get(name, "-")
        look: Look = {"colour": form_colour(name), "width": 1.4, "dash": dash, "order": 2.5 if name in _DASHES else 2.0}
        layers.append(Line(across * eta, factor * curve, **look))
        if kept:  # every form is proportional to its C
            error = factor * curve * float(form["C_stderr"] / form["C"])
            layers.append(Area(across * eta, factor * curve - error, factor * curve + error, form_colour(name), 0.15))
        if kept and end < high:
            fall = factor * float(group["founder_fall"]) * 1e3 * across * (high - end)
            layers.append(Line([across * end, across * high], factor * curve[-1] - np.array([0.0, fall]), **look))
    if end < high:
        layers.append(upright(across * end, dash=":", width=1.0, label="founder weight"))
    layers += [dots(across * relief[mask], rate[mask], **looks[use]) for use, mask in masks.items()]
    room, top = 0.04 * (high - low or high), float(rate[seen].max())
    right = across * (low - room), across * (high + room)  # without weights beyond reason
    # The limits clip the curve of a form far from the data.
    return layers, right, (-0.06 * top, 1.1 * top) if top > 0 else (None, None)


def _force_scale(group: xr.Dataset) -> tuple[float, str]:
    """Return the factor from the relief to the abscissa, and its label: the mean force in kN where it is known."""
    threshold = float(group[_THRESHOLD]) if _THRESHOLD in group else np.nan
    return (threshold / 1e3, "mean force [kN]") if np.isfinite(threshold) else (1.0, "relief P/D")


def _use_masks(group: xr.Dataset) -> dict[str, np.ndarray]:
    """Return a mask of the drawable lanes (finite relief and rate) for each use that occurs."""
    meanings = str(group[_USE].attrs["flag_meanings"]).split()
    known = np.isfinite(group[_RELIEF].values) & np.isfinite(group[_RATE].values)
    masks = {name: known & (group[_USE].values == meanings.index(name)) for name in _USES if name in meanings}
    return {name: mask for name, mask in masks.items() if mask.any()}
