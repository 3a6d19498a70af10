"""Pictures of datasets: the one that fits, or any variable, as a figure or a file."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import xarray as xr
from matplotlib import colormaps
from matplotlib.figure import Figure

from vibrojax.analyses.accuracy.picture import work_precision as work_precision
from vibrojax.analyses.registry import analysis_of
from vibrojax.analyses.rop_law.analysis import Fits
from vibrojax.analyses.sweep.analysis import Sweeps
from vibrojax.analyses.sweep.basins import many_starts, share_grid
from vibrojax.analyses.sweep.bifurcation import bifurcation as bifurcation
from vibrojax.analyses.sweep.maps import rate_grid, regime_grid
from vibrojax.analyses.sweep.rates import rates as rates
from vibrojax.analyses.trajectory.hole import pulses as pulses
from vibrojax.analyses.trajectory.hole import response as response
from vibrojax.analyses.trajectory.time_history import trajectory as trajectory
from vibrojax.analyses.variables_picture import variables
from vibrojax.errors import InputError, nearest, shown
from vibrojax.io.atomic import atomic_write
from vibrojax.plot.colours import REGIME_COLOURS as REGIME_COLOURS
from vibrojax.plot.contents import contents, law_in, rates_in, regimes_in
from vibrojax.plot.overlays import refuse_overlays, several
from vibrojax.plot.selection import Value, select
from vibrojax.plot.style import COLOURS, settings
from vibrojax.plot.thinned import thinned, thinned_text

# Without the date, so that the same dataset gives the same file.
_METADATA: dict[str, dict[str, None]] = {".png": {}, ".pdf": {"CreationDate": None}, ".svg": {"Date": None}}


def picture(
    ds: xr.Dataset,
    variable: str | Sequence[str] | None = None,
    where: Mapping[str, Value] | None = None,
    colours: str | None = None,
    over: xr.Dataset | Sequence[xr.Dataset] | None = None,
) -> Figure:
    """The fitting picture for what `ds` holds: a trajectory, returns, regimes, rates of penetration, a law, families of
    orbits, borders, or shares of attractors.

    **Arguments:**

    - `ds`: what `simulate`, a sweep, a fit, `follow` or the study of speed against error gives.
    - `variable`: the name of a variable to draw instead, over all that varies; or several names, four at most, of a run
      eight.
    - `where`: values of axes or of coordinates along them, by name, in the dataset's units: only the lanes there are
      drawn, `{"delta": 0.005, "start": "stuck"}`. Numbers need be right to four digits. Of more than 300,000 lanes
      every second value of the longest axes is drawn, or every third, ...
    - `colours`: the name of the matplotlib colour map for quantities; regimes, forms and starts keep their colours.
    - `over`: families of orbits, as `follow` gives them, in one dataset or several, to lay over the returns of a sweep
      along the same parameter, or over lanes carried along it; or borders, as `borders` gives them, to lay over the map
      of regimes.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where the dataset holds nothing to draw, or no such variable, axis, value or colour map; or
    `over` does not belong there.

    **Example:**

    >>> axes = {"beta": [0.3, 0.4, 0.5], "gamma": [0.6, 0.7, 0.8]}
    >>> ds = vj.run_sweep({"scene": "vibro-impact", "grid": axes}, progress=False)
    >>> figure = vj.picture(ds, variable="stick_fraction", where={"start": "stuck"})
    >>> figure.savefig("stick.png")
    """
    if not isinstance(ds, xr.Dataset):
        raise InputError(f"{shown(ds)} is no dataset; open it first: vj.picture(vj.open_dataset(PATH))")
    if colours is not None and colours not in colormaps:
        like = nearest(str(colours), colormaps)
        right = f"did you mean {shown(like)}?" if like else "choose one of matplotlib's, like viridis or magma"
        raise InputError(f"colours: {shown(colours)} is no colour map; {right}")
    layers = several(over)
    token = COLOURS.set(colours)
    try:
        ds = select(ds, where) if where else ds
        ds = ds if layers else thinned(ds)
        if variable is None:
            return analysis_of(ds).picture(ds, layers)
        if layers:
            refuse_overlays(layers, "over no other variable")
        return variables(ds, (variable,) if isinstance(variable, str) else variable)
    finally:
        COLOURS.reset(token)


def regime_map(ds: xr.Dataset, x: str | None = None, y: str | None = None) -> Figure:
    """The regimes of a sweep as a map, with impact velocity and period beside it.

    Further axes, and the starts, become panels: twelve at most, and the figure says which. A sweep along one axis
    becomes lines, a list of points a scatter (two parameters vary) or a count. More than eight starts are a map over
    their states where nothing else varies over many values, else the share of them that ends in each regime.

    **Arguments:**

    - `ds`: a sweep's dataset, with `regime` and, where the scene has them, `impact_velocity` [m/s] and `period` [s].
    - `x`, `y`: the axes to draw along; left out: gamma and beta, else the first two of six values or more, else the
      first two.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where there are no regimes, or `x` or `y` is no axis of the sweep.
    """
    ds = thinned(ds)
    held = contents(regimes_in(ds))
    if held.many_starts:
        return many_starts(ds) if x is None and y is None else share_grid(ds, x, y)
    if held.points or (x is None and y is None):
        return Sweeps.drawn_as(ds, "regimes")
    return regime_grid(ds, x, y)


def rate_map(ds: xr.Dataset, x: str | None = None, y: str | None = None) -> Figure:
    """The rate of penetration as a map over two axes, with slip per blow, mean force and relief where there is room.

    Further axes become panels: nine at most, and the figure says which. What is the same all over is in the note. A
    list of points is scattered over the two parameters that vary.

    **Arguments:**

    - `ds`: a sweep's dataset with `rate_of_penetration` [m/s], and `slip_per_impact` [m], `mean_force` [N] and `relief`
      [1] where there are any.
    - `x`, `y`: the axes to draw along; left out: the frequency, then the longest.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where there are no rates, there are no two axes, or `x` or `y` is no axis of the sweep.
    """
    ds = thinned(ds)
    return Sweeps.drawn_as(ds, "rate map") if contents(rates_in(ds)).points else rate_grid(ds, x, y)


def fitted_law(fit: xr.Dataset) -> Figure:
    """C of ROP = C ln(eta) in its three readings, and the AIC of every form above that of the best of its group.

    Above them the data of each group with the curve of every form, six groups at most. C and AIC are drawn over
    the longest axis of the groups; further ones become rows. Over two axes of nine values and more, maps of C and of
    the best form. Without groups, over the forms.

    **Arguments:**

    - `fit`: a fit's dataset: `C`, `C_stderr` [m/s] and `aic` along the groups and `form`.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where there is no C along `form`.
    """
    law_in(fit)
    return Fits().picture(fit)


def save_picture(
    ds: xr.Dataset,
    path: str | Path,
    variable: str | Sequence[str] | None = None,
    where: Mapping[str, Value] | None = None,
    colours: str | None = None,
    over: xr.Dataset | Sequence[xr.Dataset] | None = None,
) -> str:
    """Draw the fitting picture for `ds` into the file `path`, which is there whole or not at all.

    **Arguments:**

    - `ds`: what `simulate` or a sweep gives.
    - `path`: ends in .png, .pdf or .svg.
    - `variable`, `where`, `colours`, `over`: what to draw of it, and how; see [vibrojax.analyses.pictures.picture][].

    **Returns:** which of its values are drawn, in words; nothing where all are.

    **Raises:** `InputError` for another ending, a path that cannot be written, or what `picture` refuses.

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
