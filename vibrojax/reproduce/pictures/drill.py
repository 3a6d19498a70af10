"""Pictures of the whole drill."""

from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce.pictures._paper import (
    BIT,
    IMPACT,
    LINES,
    ROCK,
    WIDTH,
    new_figure,
    pair,
    stacked,
    styled,
    window,
)


@styled
def steps(motion):
    """Impact force, and bit and hole, over three cycles (Figs 6.29, 6.31)."""
    begin, end = signal.last_cycle(motion)
    inside = window(motion, end - 3 * (end - begin), end)
    time = motion["time"].values[inside]
    figure, panels = stacked(2, 1.5)
    panels[0].plot(time, motion["impact_force"].values[inside] / 1e3, color=IMPACT)
    panels[1].plot(time, 1e3 * motion["x4"].values[inside], color=ROCK, linewidth=2.0, label="hole x₄")
    panels[1].plot(time, 1e3 * motion["x3"].values[inside], color=BIT, linewidth=0.9, label="bit x₃")
    panels[0].set_ylabel("impact J [kN]")
    panels[1].set_ylabel("x₃, x₄ [mm]")
    panels[1].set_xlabel("time [s]")
    panels[1].legend(loc="upper left")
    return figure


@styled
def over_relief(ds):
    """Rate of penetration over P/D, varied by the speed (Figs 6.33, 6.34)."""
    figure = new_figure(WIDTH, 3.0)
    axes = figure.subplots()
    part = ds.sel(start="drive")
    for k3, colour in zip(part.k3.values, LINES, strict=False):
        one = part.sel(k3=k3)
        label = f"k₃ = {k3 / 1e6:g} MN/m"
        axes.plot(one.relief, 1e3 * one.rate_of_penetration, "o-", color=colour, markersize=4, label=label)
    axes.set_xlabel("relief P/D (D 50 kN), by v from 0.5 to 2.5 m/s")
    axes.set_ylabel("rate of penetration [mm/s]")
    axes.grid(True)
    axes.legend()
    return figure


@styled
def portraits(motion):
    """Phase portraits of bit and striker while drilling (Figs 6.35, 6.36)."""
    return pair(motion, 6.0)
