"""Pictures of the law of the rate of penetration."""

import numpy as np

from vibrojax.laws import fit_rop
from vibrojax.reproduce.pictures._paper import FAINT, INK, LINES, WIDTH, beside, new_figure, styled


@styled
def shapes(ds):
    """The rate over P/D with the logarithm and the line (eq. 6.4)."""
    figure, panels = beside(2, 3.0)
    part = ds.sel(pulse_width=0.004, drop=True)
    fit = fit_rop(part, along="frequency", progress=False)
    for axes, k3 in zip(panels, part.k3.values, strict=True):
        for force, colour in zip(part.force.values, LINES, strict=False):
            one, law = part.sel(k3=k3, force=force), fit.sel(k3=k3, force=force)
            relief = np.linspace(1e-3, 1.05 * float(one.relief.max()), 200)
            log = float(law.C.sel(form="onset")) * np.log(relief / float(law.eta0.sel(form="onset")))
            axes.plot(relief, np.where(log > 0, 1e3 * log, np.nan), color=colour, linestyle="--", linewidth=0.9)
            axes.plot(relief, 1e3 * float(law.C.sel(form="line")) * relief, color=colour, linewidth=0.9)
            axes.plot(one.relief, 1e3 * one.rate_of_penetration, "o", color=colour, label=f"{force / 1e3:g} kN")
        axes.set_title(f"k₃ = {k3 / 1e6:g} MN/m")
        axes.set_xlabel("relief P/D")
        axes.grid(True)
    panels[0].set_ylabel("rate of penetration [mm/s]")
    panels[0].plot([], [], color=INK, linewidth=0.9, label="line")
    panels[0].plot([], [], color=INK, linewidth=0.9, linestyle="--", label="logarithm")
    panels[0].legend()
    return figure


@styled
def constants(ds):
    """C over force, stiffness and pulse width."""
    figure = new_figure(WIDTH, 2.8)
    axes = figure.subplots()
    axes.axhspan(0.046, 0.189, color=FAINT, alpha=0.3, linewidth=0)
    for width, look in zip(ds.pulse_width.values, ("s--", "o-"), strict=True):
        fit = fit_rop(ds.sel(pulse_width=width, drop=True), along="frequency", progress=False)
        for k3, colour in zip(ds.k3.values, LINES, strict=False):
            found = 2 * np.pi * fit.C.sel(form="onset", k3=k3)
            label = f"{k3 / 1e6:g} MN/m, {1e3 * width:g} ms"
            axes.plot(ds.force / 1e3, found, look, color=colour, markersize=4, label=label)
    axes.set_xlabel("force [kN]")
    axes.set_ylabel("C [m/s], listing's rate")
    axes.grid(True)
    axes.legend()
    return figure
