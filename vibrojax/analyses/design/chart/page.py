"""The page of the designer's chart: A4, landscape."""

from typing import Literal

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from vibrojax.analyses.design.chart.region import RECTANGLE, REGIONS
from vibrojax.errors import InputError
from vibrojax.plot.style import IMPACT, INK, OwnFigure, styled

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
