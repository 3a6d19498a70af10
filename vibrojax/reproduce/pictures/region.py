"""Pictures of the source's region."""

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch, Rectangle

from vibrojax.reproduce._region import coexisting, single, strong
from vibrojax.reproduce.pictures._paper import FAINT, INK, LINES, WIDTH, new_figure, styled

KINDS = ("none", "from some starts", "from every start", "and clean, strong")
COLOURS = ("#E6E6E6", "#9DB7D5", "#3E74AB", "#F0C808")


@styled
def wide(ds):
    """Over mass and frequency ratio, for both gaps."""
    figure = new_figure(WIDTH, 3.4)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, delta in zip(panels, ds.delta.values, strict=True):
        part = ds.sel(delta=delta, v=1.5)
        good, best = single(part), strong(part)
        kind = good.any("start").astype(int) + good.all("start").astype(int) + best.all("start").astype(int)
        kind = kind.transpose("gamma", "beta")
        axes.pcolormesh(part.beta, part.gamma, kind, cmap=ListedColormap(COLOURS), vmin=-0.5, vmax=3.5)
        axes.add_patch(Rectangle((0.25, 0.6), 0.35, 0.2, fill=False, edgecolor=INK, linewidth=1.5))
        axes.set_title(f"gap {1e3 * delta:+.0f} mm")
        axes.set_xlabel("mass ratio β")
    panels[0].set_ylabel("frequency ratio γ")
    handles = [
        Patch(facecolor=colour, edgecolor=FAINT, label=name) for colour, name in zip(COLOURS, KINDS, strict=True)
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, title="single impact")
    return figure


@styled
def over_gap(ds):
    """Shares over the gap, all speeds together."""
    figure = new_figure(WIDTH, 3.0)
    axes = figure.subplots()
    over = ("v", "beta", "gamma")
    good, best, second = single(ds), strong(ds), coexisting(ds)
    gaps = 1e3 * ds.delta.values
    for start, colour in zip(ds.start.values, LINES, strict=False):
        axes.plot(
            gaps, good.sel(start=start).mean(over), "o-", color=colour, markersize=4, label=f"single, from {start}"
        )
    axes.plot(
        gaps, best.sel(start="stuck").mean(over), "s--", color=INK, markersize=4, label="clean, strong, from stuck"
    )
    axes.plot(gaps, second.mean(over), "^:", color=LINES[4], markersize=4, label="a second, worse motion")
    axes.set_xlabel("gap Δ [mm], negative: preload")
    axes.set_ylabel("share of the region")
    axes.set_ylim(-0.03, 1.03)
    axes.set_xticks(np.round(gaps, 1))
    axes.grid(True)
    axes.legend(loc="center left")
    return figure
