"""The forms of the fitted law in pictures: one colour and mark each, and how far each is from the best."""

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.lines import Line2D

from vibrojax.plot._flags import patch
from vibrojax.plot._grid import FORM
from vibrojax.plot._labels import share_text
from vibrojax.plot._style import UNDEFINED

READINGS = ("onset", "literal", "percent")  # of the logarithmic law; their C are speeds that can be compared
COLOURS = {"onset": "#004488", "literal": "#222222", "percent": "#DDAA33", "line": "#56B4E9", "power": "#BB5566"}
_OTHER = "#8C8C8C"
EQUAL = 2.0  # difference of AIC up to which a form is as good as the best
_MARKS = {"onset": "o", "literal": "s", "percent": "^", "line": "D", "power": "v"}


def forms(fit: xr.Dataset) -> list[str]:
    """The names of the forms, in the order of the dataset."""
    return [str(name) for name in fit[FORM].values]


def readings(fit: xr.Dataset) -> list[str]:
    """The readings of the logarithmic law among the forms; all forms where there are none of these."""
    found = forms(fit)
    return [name for name in READINGS if name in found] or found


def look(name: str) -> dict[str, object]:
    """Colour and mark of the form `name`."""
    return {"color": COLOURS.get(name, _OTHER), "marker": _MARKS.get(name, "P"), "markersize": 4.0, "linewidth": 1.2}


def line_handles(fit: xr.Dataset) -> list[Artist]:
    """The legend's entries for marks: the forms with their formulas, where the dataset gives these."""
    formulas = dict(part.split(": ", 1) for part in str(fit.attrs.get("formulas", "")).split("; ") if ": " in part)
    texts = {name: f"{name}\n{_pretty(formulas[name])}" if name in formulas else name for name in forms(fit)}
    return [Line2D([], [], label=text, **look(name)) for name, text in texts.items()]


def above_best(fit: xr.Dataset) -> xr.DataArray:
    """The AIC of every form less that of the best of its group; NaN where a form has none."""
    aic = fit["aic"].where(np.isfinite(fit["aic"]))
    return aic - aic.min(FORM)


def best(fit: xr.Dataset) -> xr.DataArray:
    """The number of the first form in each group that is as good as the best; NaN where none has an AIC."""
    good = above_best(fit) <= EQUAL
    return good.argmax(FORM).where(good.any(FORM))


def colour_map(fit: xr.Dataset) -> tuple[ListedColormap, BoundaryNorm]:
    """The colours of the forms by their number."""
    colours = [COLOURS.get(name, _OTHER) for name in forms(fit)]
    norm = BoundaryNorm(np.arange(-0.5, len(colours)), len(colours))
    return ListedColormap(colours, name="forms").with_extremes(bad=UNDEFINED), norm


def patch_handles(fit: xr.Dataset, shown: list[xr.DataArray]) -> list[Artist]:
    """The legend's entries for cells: the forms that are best somewhere in `shown`, with their shares."""
    values = np.concatenate([one.values.ravel() for one in shown])
    shares = {name: float((values == at).mean()) for at, name in enumerate(forms(fit))}
    return [patch(COLOURS.get(name, _OTHER), f"{name}  {share_text(s)}") for name, s in shares.items() if s > 0]


def _pretty(formula: str) -> str:
    return formula.replace("eta0", "η₀").replace("eta", "η").replace(" - ", " − ").replace("^exponent", "ⁿ")
