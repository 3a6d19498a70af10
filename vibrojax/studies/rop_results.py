"""The analysis `fit`: a summary of the law as text and as JSON, and a picture of the law with its data.

A *group* is a set of lanes with a law of its own; a *form* is a formula of the law.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from scipy.special import stdtrit

from vibrojax.errors import counted
from vibrojax.io.attributes import attribute_of, flags, table_of
from vibrojax.io.log_columns import RATE
from vibrojax.io.riglog import LIMITS_OF_LOGS, is_log, log_lines
from vibrojax.physics.units import factor
from vibrojax.pictures.axes import in_units, margins, number, pretty_unit, scale, with_unit
from vibrojax.pictures.colours import form_colour, value_axis, value_of
from vibrojax.pictures.contents import FORM, POINT, law_in, named_groups
from vibrojax.pictures.layout import LEGEND_WIDTH, STACK_MARGINS, at, facets, is_narrow, stacked
from vibrojax.pictures.lines import Series, curves, longest_axis, row_per_facet, value_lines
from vibrojax.pictures.plots import FAINT, Area, Axis, Key, Layer, Line, Look, Plot, Sheet, bars, dots, key, upright
from vibrojax.pictures.style import IMPACT
from vibrojax.studies.analysis import Analysis, PictureRule, SummaryPart
from vibrojax.studies.rop_forms import AIC_LIMIT, BLOCK_LIMIT, FORMS, FORMULAS, LOGARITHMIC, SAME_AS_ONSET, Standing
from vibrojax.studies.rop_group import COEFFICIENTS, LEAST_DEGREES_OF_FREEDOM, Founder

_ONSET_STANDARD_ERRORS = 2.0  # by which an onset is below 1 before the verdict says so
_GROUPS_LISTED = 12
LEAST_COMPARED = max(form.size for form in FORMS) + LEAST_DEGREES_OF_FREEDOM
_PER_HOUR, _PER_STEP = 3600.0, 10e3  # the fall of the rate in m/h per 10 kN
_PER_HOUR_OF_LOGS = {"m s-1": (_PER_HOUR, "m/h")}  # as drillers write rates
_KEPT = ("undecided", "contains-chosen", "chosen")

# The power law often coincides with the straight line, the literal form with the onset form: dashed and on top, they
# leave the colour of the other form visible.
_DASHES: dict[str, Any] = {"power": (0.0, (2.5, 2.0)), "literal": (0.0, (1.5, 2.5))}
_USES: dict[str, tuple[str, Look]] = {
    "fitted": ("data", {"edge_width": 0.0}),
    "censored": ("no penetration (censored)", {"face": "white", "edge_width": 0.9}),
    "above-founder": ("above the founder weight", {"marker": "+", "edge_width": 0.7, "size": 5.0}),
    "left-out": ("left out of the fit", {"marker": "x", "colour": IMPACT, "edge_width": 1.2, "size": 5.0}),
}
_CHOSEN: Look = {"size": 9.0, "face": "none", "edge_width": 1.2, "clip": False}  # a ring around the point of the form
_MOST_GROUPS, _MOST_COLUMNS = 6, 3
_PANEL_WIDTH, _PANEL_HEIGHT = 2.6, 2.8  # of a group [inch]
_CLOUD = 100  # lanes of a group from which on they are a faint cloud below the curves
_CURVE_POINTS = 200
Cell = tuple[int, int]  # row and column of a panel
_MOST_EVIDENCE = 30.0  # against a form, up to which it is drawn


# Text


def groups_of(fit: xr.Dataset) -> dict[str, pd.DataFrame]:
    """Return a table of the forms for each group by the group's name, such as "force=200000 N, rock=granite"."""
    dims = [dim for dim in fit["aic"].dims if dim != FORM]
    whole = fit.drop_dims([dim for dim in fit.dims if dim not in (*dims, FORM)])
    table = whole.to_dataframe(dim_order=[*dims, FORM]).reset_index()
    for name in ("reason", "r_squared_reason", "standing"):
        table[name] = table[name].map(flags(fit[name]))
    names = [name for name in table if name in dims or (name in fit.coords and name != FORM and fit[name].dims)]
    # A dimension without values of its own has a name only if nothing else distinguishes its groups.
    named = {dim for name in names if name in fit.coords for dim in fit[name].dims}
    units = {name: fit[name].attrs.get("units", "1") for name in names if name in fit.coords or name not in named}
    groups = {}
    for _, part in table.groupby(np.arange(len(table)) // fit.sizes[FORM]):
        values = {name: part[name].iloc[0] for name in units}
        texts = [f"{name}={f'{x:.6g}' if isinstance(x, float) else x} {units[name]}" for name, x in values.items()]
        groups[", ".join(text.removesuffix(" 1") for text in texts) or "all lanes"] = part.set_index(FORM)
    return groups


def law_facts(fit: xr.Dataset) -> dict[str, Any]:
    """Return the summary of a fit as a dictionary of JSON values: of each group, the values of every form.

    **Arguments:** `fit`: a dataset that `fit_rop` returned.
    """
    of_forms, groups = [str(name) for name, x in fit.items() if FORM in x.dims], list[dict[str, Any]]()
    for title, group in groups_of(fit).items():
        first = group.iloc[:1].to_dict("records")[0]
        coordinates = {str(name): first[str(name)] for name in fit.coords if name in first}
        groups.append({"name": title, "coordinates": coordinates, "forms": group[of_forms].to_dict("index")})
        groups[-1] |= {f"founder_{name}": float(first[f"founder_{name}"]) for name in Founder._fields[:4]}
        groups[-1] |= {"recommended": recommended(fit, group)}
    facts: dict[str, Any] = {"along": str(fit.attrs["along"]), "columns": table_of(fit, "columns") or None}
    if "dialect" in fit.attrs:
        facts |= {name: attribute_of(fit, name) for name in ("dialect", "rows_read", "dropped", "notes")}
        facts["left_out_rows"] = table_of(fit, "left_out_rows")
    return {**facts, "groups": groups, "supported": str(fit.attrs["verdict"]), "verdict": verdict(fit)}


def tables(fit: xr.Dataset) -> list[str]:
    """Return lines of text: a table of the forms for each of the first groups, then the number of other groups."""
    lines: list[str] = []
    groups = groups_of(fit)
    for title, group in list(groups.items())[:_GROUPS_LISTED]:
        first = group.iloc[0]
        left_out = f", {first['left_out']} left out" if first["left_out"] else ""
        lines += ["", f"{title}: {counted(first['used'], 'lane')} along {fit.attrs['along']}{left_out}"]
        if group["C"].isna().all() and group["reason"].nunique() == 1:
            lines[-1] += f": {first['reason']}"
            continue
        shown = pd.DataFrame(index=group.index.rename(None))
        for name, text in zip(COEFFICIENTS, ("C [m/s]", "η₀", "exponent n"), strict=True):
            pairs = zip(group[name], group[f"{name}_stderr"], strict=True)
            shown[text] = [f"{value:.4g} ± {error:.2g}" if np.isfinite(value) else "" for value, error in pairs]
        for name, text, digits in (("r_squared", "R2", ".4f"), ("aic", "AIC", ".2f"), ("cv_error", "CV [m/s]", ".4g")):
            if name != "cv_error" or group[name].notna().any():
                shown[text] = [f"{value:{digits}}" if np.isfinite(value) else "" for value in group[name]]
        # Why values are missing, and whether the blocks of rows of a log support the form.
        remarks = group[["reason", "r_squared_reason"]].replace("identified", "")
        is_kept = group["cv_error"].notna() & group["standing"].isin(["chosen", "undecided"])
        remarks = remarks.assign(standing=group["standing"].where(is_kept, ""))
        shown[""] = [", ".join(dict.fromkeys(filter(None, row))) for row in remarks.to_numpy()]
        lines += [f"  {line}".rstrip() for line in shown.rename_axis(columns="form").to_string().splitlines()]
    return lines[1:] + [f"and {counted(len(groups) - _GROUPS_LISTED, 'group')} more"] * (len(groups) > _GROUPS_LISTED)


def _listed(title: str, lines: Mapping[str, str]) -> list[str]:
    """Return a title above the texts of the first groups and the number of further ones; nothing without texts."""
    more = [f"and {counted(len(lines) - _GROUPS_LISTED, 'group')} more"] * (len(lines) > _GROUPS_LISTED)
    texts = [f"  {group}: {text}" for group, text in lines.items()][:_GROUPS_LISTED]
    return [title, *texts, *more] if texts else []


def recommended(fit: xr.Dataset, group: pd.DataFrame) -> dict[str, Any] | None:
    """Return the recommended C of a group, or None if there is none.

    For a log whose forms were compared over blocks of rows, the recommended C belongs to the form that the data
    support. Otherwise it belongs to the likeliest reading of the log law, if this reading is not rejected and C is
    positive.

    The dictionary holds `form`, `C` [m/s] and the ends `low` and `high` of its 95 % interval [m/s], by Student's
    distribution. With rig data, it also holds the `unit` of the rate in the data, and the three values in this unit
    (`in_unit`).
    """
    standing, form = group["standing"], str(group["standing"].eq("chosen").idxmax())
    if group["cv_error"].isna().all() or (standing == "undecided").any():
        form = min(LOGARITHMIC, key=lambda name: np.nan_to_num(group["evidence_against"][name], nan=np.inf))
    values = group.loc[form]
    if values["standing"] not in _KEPT or values["reason"] != "identified" or values["C"] <= 0:
        return None
    if form in SAME_AS_ONSET and standing["constant"] in ("chosen", "undecided"):
        return None  # the rate does not depend on the force: C of such a form is a convention
    c, half = float(values["C"]), float(stdtrit(values["degrees_of_freedom"], 0.975) * values["C_stderr"])
    interval = {"C": c, "low": c - half, "high": c + half}
    unit = str(table_of(fit, "columns").get(RATE, {}).get("unit", "m/s"))
    scale = factor(unit, "m s-1") or 1.0
    in_unit = {"unit": unit, "in_unit": {name: value / scale for name, value in interval.items()}}
    return {"form": form, **interval, **(in_unit if scale != 1 else {})}


def verdict(fit: xr.Dataset) -> list[str]:
    """Return lines of text: the form that describes the data best, the founder weight, and the recommended C.

    The log law is not rejected if one of its three readings, with a slope, is not.

    **Arguments:** `fit`: a dataset that `fit_rop` returned.
    """
    groups = groups_of(fit)
    judged = {title: group for title, group in groups.items() if (group["standing"] != "not-compared").any()}
    force, by_blocks = float(fit.attrs.get("reference_force", np.nan)), bool(fit["cv_error"].notnull().any())
    lines, limits = [], [LIMITS_OF_LOGS] * is_log(fit)
    if missed := [group for title, group in groups.items() if title not in judged]:
        unfitted = (group["reason"][group["aic"].isna()] for group in missed)
        reasons = pd.Series([[*each[each != "unknown-threshold"], "too-few-lanes"][0] for each in unfitted])
        counts = ", ".join(f"{reason} {count}" for reason, count in reasons.value_counts().sort_index().items())
        needed = f" ({LEAST_COMPARED} lanes with a rate are needed)" * ("too-few-lanes" in reasons.to_numpy())
        lines.append(f"not every form can be told in {len(missed)} of {len(groups)}: {counts}{needed}")
    if not judged:
        return [*lines, "no form can be told from the lanes that are there", *limits]
    how = "by the rates of each block of rows, predicted from the other blocks (CV)" if by_blocks else "by AIC"
    compared = {}
    for title, group in judged.items():
        standing = group["standing"]
        chosen, rivals = str(standing.eq("chosen").idxmax()), list(standing.index[standing == "undecided"])
        others = "every form that does not contain it" if (standing == "contains-chosen").any() else "the other forms"
        compared[title] = f"the data support {chosen}, {FORMULAS[chosen]}, against {others}"
        if rivals:
            compared[title] = f"these data cannot tell {chosen} from {', '.join(rivals)}"
        elif not (standing == "rejected").any():
            compared[title] = f"these data reject no form, of which {chosen} has the fewest coefficients"
    lines += _listed(f"{how}, in {len(judged)} of {len(groups)}:", compared)
    if len(judged) > 1:
        together = str(fit.attrs["verdict"]).replace("none", "no single form")
        lines.append(f"all groups together: the data support {together}")
    log_laws = pd.concat(judged).loc[pd.IndexSlice[:, list(LOGARITHMIC)], :]
    kept = log_laws[log_laws["standing"].isin(_KEPT) & (log_laws["reason"] == "identified")].reset_index(FORM)
    in_groups = kept[FORM].value_counts().reindex(LOGARITHMIC).dropna().astype(int)
    readings = "".join(f", as {name} in {count}" for name, count in in_groups.items())
    lines.append(f"the log law is not rejected in {kept.index.nunique()} of {len(judged)}{readings}")
    early = kept["eta0"][kept["eta0"] + _ONSET_STANDARD_ERRORS * kept["eta0_stderr"] < 1]
    if early.size and np.isnan(force):
        ends = " to ".join(dict.fromkeys(f"{end:.4g}" for end in (early.min(), early.max())))
        lines.append(
            f"the onset η₀ {ends} is below 1 in {len(early)} of {len(judged)}: penetration begins at a mean force P "
            "below D, as the peaks of the force exceed its mean; the literal form has no rate there"
        )
    weights, onsets, choices = {}, {}, {}
    for title, group in groups.items():
        founder = Founder(*(float(group[f"founder_{name}"].iloc[0]) for name in Founder._fields[:4]))
        if founder.is_known:
            fall, error = (_PER_HOUR * _PER_STEP * value for value in (founder.fall, founder.fall_stderr))
            above = f"falls by {fall:.3g} ± {error:.2g} m/h per 10 kN" if founder.falls else "does not rise"
            weight = f"{founder.weight / 1e3:.4g} ± {founder.weight_stderr / 1e3:.3g} kN"
            weights[title] = f"{weight}; above it the rate {above}"
        if "onset_force" in group and np.isfinite(group.loc["onset", "onset_force"]):
            onset, error = group.loc["onset", ["onset_force", "onset_force_stderr"]] / 1e3
            slope = f"line C/D = {1e3 * group.loc['line', 'C'] / force:.4g} m/s per kN"
            onsets[title] = f"onset η₀D = {onset:.4g} ± {error:.3g} kN; {slope}"
        if choice := recommended(fit, group):
            scales = [(choice, "m/s"), *([(choice["in_unit"], choice["unit"])] if "unit" in choice else [])]
            texts = [f"{x['C']:.4g} {unit} ({x['low']:.4g} to {x['high']:.4g})" for x, unit in scales]
            choices[title] = f"C = {' = '.join(texts)}, {choice['form']}"
    lines += _listed("founder weight; the coefficients of every form are of the rows below it:", weights)
    rows = table_of(fit, "left_out_rows").items()
    lines += [f"left out, {reason}: {counted(about['rows'], 'row')} (line {about['lines']})" for reason, about in rows]
    if np.isfinite(force):
        about = (
            f"the threshold D is unknown, so that η = P/{force / 1e3:.4g} kN, by the median of the mean force P. The "
            "data determine C and η₀D of onset, C/D and η₀D of line, n and C/Dⁿ of power:"
        )
        same = "  literal and percent have the curve of onset: D would be η₀D, or 100 times as much"
        lines += [*_listed(about, onsets), same] if onsets else [about]
    how = ", by blocks of rows), of the form that the data support, or else" if by_blocks else "),"
    title = f"recommended C (95 % interval{how} of the likeliest reading of the log law:"
    return [*lines, *limits, *_listed(title, choices)]


# The picture


def law_lines(fit: xr.Dataset) -> Sheet:
    """Draw the data and curves of each group; below, C and the evidence over the longest axis of the groups.

    C is that of the forms that the data do not reject. Version 0.1 stored neither data nor evidence: C is drawn.
    """
    fit = law_in(fit)
    if "standing" not in fit:
        return curves(fit, ["C"])
    if "reference_force" in fit.attrs:  # the threshold is unknown: some forms are the same curve as another one
        fit = fit.sel({FORM: [name for name in fit[FORM].values if name not in SAME_AS_ONSET]})
    groups, count = facets(fit, (), 4 if is_narrow() else _MOST_GROUPS), fit["C"].size // fit.sizes[FORM]
    columns = 2 - len(groups) % 2 if is_narrow() else _MOST_COLUMNS
    along = "the rows of the table" if fit.attrs["along"] == POINT else fit.attrs["along"]
    limit = BLOCK_LIMIT if fit["cv_error"].notnull().any() else AIC_LIMIT
    force = float(fit.attrs.get("reference_force", np.nan))
    strong = bool((fit["evidence_against"] > _MOST_EVIDENCE).any())
    notes = [
        f"Data and curves of {len(groups)} of {count} groups" * (len(groups) < count),
        f"Fitted along {along}; bars and bands of one standard error of C; a C below its standard error is left out",
        "η = P/D, " + ("the mean force over the threshold" if np.isnan(force) else f"where D is {force / 1e3:.4g} kN"),
        f"Evidence above {limit:g} rejects a form" * bool(fit["evidence_against"].notnull().any()),
        f"Evidence above {_MOST_EVIDENCE:g} is drawn at {_MOST_EVIDENCE:g}" * (longest_axis(fit).name != "" and strong),
        LIMITS_OF_LOGS * is_log(fit),
    ]
    is_cloud = fit["data_use"].sizes["lane"] >= _CLOUD  # many lanes are small and faint, below the curves
    look = Look(size=1.6, order=1.5, colour=FAINT) if is_cloud else Look(size=4.2, order=3.0)
    looks = {use: look | about for use, (_, about) in _USES.items()}
    c_unit = (_PER_HOUR, "m/h") if is_log(fit) else scale(fit["C"])
    places = groups.places(columns)
    deep, wide = (1 + max(ends) for ends in zip(*places, strict=True))
    plots = [
        _group_plot(group, title, (row, column), (row + 1, column) not in places, looks, c_unit)
        for (row, column), (title, group) in zip(places, groups, strict=True)
    ]
    used = {flag for group in groups.data for flag in np.unique(group["data_use"])}
    uses = [name for flag, name in flags(fit["data_use"]).items() if flag in used and name in _USES]
    keys: list[list[Key]] = [[], [dots(label=_USES[use][0], **looks[use] | {"size": 4.5}) for use in uses]]
    for name in map(str, fit[FORM].values):
        formula, of = FORMULAS[name], fit.sel({FORM: name}).squeeze()
        if len(groups) == 1 and np.isfinite(against := float(f"{float(of['evidence_against']):.3g}")):
            is_chosen = int(of["standing"]) == Standing.CHOSEN
            formula += "\nchosen" if is_chosen else f"\nevidence against {number(against)}"
        keys[0].append(key(f"{name}: {formula}", dash=_DASHES.get(name, "-"), colour=form_colour(name)))
    size = max(_PANEL_WIDTH * wide, 4.5) + LEGEND_WIDTH, _PANEL_HEIGHT * deep + STACK_MARGINS
    above, x = Sheet(plots, size, keys=keys, **margins(fit, *notes)), longest_axis(fit)
    if not x.name:
        return above
    shown = fit.sortby(x.name) if x.is_number else fit
    shown = in_units(shown, _PER_HOUR_OF_LOGS if is_log(fit) else {})
    # A C below its standard error is not determined, and would stretch the axis.
    unknown = np.isfinite(shown["C_stderr"]) & (shown["C_stderr"] > abs(shown["C"]))
    is_kept = (shown["standing"] != Standing.REJECTED) & ~unknown
    kept_c = {name: shown[name].where(is_kept) for name in ("C", "C_stderr")}
    shown = shown.assign(kept_c | {"evidence_against": np.minimum(shown["evidence_against"], _MOST_EVIDENCE)})

    def draw(lines: list[Series], name: str) -> Plot:
        value = value_of(shown[name])
        layers = value_lines(lines, value, x.of, x.dash(shown))
        for _, colour, lanes in lines * (name == "C"):
            c, error = (value.factor * np.ravel(lanes[part].values) for part in ("C", "C_stderr"))
            error = np.nan_to_num(error, posinf=0.0)
            layers.append(Line(*bars(x.of(lanes), c - error, c + error), colour, 0.9, marker="_"))
        if name == "evidence_against":
            kept = f"not rejected: up to {limit:g}"
            layers.append(Area([-np.inf, np.inf], [0.0, 0.0], [limit, limit], FAINT, 0.25, label=kept))
            for *_, lanes in lines:
                chosen = np.where(np.ravel(lanes["standing"]) == Standing.CHOSEN, np.ravel(lanes[name]), np.nan)
                layers.append(dots(x.of(lanes), chosen, **_CHOSEN))
        return Plot(layers, x.axis(shown), value_axis(value, group="" if name == "C" else name))

    keys[1].insert(0, dots(label="chosen form", **_CHOSEN))
    draws = [lambda lines: draw(lines, "C"), lambda lines: draw(lines, "evidence_against")]
    sheet = row_per_facet(shown, x, FORM, draws, keys, *notes)
    return stacked(above, sheet)


def _group_plot(
    group: xr.Dataset, title: str, place: Cell, is_last: bool, looks: dict[str, Look], c_unit: tuple[float, str]
) -> Plot:
    """Draw the lanes of a group, and the curve of each form up to the founder weight and above it.

    `c_unit`: factor and name of the unit of C, in which all groups print it.
    """
    scale_of_rate, unit = (_PER_HOUR, "m/h") if is_log(group) else scale(group["data_rate_of_penetration"])
    threshold = float(group["data_threshold"])  # the mean force in kN is the abscissa where it is known
    across, text = (threshold / 1e3, "mean force [kN]") if np.isfinite(threshold) else (1.0, "relief P/D")
    relief, rate = group["data_relief"].values, scale_of_rate * group["data_rate_of_penetration"].values
    known, use = np.isfinite(relief) & np.isfinite(rate), group["data_use"].values
    masks = {name: known & (use == flag) for flag, name in flags(group["data_use"]).items() if name in _USES}
    seen = known & (relief > 0) & ~masks["left-out"]
    layers: list[Layer] = [dots(across * relief[x], rate[x], **looks[use]) for use, x in masks.items() if x.any()]
    axes = Axis(text * is_last, intervals=6), Axis(with_unit("rate of penetration", unit) * (place[1] == 0))
    if not seen.any():
        return Plot(layers, *axes, title, place, at(group))
    low, high, founder = relief[seen].min(), relief[seen].max(), float(group["founder_weight"]) / threshold
    end = founder if founder < high else high
    eta = np.linspace(low, end, _CURVE_POINTS)
    for form in (form for form in FORMS if form.name in group[FORM].values):
        of = group.sel({FORM: form.name})
        values, dash = [float(of[part]) for part in COEFFICIENTS], _DASHES.get(form.name, "-")
        curve = scale_of_rate * form.rate(eta, *values)
        look: Look = {"colour": form_colour(form.name), "width": 1.4, "dash": dash, "order": 2.0 + 0.5 * (dash != "-")}
        layers.append(Line(across * eta, curve, **look))
        if int(of["standing"]) == Standing.REJECTED:
            continue
        error = curve * float(of["C_stderr"]) / values[0]  # every form is proportional to its C
        layers.append(Area(across * eta, curve - error, curve + error, form_colour(form.name), 0.15))
        if end < high:
            fall = scale_of_rate * float(group["founder_fall"]) * threshold * (high - end)
            layers.append(Line([across * end, across * high], [curve[-1], curve[-1] - fall], **look))
        if int(of["standing"]) == Standing.CHOSEN and not (group["standing"] == Standing.UNDECIDED).any():
            c, half = (c_unit[0] * float(of[part]) for part in ("C", "C_stderr"))
            title = f"{title}\nC = {c:.3g} ± {number(float(f'{half:.1g}'))} {pretty_unit(c_unit[1])}".strip()
    if end < high:
        layers.append(upright(across * end, dash=":", width=1.0, label="founder weight"))
    # Neither weights beyond reason nor the curve of a form far from the data stretch the axes.
    room, top = 0.04 * (high - low or high), float(rate[seen].max())
    below = 0.06 * top * float((rate[seen] <= 0).any())  # markers at zero are whole
    right, up = (across * (low - room), across * (high + room)), (-below, 1.1 * top)
    is_within = [(x >= low) & (x <= high) for x, (low, high) in ((across * relief, right), (rate, up))]
    if beyond := int((known & ~np.all(is_within, axis=0)).sum()):
        axes = replace(axes[0], label=f"{text}\n{counted(beyond, 'row')} outside the panel"), axes[1]
    shown = replace(axes[0], limits=right), replace(axes[1], limits=up if top > 0 else (-0.06, 1.0))
    return Plot(layers, *shown, title, place, at(group))


class Fits(Analysis):
    """The fit of the rate-of-penetration law to a sweep's dataset or to rig data."""

    kind = "fit"
    pictures = (PictureRule("law", lambda held: held.law and {"aic", "C_stderr"} <= held.variables, law_lines),)

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        return [SummaryPart("columns", log_lines(ds))]

    def page_cells(self, ds: xr.Dataset) -> tuple[xr.Dataset, None] | None:
        """Return the groups, with rates in the unit of the plots; None if a map shows them."""
        groups = in_units(named_groups(ds).drop_dims("lane", errors="ignore"), _PER_HOUR_OF_LOGS if is_log(ds) else {})
        return (groups, None) if groups["aic"].ndim < 3 else None

    def page_text(self, ds: xr.Dataset) -> list[SummaryPart]:
        return [SummaryPart("forms of the law", verdict(ds)), *self.summary(ds)]
