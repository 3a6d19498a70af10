"""The trajectory of a bit on rock under a given force: the hole's steps, and the last blows enlarged."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec

from vibrojax.plot._about import point_text
from vibrojax.plot._blows import Blows, read_blows
from vibrojax.plot._hole import draw_hole, draw_rock_forces, growth_text
from vibrojax.plot._sheet import write_margins
from vibrojax.plot._style import FAINT, new_figure, styled

_ENLARGED = 2  # blows
_LEAD = 0.08  # of the time between blows, shown before the first of them


@styled
def pulses(ds: xr.Dataset, last: float | None = None) -> Figure:
    """Bit and hole above the forces on the bit: the whole run, and beside it its end enlarged.

    **Arguments:**

    - `ds`: what `simulate` gives for the penetration scene: `x3`, `x4` [m] along `time` [s]; `applied_force` and
      `rock_force` [N] where there are any.
    - `last`: how much of the end to enlarge [s]; left out: the last two blows.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where the dataset holds no such trajectory.
    """
    blows = read_blows(ds)
    first, end = float(blows.time[0]), float(blows.time[-1])
    late = _last_blows(blows) if last is None else max(end - last, first)
    forces = blows.applied_force is not None or blows.rock_force is not None
    figure = new_figure(10.0, 5.4 if forces else 3.4)
    grid = GridSpec(1 + forces, 2, figure, width_ratios=[1.25, 1.0], height_ratios=[1.3, 1.0][: 1 + forces])
    for column, start in enumerate((first, late)):
        shown: list[Axes] = [figure.add_subplot(grid[0, column])]
        draw_hole(shown[0], blows, start, end)
        if forces:
            shown.append(figure.add_subplot(grid[1, column], sharex=shown[0]))
            draw_rock_forces(shown[1], blows, start, end)
            shown[0].tick_params(labelbottom=False)
        shown[0].set_xlim(start, end)
        shown[-1].set_xlabel("time [s]")
        for axes in shown:
            if column == 0:
                axes.axvspan(late, end, color=FAINT, alpha=0.25, linewidth=0)
                axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderpad=0.0, borderaxespad=0.3)
    shown[0].set_title("enlarged: the shaded end of the run", loc="right")
    figure.align_ylabels()
    write_margins(figure, str(ds.attrs.get("title") or ds.attrs.get("scene", "")), point_text(ds), growth_text(blows))
    return figure


def _last_blows(blows: Blows) -> float:
    """When the last two blows begin, a little before [s]; the last fifth where there are no more than these."""
    begun = blows.begun
    if begun.size <= _ENLARGED + 1:
        return float(blows.time[-1] - 0.2 * np.ptp(blows.time))
    between = float(np.median(np.diff(begun)))
    begun = begun[begun < blows.time[-1] - 0.5 * between]  # one cut short by the end of the run does not count
    return float(begun[-_ENLARGED] - _LEAD * between)
