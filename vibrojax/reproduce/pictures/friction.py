"""Pictures of the friction laws."""

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

from vibrojax.label import REGIMES
from vibrojax.physics.friction import FRICTION_LAWS
from vibrojax.plot import REGIME_COLOURS
from vibrojax.reproduce._friction import LAWS, curve
from vibrojax.reproduce.pictures._paper import FAINT, WIDTH, new_figure, styled


@styled
def curves():
    """mu of each law over the sliding speed (Figs 3.8 to 3.13, 5.12)."""
    figure = new_figure(WIDTH, 3.6)
    speeds = np.linspace(0, 5, 1001)
    for axes, law in zip(figure.subplots(2, 3, sharex=True, sharey=True).ravel(), LAWS, strict=True):
        mu = curve(law, speeds)
        axes.plot(np.concatenate([-speeds[::-1], speeds]), np.concatenate([-mu[::-1], mu]), linewidth=1.2)
        axes.axhline(0, color=FAINT, linewidth=0.5)
        axes.set_title(f"{law} ({FRICTION_LAWS[law].reference})", fontsize=8)
        axes.set_ylim(-0.75, 0.75)
        axes.grid(True)
    figure.supxlabel("sliding speed u [m/s]", fontsize=9)
    figure.supylabel("friction coefficient μ sgn u", fontsize=9)
    return figure


@styled
def regimes(*maps):
    """Regimes over beta and gamma under each law."""
    figure = new_figure(WIDTH, 4.2)
    colours = ListedColormap([REGIME_COLOURS[flag] for flag in range(len(REGIMES))])
    panels = figure.subplots(2, 3, sharex=True, sharey=True)
    for axes, ds, law in zip(panels.ravel(), maps, LAWS, strict=True):
        regime = ds.regime.sel(start="drive").transpose("gamma", "beta")
        axes.pcolormesh(ds.beta, ds.gamma, regime, cmap=colours, vmin=-0.5, vmax=len(REGIMES) - 0.5)
        axes.set_title(law)
    for axes in panels[-1]:  # a label of the whole figure would lie under the legend
        axes.set_xlabel("mass ratio β")
    for axes in panels[:, 0]:
        axes.set_ylabel("frequency ratio γ")
    shown = sorted({int(flag) for ds in maps for flag in np.unique(ds.regime)})
    handles = [Patch(facecolor=REGIME_COLOURS[flag], edgecolor=FAINT, label=REGIMES[flag]) for flag in shown]
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return figure
