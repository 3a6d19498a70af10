"""The explorer page in a notebook; the class of the widget is in a module of its own, because it needs anywidget."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import xarray as xr

from vibrojax.errors import InputError
from vibrojax.maps.sweep import Sweep

if TYPE_CHECKING:
    from vibrojax.explorer.widget import Explorer


def explore(
    ds: xr.Dataset,
    *,
    over: xr.Dataset | None = None,
    sweep: Sweep | Mapping[str, object] | None = None,
    live: bool | None = None,
) -> "Explorer":
    """Return the explorer page of a dataset as a notebook widget; Python can read the map cell that a click selects.

    JupyterLab, Jupyter Notebook from version 7 and VS Code show the widget. It loads nothing from the network.

    **Arguments:**

    - `ds`: any dataset of the package, or of an analysis with a picture.
    - `over`: result of `borders` or `curves`, to draw on a map of the same parameters, or of `follow`, to draw over the
      returns of a sweep.
    - `sweep`: the sweep of the dataset, if it contains your own objects (a scene, a law), which have no name.
    - `live`: whether the notebook's kernel simulates the motion of the selected map cell, with a slider for every
      parameter. If False, the sweep is run again, and the widget contains the motions of all lanes; it then works
      without a kernel. None: True if the dataset's scene is a scene of the package.

    **Returns:** the widget. The traits `cell` (index by axis) and `point` (value by axis in SI units; an initial
    condition by name or state) are those of the selected map cell. The trait `simulated` has the `parameters` in SI
    units and the `start` of the last motion requested with sliders. The property `lane` is the dataset of the selected
    lane.

    **Raises:** `InputError` if the dataset holds nothing to show, or anywidget is not installed
    (`pip install "vibrojax[widget]"`); in `widget.point = ...`, if there is no such axis or value.

    **Example:** (in a notebook, a line `widget` shows it; a click selects a map cell, as `widget.point = ...` does)

    >>> sweep = {"scene": "vibro-impact", "grid": {"beta": [0.3, 0.4]}, "run": {"settle": 8.0}}
    >>> widget = vj.explore(vj.run_sweep(sweep, progress=False))
    >>> widget.observe(lambda change: print("picked", change.new), "point")
    >>> widget.point = {"beta": 0.31, "start": "stuck"}  # the nearest cell; other axes keep their values
    picked {'beta': 0.3, 'start': 'stuck'}
    >>> f"{float(widget.lane.impact_velocity):.2f} m/s"
    '1.70 m/s'
    """
    try:
        from vibrojax.explorer.widget import Explorer
    except ModuleNotFoundError as error:
        if error.name not in ("anywidget", "ipywidgets", "traitlets"):
            raise
        raise InputError('explore: anywidget is not installed; pip install "vibrojax[widget]"') from None
    return Explorer(ds, over, sweep, live)
