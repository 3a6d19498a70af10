"""Pictures of the influence of the mass ratio."""

from vibrojax.reproduce.pictures._paper import BIT, STRIKER, beside, draw_portrait, stacked, styled, window


@styled
def strikers(*motions):
    """Phase portraits of the striker at three mass ratios (Fig. 5.80)."""
    figure, panels = beside(3, 2.6, share=True)
    for axes, motion, beta in zip(panels, motions, (0.25, 0.5, 0.6), strict=True):
        draw_portrait(axes, motion.isel(time=window(motion, 10.0)), "x2", "v2", STRIKER, 10.0, stride=2)
        axes.set_title(f"β = {beta}")
        axes.set_xlabel("x₂ [mm]")
        axes.set_xlim(-165, 10)
    panels[0].set_ylabel("x₂′ [m/s]")
    return figure


@styled
def extremes(light, heavy):
    """Phase portraits of bit and striker with a light and a heavy striker (Figs 5.78, 5.81)."""
    figure, panels = beside(4, 2.4)
    for pair, motion, beta in zip((panels[:2], panels[2:]), (light, heavy), (0.1, 0.7), strict=True):
        for axes, number, colour in zip(pair, (1, 2), (BIT, STRIKER), strict=True):
            end = float(motion["time"][-1]) - 1.0
            late = motion.isel(time=window(motion, end))
            draw_portrait(axes, late, f"x{number}", f"v{number}", colour, end, stride=2)
            axes.set_title(f"β {beta}, {'bit' if number == 1 else 'striker'}")
            axes.set_xlabel(f"x{'₁₂'[number - 1]} [mm]")
    panels[0].set_ylabel("velocity [m/s]")
    return figure


@styled
def creeping(motion):
    """Displacement of bit and striker at equal masses (Fig. 5.83)."""
    figure, panels = stacked(2, 1.3)
    for axes, name, colour, label in zip(panels, ("x1", "x2"), (BIT, STRIKER), ("x₁ [mm]", "x₂ [mm]"), strict=True):
        axes.plot(motion["time"][::8], 1e3 * motion[name][::8], color=colour, linewidth=0.4, rasterized=True)
        axes.set_ylabel(label)
    panels[1].set_xlabel("time [s]")
    panels[1].set_xlim(0, 40)
    return figure
