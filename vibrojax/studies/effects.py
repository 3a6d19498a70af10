"""The analysis `study`: lanes at samples of a box, indices and effects of its parameters, and sentences on them."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.colors import Normalize

from vibrojax.errors import Place, counted, shown, suggestion
from vibrojax.io.variables import Variable
from vibrojax.lanes.labels import sweep_variables
from vibrojax.maps.bounds import VariedFile, read_bounds, read_file
from vibrojax.maps.dataset import described_variables, parameter_attributes
from vibrojax.maps.run import lanes_beside, run_sweep
from vibrojax.maps.sweep import Sweep
from vibrojax.measures.labels import REGIMES, SINGLE_IMPACT
from vibrojax.pictures.axes import margins, pretty_unit, scale, symbols_of
from vibrojax.pictures.colours import Value
from vibrojax.pictures.plots import FAINT, INK, Axis, Bars, Cells, Layer, Line, Plot, Sheet, Text, bars, one_colour
from vibrojax.pictures.style import BIT
from vibrojax.settings.fields import given, setting
from vibrojax.settings.toml import read_source
from vibrojax.settings.values import check_distinct
from vibrojax.studies.analysis import PictureRule, SummaryPart, checked_result
from vibrojax.studies.effects_sampling import CONFIDENCE, REASONS, RULES, SHARE, Sampling, indices, values_of
from vibrojax.studies.subjects import FileAnalysis

MIN_SHARE = 0.05  # share of the variance below which a parameter or a pair counts as unimportant

_MAX_ROWS = 4
_UNKNOWN = "#F2F2F2"  # ground of a pair whose interaction is within its error
_BAR = 0.38  # height of a bar; two stand at each parameter
Ticks = list[tuple[float, str]]


def bars_and_interactions(ds: xr.Dataset) -> Sheet:
    """Draw first-order and total indices with confidence intervals, and a heat map of the interactions of pairs.

    There is one row per variable, four at most.
    """
    of = [str(name) for name in ds["of"].values][:_MAX_ROWS]
    size = 9.0, len(of) * max(1.7, 0.6 + 0.22 * ds.sizes["parameter"]) + 0.8
    greatest = 100 * min(float(np.nanmax(ds["second_order"].values, initial=MIN_SHARE)), 1.0)
    norm, signs = Normalize(0.0, greatest), symbols_of(ds)
    pairs = Value("sobol_pair", "interaction of a pair [%]", 1.0, norm, "neither", colormaps["Blues"])
    ticks = [(float(k), signs.get(name, name)) for k, name in enumerate(map(str, ds["parameter"].values))]
    plots = []
    for k, name in enumerate(of):
        row = ds.sel(of=name)
        plots.append(_share_plot(row, k, "share of the variance" if name == of[-1] else "", ticks))
        plots.append(_pair_plot(row, k, pairs, ticks))
    rest = ds.sizes["of"] - len(of)
    further = counted(rest, "further variable is", "further variables are") + " not drawn" if rest else ""
    level = f"{100 * float(ds.attrs.get('confidence', 0.95)):.0f} %"
    about = f"Lines: intervals of {level} confidence; pairs whose interval contains 0 are pale, in brackets"
    shares = np.concatenate([ds[name].values.ravel() for name in ("first_order", "total_order")])
    beyond = "Shares beyond 0 and 1, from too few samples, end there" * bool(((shares < 0) | (shares > 1)).any())
    notes = "Titles: mean ± standard deviation", about, beyond, further
    return Sheet(plots, size, (1.5, 1.0), beside=False, **margins(ds, *notes))


def _share_plot(row: xr.Dataset, k: int, label: str, ticks: Ticks) -> Plot:
    places, layers = np.arange(len(ticks), dtype=float), list[Layer]()
    looks = (-_BAR / 2, "first_order", BIT, "alone"), (_BAR / 2, "total_order", FAINT, "with all its\ninteractions")
    for shift, key, colour, text in looks:
        values, errors = np.clip(row[key].values, 0.0, 1.0), np.nan_to_num(row[f"{key}_conf"].values)
        bottom = places + shift - _BAR / 2
        layers.append(Bars(0 * places, bottom, values, np.full(len(ticks), _BAR), colour, label=text))
        ends = np.clip([row[key].values - errors, row[key].values + errors], 0.0, 1.0)
        layers.append(Line(*bars(places + shift, *ends)[::-1], width=0.8))
    if int(row["sobol_reason"]) != REASONS.index("known"):
        layers.append(Text(0.5, 0.5, _why(row), relative=True))
    up = Axis(ticks=ticks, reversed=True)
    return Plot(layers, Axis(label, limits=(0.0, 1.0)), up, _title(row), (k, 0))


def _pair_plot(row: xr.Dataset, k: int, value: Value, ticks: Ticks) -> Plot:
    """Draw the lower triangle of second-order indices; those within their confidence interval of 0 are in brackets."""
    values, errors = (100 * x for x in _interactions(row))
    lower = np.where(np.tri(len(ticks), k=-1, dtype=bool), np.maximum(values, 0.0), np.nan)
    ends = np.arange(len(ticks) + 1) - 0.5
    layers: list[Layer] = [Cells(ends, ends, lower, value.colour_map, value.norm, hatched=False)]
    unknown = np.isfinite(lower) & ~(values > errors)
    layers.append(one_colour(ends, ends, unknown, _UNKNOWN, order=0.5))
    for i, j in zip(*np.nonzero(np.isfinite(lower)), strict=True):
        colour = "#FFFFFF" if value.norm(lower[i, j]) > 0.6 and not unknown[i, j] else INK
        text = f"({lower[i, j]:.0f})" if unknown[i, j] else f"{lower[i, j]:.0f}"
        layers.append(Text(float(j), float(i), text, colour=colour, size=7.5))
    across, up = Axis(ticks=ticks, group="other"), Axis(ticks=ticks, reversed=True)
    return Plot(layers, across, up, "interactions of pairs [%]", (k, 1), scale=value)


def _title(row: xr.Dataset) -> str:
    factor, unit = _scale(row)
    mean, std = (factor * float(f"{float(row[key]):.{digits}g}") for key, digits in (("mean", 3), ("std", 2)))
    name = str(row["of"].item())
    words = "share of single impacts" if name == SHARE else name.replace("_", " ")
    return f"{words}: {f'{mean:.6g} ± {std:.6g} {pretty_unit(unit)}'.strip()}"


def _scale(row: xr.Dataset) -> tuple[float, str]:
    values = np.array([float(row["mean"]), float(row["std"]), *np.abs(np.nan_to_num(row["effect"].values))])
    return scale(xr.DataArray(values, attrs={"units": str(row["of_unit"].item())}))


def _why(row: xr.Dataset) -> str:
    why = {"constant": "it is the same everywhere", "too-few-samples": "too few samples have a value"}
    return why.get(REASONS[int(row["sobol_reason"])], "")


WIDE = 0.3  # half-width of a confidence interval above which the summary recommends more samples

CURVED = 0.5
"""Ratio of an effect to that of a straight line with the same variance below which the summary calls it not steady."""

NEGLIGIBLE = 1e-3
"""Effect, relative to the standard deviation, below which the summary says that it hardly changes the variable."""

_OF, _PARAMETER = ("of",), ("of", "parameter")
_PAIR = ("of", "parameter", "other")
_KEPT = ("parameters", "parameter_units", "differing", "run", "solver", "lanes")  # attributes of the lanes

RULED = {
    "set_to_zero": ("lane without impacts counts as 0", "lanes without impacts count as 0"),
    "averaged": ("irregular lane counts with its mean", "irregular lanes count with their means"),
    "left_out": ("base sample is left out", "base samples are left out"),
    "corners_left_out": ("corner is left out", "corners are left out"),
}
"""Words for the numbers of lanes, samples and corners that are treated by rule, for one and for several."""

STUDY_VARIABLES = {
    "first_order": Variable("1", "share of the variance that the parameter causes alone", dims=_PARAMETER),
    "first_order_conf": Variable("1", "half-width of the confidence interval of first_order", dims=_PARAMETER),
    "total_order": Variable(
        "1", "share of the variance that the parameter causes with all its interactions", dims=_PARAMETER
    ),
    "total_order_conf": Variable("1", "half-width of the confidence interval of total_order", dims=_PARAMETER),
    "second_order": Variable("1", "share of the variance that the interaction of two parameters causes", dims=_PAIR),
    "second_order_conf": Variable("1", "half-width of the confidence interval of second_order", dims=_PAIR),
    "effect": Variable(
        "", "mean of the variable at the parameter's high level minus its mean at the low level", dims=_PARAMETER
    ),
    "interaction": Variable(
        "",
        "half the difference between the effects of one parameter at the high and at the low level of the other",
        dims=_PAIR,
    ),
    "mean": Variable("", "mean of the variable over the parameter box", dims=_OF),
    "std": Variable("", "standard deviation of the variable over the parameter box", dims=_OF),
    "left_out": Variable("1", "number of base samples that are not used for the Sobol indices", np.int32, dims=_OF),
    "corners_left_out": Variable(
        "1", "number of corners of the parameter box that are not used for effects and interactions", np.int32, dims=_OF
    ),
    "set_to_zero": Variable(
        "1", "number of lanes without impacts, for which the variable is set to 0", np.int32, dims=_OF
    ),
    "averaged": Variable("1", "number of irregular lanes, for which the mean over time is used", np.int32, dims=_OF),
    "sobol_reason": Variable("1", "reason why Sobol indices are missing", np.int8, REASONS, dims=_OF),
    SHARE: Variable("1", "share of lanes with a single impact in the Sobol sample"),
    "regime_share": Variable("1", "share of lanes in this regime in the Sobol sample", dims=("label",)),
    "low": Variable("", "least value of the parameter in the box", dims=("parameter",)),
    "high": Variable("", "greatest value of the parameter in the box", dims=("parameter",)),
}


@dataclass(frozen=True, kw_only=True)
class StudyFile(VariedFile):
    """The file of a study."""

    of: Any = setting(None, "variables to explain", read=given)
    samples: int = setting(256, "number of base samples, a power of two", least=2, most=2**16)
    seed: int = setting(0, "seed of the Sobol sequence", least=0)

    def check(self, place: Place) -> None:
        if not isinstance(self.of, list) or not self.of:
            problem = "missing" if self.of is None else f"{shown(self.of)} names no variable"
            raise place.at("of").error(f'{problem}; write a list like of = ["impact_energy", "blow_frequency"]')
        if self.samples & (self.samples - 1):
            below = 1 << (self.samples.bit_length() - 1)
            raise place.at("samples").error(f"{self.samples} is not a power of two; give {below} or {2 * below}")


@dataclass(frozen=True, eq=False)
class Study:
    """A checked study: the variables `of` which it explains, the samples, and a sweep with one point per sample."""

    of: list[str]
    sampling: Sampling
    sweep: Sweep
    text: str


def read_study(source: str | PathLike[str] | Mapping[str, object]) -> Study:
    """Read a study from the path of a TOML file, the name of a bundled study, or a dict with the same structure.

    **Raises:** `InputError` with a one-line message at the first error.
    """
    origin = read_source(source, "study")
    file, place, names = read_file(StudyFile, origin)
    bounds = read_bounds(place.at("vary"), file.vary, names, file.parameters)
    known = sweep_variables(names.system)
    allowed = [name for name, about in known.items() if not (about.flags or about.along)]
    allowed += [SHARE] * ("impacts" in allowed and "regime" in known)
    for index, name in enumerate(file.of):
        if name not in allowed:
            fault = f"scene {shown(names.scene)} has no variable {shown(name)}; {suggestion(str(name), allowed)}"
            raise place.at("of").item(index).error(fault)
    check_distinct(place.at("of"), file.of, "variable")
    sampling = Sampling(bounds, file.samples, file.seed)
    columns = {name: x.tolist() for name, x in zip(bounds, sampling.points().T, strict=True)}
    sweep = file.sweep(origin.file, columns, title=file.title or f"Study of {', '.join(file.of)}".replace("_", " "))
    return Study(file.of, sampling, sweep, origin.text)


def study(source: str | PathLike[str] | Mapping[str, object], progress: bool = True) -> xr.Dataset:
    """Find the parameters, and pairs of parameters, that determine the performance of a machine within a box of values.

        ds = vj.study("drill")
        ds.total_order.sel(of="impact_energy").to_pandas()

    The study simulates Saltelli's sample of the parameter box for Sobol indices, and the corners of a two-level
    factorial design for effects and interactions. With more than eight parameters, the study uses a fractional
    factorial design of resolution V.

    **Arguments:**

    - `source`: path of a TOML file, the name of a bundled study, or a dict with the same structure. For D parameters, a
      study needs (2 D + 2) lanes per base sample and start. A study has these entries:

      - `scene`, and optionally `[parameters]`, `starts` and `[run]`: as in a sweep.
      - `of`: list of variables, which may include "share_single_impact".
      - `[vary]`: table with NAME = [low, high] for up to twelve parameters.
      - `samples`: number of base samples, a power of two; default 256. `seed`: default 0.

    **Returns:** a dataset with the dimensions `of` (the variable), `parameter`, and `other` (the second parameter of a
    pair). `first_order`, `total_order` and `second_order` are the shares of the variance that a parameter causes alone,
    that it causes alone and in interactions, and that a pair causes, with half-widths of 95 % confidence intervals
    (`_conf`). `effect` is the mean of the variable at the high level of a parameter minus that at the low level, and
    `interaction` half the difference of an effect between both levels of another parameter. The attribute `rules` says
    which lanes are left out or count as 0; further variables count them.

    **Raises:** `InputError` if the study is invalid or SALib is not installed.

    **Example:**

    >>> drill = {"scene": "vibro-impact", "parameters": {"delta": 0.005}, "starts": ["stuck"], "of": ["impact_energy"]}
    >>> box = {"vary": {"v": [1.4, 1.6], "gamma": [0.7, 0.72]}, "samples": 16, "run": {"settle": 20.0}}
    >>> ds = vj.study(drill | box, progress=False)
    >>> ds.effect.sel(of="impact_energy").idxmax().item()  # a faster drive strikes harder
    'v'
    """
    analysis = Studies()
    return checked_result(analysis, analysis.run(source, progress))


class Studies(FileAnalysis[Study]):
    """Find which parameters determine a machine's performance: effects, interactions and Sobol indices."""

    kind = "study"
    variables = STUDY_VARIABLES
    pictures = (PictureRule("effects", lambda held: "first_order" in held.variables, bars_and_interactions),)
    view = "plots"

    about = "a study: a bundled name such as drill, or the path of a TOML file"
    chunks = True

    def asked(self, file: Any, columns: Mapping[str, str] | None = None) -> Study:
        return read_study(file)

    def identity(self, spec: Study) -> dict[str, object]:
        bounds = {f"vary.{name}": list(x) for name, x in spec.sampling.bounds.items()}
        own = {"study": True, "of": spec.of, "samples": spec.sampling.samples, "seed": spec.sampling.seed}
        return spec.sweep.identity() | own | bounds

    def compute(self, spec: Study, progress: bool = True) -> xr.Dataset:
        return self._dataset(spec, run_sweep(spec.sweep, progress=progress))

    def compute_beside(self, spec: Study, out: Path, resume: bool, progress: bool) -> xr.Dataset:
        with lanes_beside(spec.sweep, out, resume=resume, progress=progress) as lanes:
            return self._dataset(spec, lanes)

    def _dataset(self, spec: Study, lanes: xr.Dataset) -> xr.Dataset:
        lanes, sampling, sweep = lanes.transpose("point", ...), spec.sampling, spec.sweep
        rows: list[dict[str, Any]] = []
        for name in spec.of:
            values, zeros, averaged = values_of(lanes, name)
            counts = {"set_to_zero": zeros.sum(), "averaged": averaged.sum()}
            rows.append(indices(sampling, values.mean(axis=1)) | counts)
        table: dict[str, Any] = {key: np.array([row[key] for row in rows]) for key in rows[0]}
        table["low"], table["high"] = np.array(list(sampling.bounds.values())).T
        names = list(sampling.bounds)
        coords: dict[str, Any] = {"of": spec.of, "parameter": names, "other": names}
        sobol = sampling.samples * sampling.group
        if "regime" in lanes:
            regime = lanes["regime"].values.reshape(lanes.sizes["point"], -1)[:sobol]
            table["regime_share"] = np.array([(regime == flag).mean() for flag in range(len(REGIMES))])
            table[SHARE] = (regime == SINGLE_IMPACT).mean()
            coords["label"] = list(REGIMES)
        about = described_variables(sweep) | {SHARE: STUDY_VARIABLES[SHARE]}
        parameters = [parameter_attributes(sweep, name) for name in names]
        for end, key in (("unit", "units"), ("long_name", "long_name")):
            coords[f"of_{end}"] = "of", [getattr(about[name], key) for name in spec.of]
            coords[f"parameter_{end}"] = "parameter", [x[key] for x in parameters]
        corners = lanes.sizes["point"] - sobol
        fraction = "full" if corners == 2 ** len(sampling.bounds) else "fraction of resolution V"
        kept: dict[str, Any] = {name: lanes.attrs[name] for name in _KEPT if name in lanes.attrs}
        kept |= {"study": spec.text, "rules": RULES, "design": f"{fraction}, {corners} corners"}
        kept |= {"samples": sampling.samples, "seed": sampling.seed, "confidence": CONFIDENCE}
        kept |= {"sobol_lanes": sobol * lanes.sizes.get("start", 1)}
        table = {name: table[name] for name in STUDY_VARIABLES if name in table}
        return self.dataset(table, coords, title=sweep.title, scene=sweep.scene, **kept)

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        facts: dict[str, Any] = {}
        lines: list[str] = []
        keys = ("first_order", "first_order_conf", "total_order", "total_order_conf", "effect")
        for name in map(str, ds["of"].values):
            row, sentences = ds.sel(of=name), _sentences(ds.sel(of=name))
            counts = {key: int(row[key]) for key in ("left_out", "corners_left_out", "set_to_zero", "averaged")}
            table = {str(p): {key: float(row[key].sel(parameter=p)) for key in keys} for p in row["parameter"].values}
            facts[name] = {"mean": float(row["mean"]), "std": float(row["std"]), "parameters": table, **counts}
            facts[name] |= {"sentences": sentences}
            rules = [counted(counts[key], *words) for key, words in RULED.items() if counts[key]]
            lines += [f"{_title(row)} over {counted(int(ds.attrs.get('samples', 0)), 'sample')}"]
            lines += [f"  {line}" for line in (*sentences, "; ".join(rules)) if line]
        if SHARE in ds:
            lines.append(f"{100 * float(ds[SHARE]):.0f} % of the lanes have a single impact")
            facts[SHARE] = float(ds[SHARE])
        return [SummaryPart("study", lines, {"study": facts})]


def _sentences(row: xr.Dataset) -> list[str]:
    """Return one sentence per important parameter, by falling importance, per important pair, and on all others."""
    if int(row["sobol_reason"]) != REASONS.index("known"):
        return [f"there are no shares of the variance: {_why(row)}"]
    names = [str(name) for name in row["parameter"].values]
    total = row["total_order"].values
    order = [int(k) for k in np.argsort(-total) if total[k] >= MIN_SHARE]
    sentences = [_parameter_sentence(row, k) for k in order]
    second, errors = _interactions(row)
    pairs = [(i, j) for i, j in combinations(range(len(names)), 2) if second[i, j] > max(MIN_SHARE, errors[i, j])]
    sentences += [_pair_sentence(row, i, j) for i, j in sorted(pairs, key=lambda pair: -second[pair])]
    unknown = row["total_order_conf"].values > WIDE
    for is_unknown in (False, True):
        others = [name for k, name in enumerate(names) if k not in order and unknown[k] == is_unknown]
        listed = " and ".join([", ".join(others[:-1]), others[-1]] if len(others) > 1 else others)
        if others and is_unknown:
            sentences.append(f"too few samples to tell whether {listed} matter{'s' * (len(others) == 1)}")
        elif others:
            hardly, each = ("hardly matters", "") if len(others) == 1 else ("hardly matter", " each")
            sentences.append(f"{listed} {hardly}: less than {_percent(MIN_SHARE)} of the variation{each}")
    shown = np.concatenate([row["first_order"].values[order], total[order], [second[pair] for pair in pairs]])
    if (np.abs(np.round(shown, 2) - 0.5) > 0.5).any():
        sentences.append("shares beyond 0 and 100 %, from too few samples, are given as 0 and 100 %")
    if float(row["total_order_conf"].max()) > WIDE:
        sentences.append("some of these shares are uncertain; double the samples until they are known well enough")
    return sentences


def _parameter_sentence(row: xr.Dataset, k: int) -> str:
    factor, unit = _scale(row)
    name, long_name = str(row["parameter"].values[k]), str(row["parameter_long_name"].values[k]).split(" (")[0]
    keys = ("first_order", "total_order", "total_order_conf", "effect")
    first, total, error, effect = (float(row[key][k]) for key in keys)
    text = f"{name} ({long_name}) causes {_percent(total).removesuffix(' %')} ± {_percent(error)} of the variation"
    text += f", {_percent(first)} on its own"
    if not np.isfinite(effect):
        return text
    change = f"{'raises' if effect > 0 else 'lowers'} it by {factor * abs(effect):.3g} {pretty_unit(unit)}".rstrip()
    change = change if abs(effect) > NEGLIGIBLE * float(row["std"]) else "hardly changes it"
    ends = [float(row[end][k]) for end in ("low", "high")]
    factor, unit = scale(xr.DataArray(ends, attrs={"units": str(row["parameter_unit"][k].item())}))
    span = f"{' to '.join(f'{factor * x:.4g}' for x in ends)} {pretty_unit(unit)}".rstrip()
    text += f"; going from {span} {change} on average"
    if first > MIN_SHARE and abs(effect) < CURVED * np.sqrt(12 * first) * float(row["std"]):
        text += ", but not steadily: values in between differ more"
    return text


def _pair_sentence(row: xr.Dataset, i: int, j: int) -> str:
    names = [str(name) for name in row["parameter"].values]
    (share, error), interaction = (float(x[i, j]) for x in _interactions(row)), float(row["interaction"][i, j])
    causes = f"causes {_percent(share).removesuffix(' %')} ± {_percent(error)} of the variation"
    text = f"{names[i]} and {names[j]} must be chosen together: their interaction {causes}"
    if not np.isfinite(interaction):
        return text
    factor, unit = _scale(row)
    more = f"{factor * 2 * abs(interaction):.3g} {pretty_unit(unit)}".rstrip()
    return f"{text}; the effect of {names[i]} is {more} {'greater' if interaction > 0 else 'less'} at high {names[j]}"


def _interactions(row: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Return the shares of the interactions of pairs, at most the smaller of both total shares, with their errors."""
    total = row["total_order"].values
    share = np.minimum(row["second_order"].values, np.minimum(total[:, None], total))
    return share, row["second_order_conf"].values


def _percent(share: float) -> str:
    """Return a share as text; a share beyond 0 and 1, from too few samples, becomes 0 or 100 %."""
    return f"{100 * min(max(share, 0.0), 1.0):.0f} %"
