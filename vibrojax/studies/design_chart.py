"""The designer's chart: the map over mass ratio and frequency ratio at a design's other values, and what it gains.

The chart's variables are added to the dataset of the design, from which the page, one sheet of A4, is drawn.
"""

from typing import Any, Literal

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from scipy.ndimage import binary_erosion, maximum_filter, minimum_filter

from vibrojax.errors import InputError, shown
from vibrojax.io.variables import Variable
from vibrojax.maps.read import read_sweep
from vibrojax.maps.run import run_sweep
from vibrojax.measures.labels import REGIMES
from vibrojax.physics.rock import ROCKS
from vibrojax.pictures.style import IMPACT, INK, OwnFigure, styled
from vibrojax.studies.design_spec import DesignSpec

BETA, GAMMA = (0.1, 0.8), (0.4, 1.1)
"""Ranges of the mass ratio and the frequency ratio on the chart."""

CELLS = 71
"""Number of values of each ratio: a hundredth apart."""

RECTANGLE = {"beta": (0.25, 0.6), "gamma": (0.6, 0.8)}
"""The region that the source recommends (chapter 7)."""

CHARTED = ("impact_energy", "blow_frequency", "peak_impact_force", "rate_of_penetration", "impact_power", "drive_power")
"""Variables of the chart, as far as the scene has them."""

REGIONS = ("other", "single-impact", "robust")
"""Meanings of the flags of `chart_region`."""

MOST_STARTS_NAMED = 4
"""Largest number of starts that the page names."""

SAME_MOTION = 0.02
"""Relative spread of the impact energy over the starts, up to which their motions count as one."""

CLIFF = 0.4
"""Difference of the impact energy between neighbouring cells, relative to the chart's greatest, from which another
motion begins between them."""

A4 = (11.69, 8.27)
"""Size of the page [inch]."""

ROBUST = REGIONS.index("robust")
_REGION_COLOURS = ("#D9D9D9", "#FFF3C9", "#FFFFFF")
_ENERGY, _FORCE, _RATE, _BLOWS = "#9A3B00", "#004488", "#1B7837", "#6A1B5D"
_LEVELS = 9

_LINES: dict[str, tuple[str, float, str, Literal["-", "--"]]] = {
    "impact_energy": ("impact energy [J]", 1.0, _ENERGY, "-"),
    "peak_impact_force": ("peak force [kN]", 1e-3, _FORCE, "--"),
    "rate_of_penetration": ("rate of penetration [mm/s]", 1e3, _RATE, "-"),
    "impact_power": ("impact power [kW]", 1e-3, _RATE, "-"),
    "blow_frequency": ("blows per minute", 1.0, _BLOWS, "--"),
    "drive_power": ("drive power [kW]", 1e-3, INK, "-"),
}
"""Label, factor, colour and line style of each variable."""


def charted(ds: xr.Dataset, spec: DesignSpec, progress: bool = True) -> xr.Dataset:
    """Return the design's dataset with the variables of its chart.

    **Raises:** `InputError` if the scene has no mass ratio and frequency ratio, or no impacts.
    """
    names = spec.template.system.parameters()
    if not {"beta", "gamma"} <= set(names) or "impact_energy" not in spec.variables:
        raise spec.place.at("scene").error(
            f"{shown(spec.template.scene)} has no chart; it needs beta, gamma and impacts"
        )
    if clash := {"striker_frequency"} & {*spec.varied, *spec.tables["parameters"]}:
        raise spec.place.at(min(clash)).error("has no chart; give gamma instead")
    best = {name: float(ds[name][0]) for name in spec.varied}
    values = {**spec.tables["parameters"], **spec.fixed, **best}
    own = {name: float(values.get(name, names[name].default)) for name in ("beta", "gamma")}
    others = {name: x for name, x in values.items() if name not in own}
    base = {key: x for key, x in spec.tables.items() if key not in ("parameters", "title")} | {"parameters": others}
    base["run"] = {**base.get("run", {}), "orbits": False}
    axes = {"beta": np.linspace(*BETA, CELLS), "gamma": np.linspace(*GAMMA, CELLS)}
    lanes = run_sweep(read_sweep(base | {"grid": {name: x.tolist() for name, x in axes.items()}}), progress=progress)
    centre = {name: sum(ends) / 2 for name, ends in RECTANGLE.items()}
    places = {name: [centre[name], own[name]] for name in own}
    points = run_sweep(read_sweep(base | {"points": places}), progress=False)
    single = _single(lanes)
    box = _box(spec, axes)
    energy = np.where(single, _worst(lanes, "impact_energy"), np.nan)
    known = np.nan_to_num(energy)
    cliff = maximum_filter(known, footprint=box) - minimum_filter(known, footprint=box) > CLIFF * known.max()
    robust = binary_erosion(single, box, border_value=1) & ~cliff
    data: dict[str, Any] = {}
    meaning = "same single impact from every start; robust: in the cells around, and within the tolerances, as well"
    about = Variable("1", meaning, np.int8, REGIONS)
    flags = single.astype(np.int8) + robust
    data["chart_region"] = (("chart_beta", "chart_gamma"), flags.astype(np.int8), about.attributes())
    for name in (name for name in CHARTED if name in lanes):
        words = {key: str(lanes[name].attrs[key]) for key in ("units", "long_name")}
        data[f"chart_{name}"] = (("chart_beta", "chart_gamma"), np.where(single, _worst(lanes, name), np.nan), words)
        data[f"compared_{name}"] = ("compared", _worst(points, name), words)
    for name in own:
        words = {key: str(lanes[name].attrs[key]) for key in ("units", "long_name")}
        data[f"compared_{name}"] = ("compared", np.array(places[name]), words)
    coords = {
        "compared": (
            "compared",
            ["centre", "best"],
            {"long_name": "centre of the source's rectangle, and the best point"},
        ),
        **{f"chart_{name}": (f"chart_{name}", x, dict(lanes[name].attrs)) for name, x in axes.items()},
    }
    result = ds.assign(data).assign_coords(coords)
    count = int(ds.attrs["lanes"]) + lanes.regime.size + points.regime.size
    return result.assign_attrs(chart_values=_values_text(spec, others), lanes=count)


def _values_text(spec: DesignSpec, values: dict[str, Any]) -> str:
    """Return the rock, the drive speed, the other values that were given, and the starts."""
    names = spec.template.system.parameters()
    numbers = {name: float(x) for name, x in values.items() if isinstance(x, (int, float))}
    rock = {name: numbers.get(name, names[name].default) for name in ("threshold", "k3") if name in names}
    words = []
    if rock:
        same = [name for name, about in ROCKS.items() if (about.threshold, about.k3) == tuple(rock.values())]
        stiffness = f"D = {rock['threshold'] / 1e3:g} kN, k3 = {rock['k3'] / 1e6:g} MN/m"
        words.append(f"{same[0]} ({stiffness})" if same else f"rock with {stiffness}")
    if "v" in names and not {"rpm"} & set(numbers):
        words.append(f"drive speed {numbers.get('v', names['v'].default):g} m/s")
    words += [f"{name} = {x:g}" for name, x in numbers.items() if name not in ("v", *rock)]
    starts = [str(start) for start in spec.template.starts or ()]
    return ", ".join(words) + (f"; starts: {', '.join(starts)}" if 0 < len(starts) <= MOST_STARTS_NAMED else "")


def _single(lanes: xr.Dataset) -> Bool[np.ndarray, "beta gamma"]:
    """Return the cells in which every start leads to the same single impact."""
    single, energy = lanes["regime"] == REGIMES.index("single-impact"), lanes["impact_energy"]
    if "start" not in single.dims:
        return np.asarray(single.values)
    same = energy.max("start") <= (1 + SAME_MOTION) * energy.min("start")
    return np.asarray((single.all("start") & same).values)


def _worst(lanes: xr.Dataset, name: str) -> Float[np.ndarray, "..."]:
    """Return a variable's worst value over the starts: the greatest of forces and of drive power, else the least."""
    x = lanes[name]
    if "start" not in x.dims:
        return np.asarray(x.values)
    return np.asarray((x.max("start") if name in ("peak_impact_force", "drive_power") else x.min("start")).values)


def _box(spec: DesignSpec, axes: dict[str, np.ndarray]) -> Bool[np.ndarray, "..."]:
    """Return the cells around a cell in which a robust point must be single: the tolerances, at least one cell."""
    sizes = []
    for name, axis in axes.items():
        width = spec.tolerances.get(name, 0.0)
        sizes.append(2 * max(1, int(np.ceil(width / (axis[1] - axis[0]) - 1e-9))) + 1)
    return np.ones(sizes, bool)


@styled
def chart_page(ds: xr.Dataset) -> Figure:
    """Draw the chart of a design's dataset on an A4 page.

    **Raises:** `InputError` if the dataset holds no chart.
    """
    if "chart_region" not in ds:
        raise InputError("the dataset holds no chart; make it with vibrojax design FILE --chart")
    figure = OwnFigure(figsize=A4)
    progress = "rate_of_penetration" if "chart_rate_of_penetration" in ds else "impact_power"
    left, right = figure.add_axes((0.065, 0.36, 0.43, 0.52)), figure.add_axes((0.55, 0.36, 0.43, 0.52))
    _draw_panel(left, ds, "impact_energy", "peak_impact_force")
    _draw_panel(right, ds, progress, "blow_frequency")
    left.set_ylabel("mass ratio  β = m₂/m₁")
    title = str(ds.attrs.get("title", "")) or "Designer's chart"
    figure.text(0.065, 0.955, title, fontsize=16, weight="bold", va="center")
    fixed = str(ds.attrs.get("chart_values", ""))
    figure.text(
        0.065, 0.925, f"scene {ds.attrs.get('scene', '')}; {fixed or 'default values'}", fontsize=8.5, color="0.3"
    )
    _draw_table(figure, ds)
    _draw_key(figure)
    about = f"Requirements of the best point: {ds.attrs.get('requirements', '')}."
    figure.text(0.065, 0.025, about, fontsize=7.5, color="0.3")
    figure.text(0.98, 0.025, str(ds.attrs.get("source", "")), fontsize=7.5, color="0.3", ha="right")
    return figure


def _draw_panel(axes: Axes, ds: xr.Dataset, solid: str, dashed: str) -> None:
    beta, gamma = ds["chart_beta"].values, ds["chart_gamma"].values
    colours = ListedColormap(list(_REGION_COLOURS))
    axes.pcolormesh(gamma, beta, ds["chart_region"].values, cmap=colours, vmin=-0.5, vmax=2.5, rasterized=True)
    for name in (dashed, solid):
        _, factor, colour, style = _LINES[name]
        robust = ds["chart_region"].values == ROBUST
        z = np.ma.masked_invalid(np.where(robust, ds[f"chart_{name}"].values * factor, np.nan))
        levels = _nice_levels(z.compressed())
        if not len(levels):
            continue
        lines = axes.contour(gamma, beta, z, levels=levels, colors=colour, linestyles=style, linewidths=1.1)
        for text in axes.clabel(lines, fmt=lambda x: f"{x:g}", fontsize=7.5, inline_spacing=3):
            text.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.4, "alpha": 0.75})
    (low, high), (start, stop) = RECTANGLE["beta"], RECTANGLE["gamma"]
    axes.add_patch(Rectangle((start, low), stop - start, high - low, fill=False, edgecolor=INK, linewidth=1.6))
    x, y = ds["compared_gamma"].values, ds["compared_beta"].values
    axes.plot(x[0], y[0], "+", color=INK, markersize=10, markeredgewidth=1.6, zorder=5)
    axes.plot(
        x[1],
        y[1],
        "*",
        color=IMPACT,
        markersize=16,
        markeredgecolor="white",
        markeredgewidth=0.8,
        clip_on=False,
        zorder=5,
    )
    handles = [
        Line2D([], [], color=_LINES[name][2], linestyle=_LINES[name][3], linewidth=1.3, label=_LINES[name][0])
        for name in (solid, dashed)
    ]
    axes.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, fontsize=9.5, handlelength=2.6)
    axes.set_xlim(gamma[0], gamma[-1])
    axes.set_ylim(beta[0], beta[-1])
    axes.set_xticks(np.arange(np.ceil(gamma[0] * 10) / 10, gamma[-1] + 1e-9, 0.1))
    axes.set_yticks(np.arange(np.ceil(beta[0] * 10) / 10, beta[-1] + 1e-9, 0.1))
    axes.set_xticks(np.arange(gamma[0], gamma[-1] + 1e-9, 0.02), minor=True)
    axes.set_yticks(np.arange(beta[0], beta[-1] + 1e-9, 0.02), minor=True)
    axes.set_xlabel("frequency ratio  γ = ω₂/ω₁")


def _nice_levels(values: np.ndarray) -> np.ndarray:
    """Return round levels over the values, closer where many of them lie."""
    if values.size < 2 or not np.ptp(values):
        return np.zeros(0)
    low, high = np.percentile(values, [2, 99.5])
    raw = (high - low) / _LEVELS
    power = 10.0 ** np.floor(np.log10(raw))
    step = next(power * k for k in (1, 2, 2.5, 5, 10) if power * k >= raw)
    levels = np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
    return np.round(levels[levels > 0], 12)


def _draw_table(figure: Figure, ds: xr.Dataset) -> None:
    """Write the values at the rectangle's centre and at the best point, and the gain."""
    names = [name for name in _LINES if f"compared_{name}" in ds]
    rows = []
    for name in ("beta", "gamma"):
        centre, best = ds[f"compared_{name}"].values
        rows.append((f"{'mass' if name == 'beta' else 'frequency'} ratio", f"{centre:.3f}", f"{best:.4f}", ""))
    for name in names:
        centre, best = ds[f"compared_{name}"].values * _LINES[name][1]
        gain = f"{100 * (best / centre - 1):+.0f} %".replace("-", "−") if centre and np.isfinite(best / centre) else ""
        rows.append((_LINES[name][0], f"{centre:.4g}", f"{best:.4g}", gain))
    top, left, step = 0.27, 0.065, 0.0235
    columns = (0.0, 0.27, 0.37, 0.45)
    head = ("", "source's centre  +", "best point  ★", "gain")
    for k, words in enumerate([head, *rows]):
        for offset, text in zip(columns, words, strict=True):
            align = "left" if offset == 0 else "right"
            weight = (
                "bold" if k == 0 or words[0].partition(" [")[0].replace(" ", "_") == ds.attrs.get("maximise") else None
            )
            figure.text(left + offset, top - k * step, text, fontsize=9, ha=align, va="center", weight=weight)
    figure.add_artist(Line2D([left, left + 0.455], [top - 0.5 * step] * 2, color=INK, linewidth=0.8))


def _draw_key(figure: Figure) -> None:
    handles = [
        Patch(
            facecolor=_REGION_COLOURS[2],
            edgecolor=INK,
            linewidth=0.6,
            label="robust: same single impact from every start, also within ±0.01",
        ),
        Patch(
            facecolor=_REGION_COLOURS[1],
            edgecolor=INK,
            linewidth=0.6,
            label="the same, but another motion is nearer than 0.01",
        ),
        Patch(facecolor=_REGION_COLOURS[0], edgecolor=INK, linewidth=0.6, label="other motions from some start"),
        Patch(fill=False, edgecolor=INK, linewidth=1.6, label="the source's recommendation: β 0.25–0.6, γ 0.6–0.8"),
    ]
    figure.legend(handles=handles, loc="upper left", bbox_to_anchor=(0.545, 0.29), fontsize=9, handlelength=1.6)
    words = (
        "Choose γ and β in the white region, and read the blow at the left and the\n"
        "hole at the right, worst over the starts. Lines end where the motion is not robust."
    )
    figure.text(0.55, 0.105, words, fontsize=8.5, color="0.25", va="center")
