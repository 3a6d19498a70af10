"""The fitting picture for a dataset, on a figure or in a file."""

from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from vibrojax.errors import InputError
from vibrojax.plot._accuracy import SETTING, work_precision
from vibrojax.plot._bifurcation import RETURNS, bifurcation
from vibrojax.plot._cells import RATE
from vibrojax.plot._grid import FORM, POINT, lane_dims, swept, to_map
from vibrojax.plot._law import fitted_law
from vibrojax.plot._points import varied
from vibrojax.plot._pulses import pulses
from vibrojax.plot._rate_map import rate_map
from vibrojax.plot._rates import rates
from vibrojax.plot._regimes import regime_map
from vibrojax.plot._response import is_swept, response
from vibrojax.plot._series import MOST_LINES
from vibrojax.plot._style import settings
from vibrojax.plot._trajectory import trajectory
from vibrojax.store._aside import aside

# Without the date, so that the same dataset gives the same file.
_METADATA: dict[str, dict[str, None]] = {".png": {}, ".pdf": {"CreationDate": None}, ".svg": {"Date": None}}


def picture(ds: xr.Dataset) -> Figure:
    """The fitting picture for what `ds` holds: a trajectory, returns, regimes, rates of penetration, or a law.

    **Arguments:**

    - `ds`: what `simulate`, a sweep, a fit or the study of speed against error gives.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where the dataset holds nothing to draw.
    """
    if "time" in ds.dims:
        return _over_time(ds)
    if SETTING in ds.dims and "error_worst" in ds:
        return work_precision(ds)
    if "regime" in ds and RETURNS in ds and swept(ds):
        return bifurcation(ds)
    if "C" in ds and FORM in ds.dims:
        return fitted_law(ds)
    if RATE in ds and _as_lines(ds):
        return rates(ds)
    if "regime" in ds:
        return regime_map(ds)
    if RATE in ds:
        return rate_map(ds)
    held = ", ".join(str(name) for name in ds.data_vars) or "no variable"
    raise InputError(
        f"nothing to draw: a picture needs regime, rate_of_penetration, C along form, or a motion along time; "
        f"the dataset holds {held}"
    )


def _over_time(ds: xr.Dataset) -> Figure:
    if "x3" in ds and "x1" not in ds:
        return response(ds) if is_swept(ds) else pulses(ds)
    return trajectory(ds)


def _as_lines(ds: xr.Dataset) -> bool:
    """Whether the lanes of a scene with rock are drawn as lines, or one by one."""
    if POINT in lane_dims(ds):
        values = [np.unique(ds[name].values).size for name in varied(ds)]
        few = min(values, default=0) <= MOST_LINES and "regime" not in ds
        return len(values) != 2 or few
    return len(to_map(ds)) < 2


def save_picture(ds: xr.Dataset, path: str | Path) -> None:
    """Draw the fitting picture for `ds` into the file `path`, which is there whole or not at all.

    **Arguments:**

    - `ds`: what `simulate` or a sweep gives.
    - `path`: ends in .png, .pdf or .svg.

    **Raises:** `InputError` for another ending, a path that cannot be written, or a dataset with nothing to draw.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _METADATA:
        raise InputError(f"{path}: pictures end in .png, .pdf or .svg, not in {suffix or 'nothing'}")
    figure = picture(ds)
    try:
        with settings(), aside(path, "part") as part:
            figure.savefig(part, format=suffix[1:], metadata=_METADATA[suffix])
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); give another file") from None
