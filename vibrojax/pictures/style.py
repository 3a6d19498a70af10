"""Style of all pictures: colours, sizes, drawable strings, and figures that neither use pyplot nor user settings."""

import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from types import MappingProxyType

import numpy as np
import xarray as xr

from vibrojax.errors import printable
from vibrojax.io.attributes import title_of
from vibrojax.lazy import colors
from vibrojax.pictures.plots import FAINT as FAINT
from vibrojax.pictures.plots import INK as INK
from vibrojax.pictures.plots import Dash, Look

NO_VALUE = {"facecolor": "#FFFFFF", "edgecolor": "#8C8C8C", "hatch": "/////"}
"""Style of a lane without a value: hatched, since a regime or a colour map may be grey."""

NOTHING = "#FFFFFF"  # a lane without penetration, in maps of quantities
BIT = "#00598C"
STRIKER = "#D1570A"
STICK = "#111111"
IMPACT = "#C2185B"
ROCK = "#B08D57"

# Distinct in greyscale and for colour-blind readers.
START_COLOURS = {"drive": "#004488", "stuck": "#CC6677", "touching": "#2E8B57"}
OTHER_COLOURS = ("#56B4E9", "#E69F00", "#9B30C9", "#222222", "#C6D937", "#7A1F1F", "#B5B5B5")
ROCK_COLOURS = {"sandstone": "#D9A441", "limestone": "#3F8FA3", "granite": "#7A2E4D"}

DASHED: Dash = (0.0, (4.0, 3.0))
_NESTED_LINES = 4  # number of coinciding lines whose dashes are at different places
VIRIDIS_RANGE = (0.0, 0.87)  # the part of the colour map that lines use; its yellow end is hardly visible on white

SAVED_DPI = 160.0
_STYLE = Path(__file__).with_name("pictures.mplstyle")

COLOURS: ContextVar[str | None] = ContextVar("COLOURS", default=None)
"""Colour map that the user chose for quantities; None if each quantity has its own."""


@contextmanager
def settings(more: Mapping[str, float] = MappingProxyType({})) -> Iterator[None]:
    """Apply the common settings of all pictures, and `more`, to matplotlib, in place of the user's settings."""
    from matplotlib import style

    with style.context(["default", _STYLE, dict(more)]), warnings.catch_warnings():
        # A character that the font lacks is drawn as a box, so no warning is needed.
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        yield


def colour_map(default: str = "viridis") -> "colors.Colormap":
    """Return the colour map that the user chose, else `default`."""
    from matplotlib import colormaps

    return colormaps[COLOURS.get() or default]


def line_colours(count: int) -> list[str]:
    """Return `count` graded colours, for lines in the order of a numeric value."""
    return [colors.to_hex(colour_map()(share)) for share in np.linspace(*VIRIDIS_RANGE, count)]


def other_colour(position: int) -> str:
    """Return a colour by position, for items without a fixed colour."""
    return OTHER_COLOURS[position % len(OTHER_COLOURS)]


def start_colour(name: str, position: int) -> str:
    """Return the colour of an initial condition: fixed for known names, else chosen by `position`."""
    return START_COLOURS.get(name, other_colour(position)) if name else BIT


def nested_line(position: int, count: int) -> Look:
    """Return line style, width and marker size of the line at `position` among `count` lines that may coincide.

    The first line is wide and solid, the others are narrow with dashes at different places. Later markers are smaller.
    """
    size = max(5.5 - 1.8 * position, 1.6)
    if not position:
        return {"size": size, "width": 2.4, "dash": "-"}
    places = min(count, _NESTED_LINES)
    place = 1 + (position - 1) % (places - 1)
    return {"size": size, "width": 1.3, "dash": (2.6 * (places - place), (2.0, 2.6 * places - 2.0))}


# Strings: a dataset may come from any source, so its strings are made safe to draw.

_DRAWN_ATTRIBUTES = ("scene", "friction", "start")
_LONGEST_NAME = 100  # characters
_LONGEST_ATTRIBUTE = {"long_name": 200, "units": 40, "symbol": 40}  # characters that are drawn


def drawable(ds: xr.Dataset) -> xr.Dataset:
    """Return the dataset with short strings on single lines."""
    ds = ds.copy(deep=False)
    if "title" in ds.attrs:
        ds.attrs["title"] = title_of(ds)
    for name in _DRAWN_ATTRIBUTES:
        if name in ds.attrs:
            ds.attrs[name] = printable(ds.attrs[name], _LONGEST_NAME)
    for variable, data in ds.variables.items():
        for key, length in _LONGEST_ATTRIBUTE.items():
            if key in data.attrs:
                data.attrs[key] = printable(data.attrs[key], length)
        if data.dtype.kind in "UO" and data.size:
            texts = {value: printable(value, _LONGEST_NAME) for value in set(data.values.ravel().tolist())}
            if any(text != value for value, text in texts.items()):
                values = np.vectorize(texts.__getitem__, otypes=[object])(data.values).astype(str)
                ds = ds.assign({variable: (data.dims, values, data.attrs)})
    return ds


def plain(text: str) -> str:
    """Return a text for matplotlib: dollar signs begin no formula, and the index of a symbol such as v_cr is lower."""
    text = re.sub(r"(?<!\\)\$", r"\\$", text)
    return re.sub(r"\b([^\W\d_])_([a-z]{1,2})\b", r"$\\mathregular{\1_{\2}}$", text)
