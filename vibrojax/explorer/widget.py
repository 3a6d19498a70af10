"""The page as a widget in a notebook, which passes the selected cell to Python."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import xarray as xr

from vibrojax.errors import InputError
from vibrojax.sweep.input.definition import Sweep

if TYPE_CHECKING:
    from vibrojax.explorer._anywidget import Explorer


def explore(
    ds: xr.Dataset,
    *,
    over: xr.Dataset | None = None,
    sweep: Sweep | Mapping[str, object] | None = None,
    live: bool | None = None,
) -> "Explorer":
    """Return the page of a dataset as a notebook widget: click a cell, and Python has it.

    JupyterLab, Jupyter Notebook from version 7 and VS Code show it. It loads nothing from outside.

    **Arguments:**

    - `ds`: the dataset of a sweep, of its orbits or attractors, of families, borders, a trajectory, or a fit.
    - `over`: borders, as `borders` returns them, to lay over a map of the same parameters.
    - `sweep`: the sweep of the dataset, if it holds your own objects (a scene, a law), which no file can name.
    - `live`: whether the kernel simulates the selected cell, and offers a slider for every parameter. If False, the
      sweep is run again, and the widget holds the motions of all lanes; it needs no kernel after that. None means True
      if the dataset names a scene of the package.

    **Returns:** the widget. Its traits are `cell` (index by axis), `point` (value by axis in SI; a start by its name or
    its states) and `simulated` (`parameters` in SI and `start` of the motion that sliders asked for last). The property
    `lane` is the dataset at the selected cell.

    **Raises:** `InputError` if the dataset holds nothing to show, or anywidget is not installed
    (`pip install "vibrojax[widget]"`); in `widget.point = ...`, if there is no such axis or value.

    **Example:** (in a notebook, a line `widget` shows it; a click selects a cell as `widget.point = ...` does)

    >>> sweep = {"scene": "vibro-impact", "grid": {"beta": [0.3, 0.4]}, "run": {"settle": 8.0}}
    >>> widget = vj.explore(vj.run_sweep(sweep, progress=False))
    >>> widget.observe(lambda change: print("picked", change.new), "point")
    >>> widget.point = {"beta": 0.31, "start": "stuck"}  # the nearest cell; other axes keep their values
    picked {'beta': 0.3, 'start': 'stuck'}
    >>> f"{float(widget.lane.impact_velocity):.2f} m/s"
    '1.70 m/s'
    """
    try:
        from vibrojax.explorer._anywidget import Explorer
    except ModuleNotFoundError as error:
        if error.name not in ("anywidget", "ipywidgets", "traitlets"):
            raise
        raise InputError('explore: anywidget is not installed; pip install "vibrojax[widget]"') from None
    return Explorer(ds, over, sweep, live)
