"""The analysis `study`: the picture of Sobol indices and interactions, and a sentence for each parameter and pair."""

from collections.abc import Mapping
from itertools import combinations
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.colors import Normalize

from vibrojax.errors import counted
from vibrojax.io.variables import Variable
from vibrojax.maps.run import lanes_beside, run_sweep
from vibrojax.pictures.axes import margins, pretty_unit, scale
from vibrojax.pictures.plots import FAINT, INK, Axis, Bars, Cells, Layer, Line, Plot, Sheet, Text, bars, upright
from vibrojax.pictures.style import BIT
from vibrojax.studies.analysis import PictureRule, SummaryPart
from vibrojax.studies.effects_run import SCHEMA, study_of
from vibrojax.studies.effects_sampling import REASONS
from vibrojax.studies.effects_spec import SHARE, Study, read_study
from vibrojax.studies.subjects import FileAnalysis

MIN_SHARE = 0.05
"""Share of the variance below which a parameter or a pair counts as unimportant."""

WIDE = 0.3
"""Half-width of a confidence interval above which the summary recommends more samples."""

CURVED = 0.5
"""Ratio of an effect to that of a straight line with the same variance below which the summary calls it not steady."""

NEGLIGIBLE = 1e-3
"""Effect, relative to the standard deviation, below which the summary says that it hardly changes the variable."""

_MAX_ROWS = 4
_BAR = 0.38  # height of a bar; two stand at each parameter


def bars_and_interactions(ds: xr.Dataset) -> Sheet:
    """Draw first-order and total indices with confidence intervals, and a heat map of the interactions of pairs.

    There is one row per variable, four at most.
    """
    of = [str(name) for name in ds["of"].values][:_MAX_ROWS]
    size = 9.0, len(of) * max(1.9, 0.8 + 0.26 * ds.sizes["parameter"]) + 0.8
    greatest = float(np.nanmax(ds["second_order"].values, initial=MIN_SHARE))
    plots = []
    for k, name in enumerate(of):
        row = ds.sel(of=name)
        plots.append(_share_plot(row, k, "share of the variance" if name == of[-1] else ""))
        plots.append(_pair_plot(row, k, greatest))
    rest = ds.sizes["of"] - len(of)
    further = counted(rest, "further variable is", "further variables are") + " not drawn" if rest else ""
    level = f"{100 * float(ds.attrs.get('confidence', 0.95)):.0f} %"
    about = f"Lines: intervals of {level} confidence; pairs within theirs of 0 have no number"
    return Sheet(plots, size, (1.5, 1.0), (1.0,) * len(of), **margins(ds, about, further))


def _share_plot(row: xr.Dataset, k: int, label: str) -> Plot:
    names = [str(name) for name in row["parameter"].values]
    places = np.arange(len(names), dtype=float)
    layers: list[Layer] = [upright(0.0, width=0.6)]
    looks = (-_BAR / 2, "first_order", BIT, "alone"), (_BAR / 2, "total_order", FAINT, "with all its\ninteractions")
    for shift, key, colour, text in looks:
        values, errors = row[key].values, np.nan_to_num(row[f"{key}_conf"].values)
        bottom = places + shift - _BAR / 2
        layers.append(Bars(np.zeros(len(names)), bottom, values, np.full(len(names), _BAR), colour, label=text))
        layers.append(Line(*bars(places + shift, values - errors, values + errors)[::-1], width=0.8))
    if int(row["sobol_reason"]) != REASONS.index("known"):
        layers.append(Text(0.5, 0.5, _why(row), relative=True))
    up = Axis(ticks=[*zip(places.tolist(), names, strict=True)], reversed=True)
    return Plot(layers, Axis(label), up, _title(row), (k, 0), grid="x")


def _pair_plot(row: xr.Dataset, k: int, greatest: float) -> Plot:
    """Draw the lower triangle of second-order indices; pairs within their confidence interval of 0 have no number."""
    names = [str(name) for name in row["parameter"].values]
    values, errors = (row[key].values for key in ("second_order", "second_order_conf"))
    lower = np.where(np.tri(len(names), k=-1, dtype=bool), np.maximum(values, 0.0), np.nan)
    ends = np.arange(len(names) + 1) - 0.5
    layers: list[Layer] = [Cells(ends, ends, lower, colormaps["Blues"], Normalize(0.0, greatest), hatched=False)]
    for i, j in zip(*np.nonzero(values > errors), strict=True):
        if j < i:
            colour = "#FFFFFF" if lower[i, j] > 0.6 * greatest else INK
            layers.append(Text(float(j), float(i), f"{100 * values[i, j]:.0f}", colour=colour, size=7.5))
    ticks = [(float(place), name) for place, name in enumerate(names)]
    across, up = Axis(ticks=ticks, rotated=True), Axis(ticks=ticks, reversed=True)
    return Plot(layers, across, up, "interactions of pairs [%]", (k, 1))


def _title(row: xr.Dataset) -> str:
    factor, unit = _scale(row)
    mean, std = (factor * float(f"{float(row[key]):.{digits}g}") for key, digits in (("mean", 3), ("std", 2)))
    amount = f"{mean:.6g} ± {std:.6g} {pretty_unit(unit)}"
    return f"{_words(row)}: {amount.strip()}"


def _words(row: xr.Dataset) -> str:
    return "share of single impacts" if str(row["of"].item()) == SHARE else str(row["of"].item()).replace("_", " ")


def _scale(row: xr.Dataset) -> tuple[float, str]:
    """Return the factor and the unit in which a row's variable is printed."""
    values = np.array([float(row["mean"]), float(row["std"]), *np.abs(np.nan_to_num(row["effect"].values))])
    return scale(xr.DataArray(values, attrs={"units": str(row["of_unit"].item())}))


def _why(row: xr.Dataset) -> str:
    return {"constant": "it is the same everywhere", "too-few-samples": "too few samples have a value"}.get(
        REASONS[int(row["sobol_reason"])], ""
    )


class Studies(FileAnalysis[Study]):
    """Find which parameters decide about a machine: effects, interactions and Sobol indices; FILE is a study (TOML)."""

    kind = "study"
    variables: ClassVar[dict[str, Variable]] = {name: about for name, (_, about) in SCHEMA.items()}
    pictures = (PictureRule("effects", lambda held: "first_order" in held.variables, bars_and_interactions),)
    view = "plots"

    about = "a study: a bundled name, like drill, or the path of a TOML file"
    chunks = True

    def asked(self, file: Any, columns: Mapping[str, str] | None = None) -> Study:
        return read_study(file)

    def identity(self, asked: Study) -> dict[str, object]:
        return asked.identity()

    def compute(self, asked: Study, progress: bool = True) -> xr.Dataset:
        return study_of(asked, run_sweep(asked.sweep, progress=progress))

    def compute_beside(self, asked: Study, out: Path, resume: bool, progress: bool) -> xr.Dataset:
        with lanes_beside(asked.sweep, out, resume=resume, progress=progress) as lanes:
            return study_of(asked, lanes)

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        """Return a sentence for each parameter and each important pair of parameters, and the lanes treated by rule."""
        facts: dict[str, object] = {}
        lines: list[str] = []
        for name in (str(x) for x in ds["of"].values):
            row = ds.sel(of=name)
            sentences = _sentences(row)
            facts[name] = _facts(row) | {"sentences": sentences}
            lines += [f"{_title(row)} over {counted(int(ds.attrs.get('samples', 0)), 'sample')}"]
            lines += [f"  {sentence}" for sentence in (*sentences, *_rule_lines(row))]
        if SHARE in ds:
            lines.append(f"{100 * float(ds[SHARE]):.0f} % of the lanes have a single impact")
            facts[SHARE] = float(ds[SHARE])
        return [SummaryPart("study", lines, {"study": facts})]


def _facts(row: xr.Dataset) -> dict[str, object]:
    names = [str(name) for name in row["parameter"].values]
    keys = ("first_order", "first_order_conf", "total_order", "total_order_conf", "effect")
    table = {name: {key: float(row[key][k]) for key in keys} for k, name in enumerate(names)}
    counts = {key: int(row[key]) for key in ("left_out", "corners_left_out", "set_to_zero", "averaged")}
    return {"mean": float(row["mean"]), "std": float(row["std"]), "parameters": table, **counts}


def _sentences(row: xr.Dataset) -> list[str]:
    """Return one sentence per important parameter, by falling importance, per important pair, and on all others."""
    if int(row["sobol_reason"]) != REASONS.index("known"):
        return [f"there are no shares of the variance: {_why(row)}"]
    names = [str(name) for name in row["parameter"].values]
    total = row["total_order"].values
    order = [int(k) for k in np.argsort(-total) if total[k] >= MIN_SHARE]
    sentences = [_parameter_sentence(row, k) for k in order]
    second, errors = row["second_order"].values, row["second_order_conf"].values
    pairs = [(i, j) for i, j in combinations(range(len(names)), 2) if second[i, j] >= max(MIN_SHARE, errors[i, j])]
    sentences += [_pair_sentence(row, i, j) for i, j in sorted(pairs, key=lambda pair: -second[pair])]
    others = [name for k, name in enumerate(names) if k not in order]
    if others:
        hardly, each = ("hardly matters", "") if len(others) == 1 else ("hardly matter", " each")
        sentences.append(f"{_listed(others)} {hardly}: less than {_percent(MIN_SHARE)} of the variation{each}")
    if float(row["total_order_conf"].max()) > WIDE:
        sentences.append("some of these shares are uncertain; double the samples until they are known well enough")
    return sentences


def _parameter_sentence(row: xr.Dataset, k: int) -> str:
    factor, unit = _scale(row)
    name, long_name = str(row["parameter"].values[k]), str(row["parameter_long_name"].values[k]).split(" (")[0]
    first, total, error, effect = (
        float(row[key][k]) for key in ("first_order", "total_order", "total_order_conf", "effect")
    )
    text = f"{name} ({long_name}) causes {100 * min(total, 1.0):.0f} ± {_percent(error)} of the variation"
    text += f", {_percent(min(max(first, 0.0), 1.0))} on its own"
    if not np.isfinite(effect):
        return text
    change = f"{'raises' if effect > 0 else 'lowers'} it by {factor * abs(effect):.3g} {pretty_unit(unit)}".rstrip()
    change = change if abs(effect) > NEGLIGIBLE * float(row["std"]) else "hardly changes it"
    text += f"; going from {_bounds(row, k)} {change} on average"
    if first > MIN_SHARE and abs(effect) < CURVED * np.sqrt(12 * first) * float(row["std"]):
        text += ", but not steadily: values in between differ more"
    return text


def _pair_sentence(row: xr.Dataset, i: int, j: int) -> str:
    names = [str(name) for name in row["parameter"].values]
    share, interaction = float(row["second_order"][i, j]), float(row["interaction"][i, j])
    text = f"{names[i]} and {names[j]} must be chosen together: their interaction causes {_percent(share)}"
    if not np.isfinite(interaction):
        return text
    factor, unit = _scale(row)
    more = f"{factor * 2 * abs(interaction):.3g} {pretty_unit(unit)}".rstrip()
    return f"{text}; the effect of {names[i]} is {more} {'greater' if interaction > 0 else 'less'} at high {names[j]}"


def _bounds(row: xr.Dataset, k: int) -> str:
    about = {"units": str(row["parameter_unit"].values[k])}
    ends = xr.DataArray([float(row["low"][k]), float(row["high"][k])], attrs=about)
    factor, unit = scale(ends)
    return " to ".join(f"{factor * float(x):.4g}" for x in ends) + f" {pretty_unit(unit)}".rstrip()


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _listed(names: list[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _rule_lines(row: xr.Dataset) -> list[str]:
    """Return a line on the lanes, samples and corners that are treated by rule; none if there are none."""
    parts = [
        (int(row["set_to_zero"]), "lane without impacts counts as 0", "lanes without impacts count as 0"),
        (int(row["averaged"]), "irregular lane counts with its mean", "irregular lanes count with their means"),
        (int(row["left_out"]), "base sample is left out", "base samples are left out"),
        (int(row["corners_left_out"]), "corner is left out", "corners are left out"),
    ]
    texts = [counted(number, single, several) for number, single, several in parts if number]
    return ["; ".join(texts)] if texts else []
