"""Pictures of datasets, chosen to fit the dataset or of requested variables, as a figure or a file."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.figure import Figure

from vibrojax.errors import InputError, Place, nearest, shown, suggestion
from vibrojax.io.atomic import atomic_write
from vibrojax.io.files import source
from vibrojax.io.identity import PICTURE_KEYS
from vibrojax.io.kinds import check_flags, kind_of
from vibrojax.pictures import contents
from vibrojax.pictures.colours import regime_value, value_of
from vibrojax.pictures.contents import FORM, MULTIPLIER, POINT, REGIME, RETURN, TIME, Contents
from vibrojax.pictures.draw import OwnFigure, draw
from vibrojax.pictures.layout import WIDTH, read_width
from vibrojax.pictures.lines import curves, regime_lines
from vibrojax.pictures.maps import map_sheet
from vibrojax.pictures.motion import histories
from vibrojax.pictures.overlays import Overlays, as_layers, refuse_overlays
from vibrojax.pictures.plots import Picture, Sheet
from vibrojax.pictures.returns import bifurcation, hysteresis
from vibrojax.pictures.selection import Value, select, thin_out, thinned_text
from vibrojax.pictures.starts import many_starts, medians, medians_text, varied_states
from vibrojax.pictures.style import COLOURS, SAVED_DPI, drawable, settings
from vibrojax.settings.values import check_distinct, choice
from vibrojax.studies.analysis import analysis_of

# Files contain no date, so that the same dataset gives the same file.
_METADATA: dict[str, dict[str, None]] = {".png": {}, ".pdf": {"CreationDate": None}, ".svg": {"Date": None}}


def picture(
    ds: xr.Dataset,
    variable: str | Sequence[str] | None = None,
    where: Mapping[str, Value] | None = None,
    colours: str | None = None,
    over: Overlays = None,
    diagram: str | None = None,
    width: str | float | int | None = None,
) -> Figure:
    """Draw a dataset as a picture that suits its contents.

    **Arguments:**

    - `ds`: dataset of `simulate`, of a sweep, or of an analysis.
    - `variable`: name of the variable to draw, or a list of up to four names (eight for a result of `simulate`). The
      variable "return_x", the state x at the section crossings, gives a bifurcation diagram.
    - `where`: values of some axes or coordinates by name, in the units of the dataset; only lanes with these values are
      drawn. Example: `{"delta": 0.005, "start": "stuck"}`. Selected values must agree with the dataset to four digits.
      At most 300,000 lanes are drawn.
    - `colours`: name of a matplotlib colour map for quantities. Regimes, initial conditions and the forms of a fitted
      law have fixed colours.
    - `over`: datasets to draw on top of the picture. A result of `follow` can be drawn on top of a bifurcation diagram
      of a sweep over the same parameter, and a result of `borders` or `curves` on top of a map of regimes.
    - `diagram`: name of a diagram, in place of the default picture. The diagram "campbell" shows the frequencies of a
      sweep's motions, the natural frequencies and the multiples of the rotation frequency as functions of the speed.
      "rate-over-force" shows the rate of penetration as a function of the mean force, and "chart" the region of the
      robust single impact in a plane of two parameters.
    - `width`: width of the picture, as a text such as "85mm" (a journal column) or "170mm" (a page), or as a number of
      millimetres.

    **Returns:** a matplotlib figure, which pyplot does not manage.

    **Raises:** `InputError` if the dataset holds nothing to draw, if a variable, axis, value or colour map does not
    exist, or if the picture cannot be combined with the datasets in `over`.

    **Example:**

    >>> axes = {"beta": [0.3, 0.4, 0.5], "gamma": [0.6, 0.7, 0.8]}
    >>> ds = vj.run_sweep({"scene": "vibro-impact", "grid": axes}, progress=False)
    >>> figure = vj.picture(ds, variable="stick_fraction", where={"start": "stuck"})
    >>> figure.savefig("stick.png")
    """
    if not isinstance(ds, xr.Dataset):
        raise InputError(f"{shown(ds)} is not a dataset; open it first: vj.picture(vj.open_dataset(PATH))")
    for name, data in ds.variables.items():
        check_flags(Place(f"variable {name}"), data)
        # Means of flags are float64 and may be flags by chance; where and missing lanes give float32, or NaN.
        if "flag_meanings" in data.attrs and data.dtype == np.float64 and not np.isnan(data.values).any():
            raise InputError(f"variable {name}: its flags are float64, as means are; reduce the data without {name}")
    if colours is not None and colours not in colormaps:
        like = nearest(str(colours), colormaps)
        right = f"did you mean {shown(like)}?" if like else "choose one of matplotlib's, like viridis or magma"
        raise InputError(f"colours: {shown(colours)} is not a colour map; {right}")
    if diagram is not None:
        from vibrojax.studies.diagrams import DIAGRAMS

        choice(Place("diagram"), diagram, DIAGRAMS)
        if variable is not None or over is not None:
            raise InputError(f"diagram: {diagram} draws its own variables; leave variable and over out")
    layers = as_layers(over)
    token, width_token = COLOURS.set(colours), WIDTH.set(read_width(width))
    try:
        ds = select(ds, where) if where else ds
        ds = ds if layers else thin_out(ds)
        if diagram is None and variable is None:
            return analysis_of(ds).picture(ds, layers)
        return draw(requested(drawable(ds), () if variable is None else variable, layers, diagram))
    finally:
        COLOURS.reset(token)
        WIDTH.reset(width_token)


def save_picture(
    ds: xr.Dataset,
    path: str | Path,
    variable: str | Sequence[str] | None = None,
    where: Mapping[str, Value] | None = None,
    colours: str | None = None,
    over: Overlays = None,
    diagram: str | None = None,
    width: str | float | int | None = None,
) -> str:
    """Draw a dataset as `picture` does, and save the picture.

    **Arguments:**

    - `ds`, `variable`, `where`, `colours`, `over`, `diagram`, `width`: as for [vibrojax.studies.choose.picture][].
    - `path`: file name that ends in .png, .pdf or .svg.

    **Returns:** a text that states which values are drawn, or "" if all are.

    **Raises:** `InputError` if `path` has another extension or cannot be written, or if `picture` raises it.

    **Example:**

    >>> motion = vj.simulate("vibro-impact", start="stuck", duration=4.0, progress=False)
    >>> vj.save_picture(motion, "motion.svg")  # nothing is left out
    ''
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _METADATA:
        raise InputError(f"{path}: pictures end in .png, .pdf or .svg, not in {suffix or 'nothing'}")
    figure = picture(ds, variable, where, colours, over, diagram, width)
    try:
        with settings(), atomic_write(path, "part") as part:
            metadata = {**_METADATA[suffix], PICTURE_KEYS[suffix]: source()}
            if suffix == ".png" and isinstance(figure, OwnFigure):
                figure.set_dpi(SAVED_DPI)
                figure.save_png(part, metadata=metadata)
            else:
                figure.savefig(part, format=suffix[1:], metadata=metadata)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); give another file") from None
    return thinned_text(select(ds, where) if where else ds)


def requested(
    ds: xr.Dataset, variable: str | Sequence[str] = (), layers: Sequence[xr.Dataset] = (), diagram: str | None = None
) -> Picture:
    """Return the plots of chosen variables, or of a diagram."""
    if diagram is not None:
        from vibrojax.studies.diagrams import DIAGRAMS

        return DIAGRAMS[diagram](ds)
    if isinstance(variable, str) and variable in ds and RETURN in ds[variable].dims:
        return (hysteresis if Contents(ds).carried else bifurcation)(ds, layers, variable)
    if layers:
        refuse_overlays(layers, "over no other variable")
    return _draw_variables(ds, (variable,) if isinstance(variable, str) else variable)


_MOST_VARIABLES, _MOST_HISTORIES = 4, 8  # more do not fit in one figure


def _draw_variables(ds: xr.Dataset, names: Sequence[str]) -> Sheet:
    """Draw variables of lanes, a run or families: of multipliers the largest, of too many starts the median.

    **Raises:** `InputError` if there is no such variable, it has other dimensions, or there are too many names.
    """
    _check(ds, names)
    check_distinct(Place("picture", "variable"), names, "variable")
    if TIME in ds.dims:
        return histories(ds, names)
    if kind_of(ds) == "family":
        from vibrojax.studies.family_analysis import families

        return families(ds, names)
    ds = contents.named_groups(ds)
    largest = {name: ds[name].isel({MULTIPLIER: 0}) for name in names if MULTIPLIER in ds[name].dims}
    ds = contents.without_single(ds.assign(largest))
    held, note = Contents(ds), ""
    if FORM in ds[names[0]].dims:
        return curves(ds, names)
    values = [regime_value(ds[name]) if name == REGIME else value_of(ds[name]) for name in names]
    if held.many_starts and held.regimes:
        if held.points_over_two or (not held.points and (held.axes or varied_states(ds))):
            return many_starts(ds, values)
        note = medians_text(ds)
        ds = medians(ds, [name for name in names if name != REGIME])
    if held.points_over_two:
        x, y = contents.varied(ds)
        return map_sheet(ds, x, y, values, note)
    if not held.points and (held.worth_a_map or (held.regimes and len(held.axes) > 1)):
        return map_sheet(ds, *contents.axes_of_map(ds), values, note)
    if not held.points and held.regimes and held.axes:
        return regime_lines(ds, note=note, values=[value for value in values if not value.counted])
    return curves(ds, names, note)


def _check(ds: xr.Dataset, names: Sequence[str]) -> None:
    if not isinstance(names, Sequence):
        raise InputError(f"variable: {shown(names)} is not the name of a variable; give one, or a list")
    run, orbits = TIME in ds.dims, kind_of(ds) == "family"
    lanes = {TIME} if run else {POINT} if orbits else set(contents.lane_dims(ds))
    drawable = [
        str(name)
        for name, data in ds.data_vars.items()
        if data.dtype.kind in ("f" if orbits else "fiub") and lanes == {*data.dims} - {FORM, MULTIPLIER}
    ]
    noun = "time" if run else "point of the families" if orbits else "lane"
    analysis = analysis_of(ds)
    for name in names:
        if not lanes and analysis.view in ("plots", "orbits"):
            whole = f"a {analysis.kind} is drawn as a whole"
            raise InputError(f"variable: {shown(name)} has no picture of its own, since {whole}; leave it out")
        if name in ds.data_vars and name not in drawable:
            choices = f"choose from {', '.join(drawable)}" if drawable else "there is none that can"
            raise InputError(f"variable: {shown(name)} is not one number a {noun}; {choices}")
        if name not in drawable:
            raise InputError(f"variable: {shown(name)} is not in the dataset; {suggestion(str(name), drawable)}")
    most = _MOST_HISTORIES if run else _MOST_VARIABLES
    if not 1 <= len(names) <= most:
        raise InputError(f"variable: {len(names)} names; give one to {most} for a picture")
