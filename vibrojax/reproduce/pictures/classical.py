"""Pictures of the classical checks."""

import numpy as np

from vibrojax.physics.contact import restitution
from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce.pictures._paper import BIT, FAINT, INK, WIDTH, new_figure, stacked, styled

XIS = (0.1, 0.3, 0.5, 0.7, 0.91)


@styled
def struck(*found):
    """Displacement over time of the three struck masses."""
    figure, panels = stacked(3, 1.1, share=False)
    cases = (("free, on an elastic stop", 0.0, 2.0), ("Tsaplin's hammer", 58.0, 60.0), ("thrown ball", 58.0, 60.0))
    for axes, one, (title, begin, end) in zip(panels, found, cases, strict=True):
        time, x = one.path
        inside = (time >= begin) & (time <= end)
        axes.plot(time[inside] - begin, 1e3 * x[inside], color=BIT, linewidth=1.1)
        for at in one.times[(one.times >= begin) & (one.times <= end)]:
            axes.axvline(at - begin, color=FAINT, linewidth=0.6)
        axes.set_title(title, loc="left")
        axes.set_ylabel("x [mm]")
    panels[-1].set_xlabel("time [s]")
    return figure


@styled
def restitutions(*motions):
    """Restitution over the loss factor (eq. 5.8)."""
    figure = new_figure(WIDTH, 2.8)
    axes = figure.subplots()
    xi = np.linspace(0, 1, 200)
    axes.plot(xi, restitution(xi), color=INK, linewidth=1.1, label="closed form")
    axes.plot(XIS, [signal.restitution(one) for one in motions], "o", color=BIT, label="simulated blow")
    axes.set_xlabel("loss factor ξ")
    axes.set_ylabel("restitution R")
    axes.grid(True)
    axes.legend()
    return figure
