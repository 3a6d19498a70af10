"""Pictures of datasets, chosen to fit the dataset or of requested variables, as a figure or a file."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import xarray as xr
from matplotlib import colormaps
from matplotlib.figure import Figure

from vibrojax.analyses.accuracy.picture import work_precision as work_precision
from vibrojax.analyses.registry import analysis_of
from vibrojax.analyses.rop_law.picture import Fits
from vibrojax.analyses.sweep.analysis import Sweeps
from vibrojax.analyses.sweep.basins import many_starts, share_grid
from vibrojax.analyses.sweep.maps import rate_grid, regime_grid
from vibrojax.analyses.sweep.rates import rates as rates
from vibrojax.analyses.sweep.returns import bifurcation as bifurcation
from vibrojax.analyses.trajectory.hole import pulses as pulses
from vibrojax.analyses.trajectory.hole import response as response
from vibrojax.analyses.trajectory.time_history import trajectory as trajectory
from vibrojax.analyses.variables_picture import variables
from vibrojax.errors import InputError, nearest, shown
from vibrojax.io.atomic import atomic_write
from vibrojax.plot.colours import REGIME_COLOURS as REGIME_COLOURS
from vibrojax.plot.contents import Contents, Value, law_in, regimes_in, select, thin_out, thinned_text
from vibrojax.plot.overlays import Overlays, as_layers, refuse_overlays
from vibrojax.plot.style import COLOURS, settings

# Files contain no date, so that the same dataset gives the same file.
_METADATA: dict[str, dict[str, None]] = {".png": {}, ".pdf": {"CreationDate": None}, ".svg": {"Date": None}}


def picture(
    ds: xr.Dataset,
    variable: str | Sequence[str] | None = None,
    where: Mapping[str, Value] | None = None,
    colours: str | None = None,
    over: Overlays = None,
) -> Figure:
    """Draw the picture that fits a dataset.

    It shows a motion, section crossings, regimes, rates of penetration, a fitted law, families, borders or attractors.

    **Arguments:**

    - `ds`: a dataset of `simulate`, a sweep, or an analysis.
    - `variable`: name of a variable to draw instead, over all varied axes; or a list of up to four names, for a run up
      to eight.
    - `where`: values by name of axis or coordinate, in the dataset's units; only lanes with these values are drawn.
      Example: `{"delta": 0.005, "start": "stuck"}`. Numbers must be accurate to four digits. Of more than 300,000
      lanes, only every second value of the longest axes is drawn, or every third, ...
    - `colours`: name of a matplotlib colour map for quantities; regimes, formulas of the fitted law and initial
      conditions keep their colours.
    - `over`: datasets to draw on top. Families of orbits, from `follow`, are drawn over the section crossings of a
      sweep along the same parameter, or over lanes carried along it. Borders, from `borders`, are drawn over the map of
      regimes.

    **Returns:** a figure that pyplot does not manage.

    **Raises:** `InputError` if the dataset holds nothing to draw, there is no such variable, axis, value or colour map,
    or `over` cannot be drawn on this picture.

    **Example:**

    >>> axes = {"beta": [0.3, 0.4, 0.5], "gamma": [0.6, 0.7, 0.8]}
    >>> ds = vj.run_sweep({"scene": "vibro-impact", "grid": axes}, progress=False)
    >>> figure = vj.picture(ds, variable="stick_fraction", where={"start": "stuck"})
    >>> figure.savefig("stick.png")
    """
    if not isinstance(ds, xr.Dataset):
        raise InputError(f"{shown(ds)} is not a dataset; open it first: vj.picture(vj.open_dataset(PATH))")
    if colours is not None and colours not in colormaps:
        like = nearest(str(colours), colormaps)
        right = f"did you mean {shown(like)}?" if like else "choose one of matplotlib's, like viridis or magma"
        raise InputError(f"colours: {shown(colours)} is not a colour map; {right}")
    layers = as_layers(over)
    token = COLOURS.set(colours)
    try:
        ds = select(ds, where) if where else ds
        ds = ds if layers else thin_out(ds)
        if variable is None:
            return analysis_of(ds).picture(ds, layers)
        if layers:
            refuse_overlays(layers, "over no other variable")
        return variables(ds, (variable,) if isinstance(variable, str) else variable)
    finally:
        COLOURS.reset(token)


def regime_map(ds: xr.Dataset, x: str | None = None, y: str | None = None) -> Figure:
    """Draw the regimes of a sweep as a map, with maps of impact velocity and period next to it.

    Each value of further axes and each initial condition gets a panel, twelve at most; the figure notes which values
    are shown. A sweep along one axis is drawn as lines. A list of points is drawn as dots over its two varied
    parameters, or else as bars with the number of lanes in each regime. More than eight initial conditions are drawn as
    a map over initial states if few parameters vary. If many parameters vary, the map shows the fraction of initial
    conditions that ends in each regime.

    **Arguments:** `x`, `y`: axes to draw along; by default gamma and beta, else the first two axes with six or more
    values, else the first two axes.

    **Raises:** `InputError` if there are no regimes, or `x` or `y` is not an axis.
    """
    ds = thin_out(ds)
    held = Contents(regimes_in(ds))
    if held.many_starts:
        return many_starts(ds) if x is None and y is None else share_grid(ds, x, y)
    if held.points or (x is None and y is None):
        return Sweeps.drawn_as(ds, "regimes")
    return regime_grid(ds, x, y)


def rate_map(ds: xr.Dataset, x: str | None = None, y: str | None = None) -> Figure:
    """Draw the rate of penetration over two axes, with slip per blow, mean force and relief if there is room.

    Each value of further axes gets a panel, nine at most; the figure notes which are shown. Constant values are in the
    note. A list of points is drawn as dots over its two varied parameters.

    **Arguments:** `x`, `y`: axes to draw along; by default the frequency, then the longest axes.

    **Raises:** `InputError` if there are no rates, fewer than two axes, or `x` or `y` is not an axis.
    """
    return rate_grid(thin_out(ds), x, y)


def fitted_law(fit: xr.Dataset) -> Figure:
    """Draw C of ROP = C ln(eta) in its three readings, and each formula's AIC relative to the best of its group.

    At the top are the data of each group with the curve of every formula, for six groups at most. C and AIC are drawn
    over the longest axis of the groups, with one row per value of further axes. If two axes have nine or more values, C
    and the best formula are drawn as maps. Without groups, the horizontal axis lists the formulas.

    **Raises:** `InputError` if there is no C along `form`.
    """
    law_in(fit)
    return Fits().picture(fit)


def save_picture(
    ds: xr.Dataset,
    path: str | Path,
    variable: str | Sequence[str] | None = None,
    where: Mapping[str, Value] | None = None,
    colours: str | None = None,
    over: Overlays = None,
) -> str:
    """Save the picture that fits a dataset to a file, atomically: the file is complete or does not exist.

    **Arguments:**

    - `ds`, `variable`, `where`, `colours`, `over`: as for [vibrojax.analyses.pictures.picture][].
    - `path`: file name that ends in .png, .pdf or .svg.

    **Returns:** a description of the values that are drawn, or "" if all are drawn.

    **Raises:** `InputError` for another file extension, a path that cannot be written, or for the reasons of `picture`.

    **Example:**

    >>> motion = vj.simulate("vibro-impact", start="stuck", duration=4.0, progress=False)
    >>> vj.save_picture(motion, "motion.svg")  # nothing is left out
    ''
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _METADATA:
        raise InputError(f"{path}: pictures end in .png, .pdf or .svg, not in {suffix or 'nothing'}")
    figure = picture(ds, variable, where, colours, over)
    try:
        with settings(), atomic_write(path, "part") as part:
            figure.savefig(part, format=suffix[1:], metadata=_METADATA[suffix])
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); give another file") from None
    return thinned_text(select(ds, where) if where else ds)
