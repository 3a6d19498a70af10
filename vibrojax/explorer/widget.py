"""In a notebook: the page as a widget, which gives what is picked to Python."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import xarray as xr

from vibrojax.errors import InputError
from vibrojax.sweep.input.definition import Sweep
from vibrojax.sweep.input.read import read_sweep

if TYPE_CHECKING:
    from vibrojax.explorer._anywidget import Explorer


def explore(
    ds: xr.Dataset,
    *,
    over: xr.Dataset | None = None,
    sweep: Sweep | Mapping[str, object] | None = None,
    live: bool | None = None,
) -> "Explorer":
    """The page of a dataset as a widget of a notebook: click a cell, and Python has it.

    It is shown by JupyterLab, Jupyter Notebook from 7 on and VS Code, and loads nothing from outside.

    **Arguments:**

    - `ds`: the dataset of a sweep, of its orbits or attractors, of families, borders, a trajectory, or a fit.
    - `over`: borders, as `borders` gives them, to lay over a map of the same parameters.
    - `sweep`: the sweep that the dataset is of, where it holds objects of yours (a scene, a law), which no file names.
    - `live`: whether the kernel simulates what is picked, and what sliders for every parameter say. False: the widget
      holds the motions of all lanes, for which a sweep is run again, and needs no kernel once it is shown. None: True
      wherever the dataset names a scene of the package.

    **Returns:** the widget, with the traits `cell` (index by axis), `point` (value by axis in SI; a start by its name
    or its states) and `simulated` (`parameters` in SI and `start` of the motion shown last, if sliders said so), and
    the property `lane` (the dataset at the picked cell).

    **Raises:** `InputError` where there is nothing of the dataset to show, or anywidget is not installed
    (`pip install "vibrojax[widget]"`); in `widget.point = ...` where there is no such axis or value.

    **Example:** (in a notebook, a line `widget` shows it; a click picks a cell as `widget.point = ...` does)

    >>> sweep = {"scene": "vibro-impact", "grid": {"beta": [0.3, 0.4]}, "run": {"settle": 8.0}}
    >>> widget = vj.explore(vj.run_sweep(sweep, progress=False))
    >>> widget.observe(lambda change: print("picked", change.new), "point")
    >>> widget.point = {"beta": 0.31, "start": "stuck"}  # the nearest cell; what is not named stays
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
    own = read_sweep(sweep) if isinstance(sweep, Mapping) else sweep
    return Explorer(ds, over, own, live)
