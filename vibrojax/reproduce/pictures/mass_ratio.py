"""Pictures of the influence of the mass ratio."""

from vibrojax.reproduce.pictures._paper import beside, draw_pair, over_time, strikers, styled, window


@styled
def by_mass(*motions):
    """Phase portraits of the striker at three mass ratios (Fig. 5.80)."""
    figure = strikers(motions, [f"β = {beta}" for beta in (0.25, 0.5, 0.6)], 10.0, share=True, stride=2)
    for axes in figure.axes:
        axes.set_xlim(-165, 10)
    return figure


@styled
def extremes(light, heavy):
    """Phase portraits of bit and striker with a light and a heavy striker (Figs 5.78, 5.81)."""
    figure, panels = beside(4, 2.4)
    for two, motion, beta in zip((panels[:2], panels[2:]), (light, heavy), (0.1, 0.7), strict=True):
        begin = float(motion["time"][-1]) - 1.0
        draw_pair(two, motion.isel(time=window(motion, begin)), begin, stride=2)
        for axes in two:
            axes.set_title(f"β = {beta}")
    panels[0].set_ylabel("velocity [m/s]")
    return figure


@styled
def creeping(motion):
    """Displacement of bit and striker at equal masses (Fig. 5.83)."""
    return over_time([(motion, "x1"), (motion, "x2")], 40.0, stride=8)
