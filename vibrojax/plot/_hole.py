"""The bit and the bottom of the hole over time."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from vibrojax.plot._blows import Blows
from vibrojax.plot._labels import number
from vibrojax.plot._style import BIT, FAINT, INK, ROCK

_UNITS = (("mm", 1e3, 2e-4), ("µm", 1e6, 0.0))  # from which swing [m]


def draw_hole(axes: Axes, blows: Blows, start: float, end: float) -> None:
    """Draw the bit's displacement x3 and the hole's depth x4 from `start` to `end` [s]."""
    late = blows.between(start, end)
    factor, unit = length_scale([blows.x3[late], blows.x4[late]])
    axes.grid(True)
    # The hole below: where the bit presses on its bottom, both are seen.
    axes.plot(blows.time[late], factor * blows.x4[late], color=ROCK, linewidth=2.4, label="hole x₄")
    axes.plot(blows.time[late], factor * blows.x3[late], color=BIT, linewidth=0.9, label="bit x₃")
    axes.set_ylabel(f"depth\n[{unit}]")


def draw_rock_forces(axes: Axes, blows: Blows, start: float, end: float) -> None:
    """Draw the given force, the rock's resistance and its threshold from `start` to `end` [s], where there are any."""
    late = blows.between(start, end)
    shown = [force for force in (blows.applied_force, blows.rock_force) if force is not None]
    factor, unit = (1e-3, "kN") if max(np.abs(force).max() for force in shown) >= 1e4 else (1.0, "N")
    axes.grid(True)
    if blows.threshold is not None:
        name = f"threshold D = {number(factor * blows.threshold)} {unit}"
        axes.axhline(factor * blows.threshold, color=ROCK, linewidth=1.0, linestyle=(0, (4, 3)), label=name)
    for force, colour, name in ((blows.applied_force, FAINT, "given I"), (blows.rock_force, INK, "rock N")):
        if force is not None:
            axes.plot(blows.time[late], factor * force[late], color=colour, linewidth=1.0, label=name)
    axes.set_ylabel(f"force\n[{unit}]")


def growth_text(blows: Blows) -> str:
    """How much the hole grew over the run, in words."""
    depth, duration = 1e3 * blows.depth, float(np.ptp(blows.time))
    return f"The hole grows by {depth:.3g} mm in {number(duration)} s" if depth > 0 else "No penetration"


def length_scale(lengths: Sequence[np.ndarray]) -> tuple[float, str]:
    """The factor and the unit in which `lengths` [m] read well."""
    greatest = max((float(np.abs(one).max(initial=0.0)) for one in lengths), default=0.0)
    unit, factor, _ = next((known for known in _UNITS if greatest >= known[2] or greatest == 0.0), _UNITS[-1])
    return factor, unit
