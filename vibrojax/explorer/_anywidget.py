"""The widget of `vibrojax.explorer.widget`; apart, since it takes anywidget."""

from collections.abc import Mapping
from typing import Any

import anywidget
import numpy as np
import traitlets
import xarray as xr

from vibrojax.errors import InputError, Place, shown, suggestion
from vibrojax.explorer.at_point import Motions, motions_around, motions_of
from vibrojax.explorer.of_dataset import _sweep, cells_of, document_of, explored
from vibrojax.explorer.write import LIVE, SIZE, blocks_of, module_text, style_text
from vibrojax.plot.contents import START
from vibrojax.plot.starts import on_axes
from vibrojax.progress import LOG
from vibrojax.sweep.input.definition import Sweep

PLACE = Place("explore", "point")


class Explorer(anywidget.AnyWidget):
    """A page in a notebook; see `vibrojax.explore`."""

    _esm = module_text(*LIVE, "widget.js")
    _css = style_text(live=True)

    document = traitlets.Dict().tag(sync=True)
    blocks: traitlets.List[str] = traitlets.List().tag(sync=True)
    offered = traitlets.Dict(allow_none=True).tag(sync=True)
    fragment = traitlets.Unicode().tag(sync=True)
    cell = traitlets.Dict().tag(sync=True)
    point = traitlets.Dict()
    simulated = traitlets.Dict()

    def __init__(
        self, ds: xr.Dataset, over: xr.Dataset | None = None, own: Sweep | None = None, live: bool | None = None
    ) -> None:
        ds, over = explored(ds, over, progress=False)
        document = document_of(ds, over, own)
        self.motions = None if live is False else _motions(ds, own, live is True)
        blocks: list[str] = []
        if self.motions is None or self.motions.sweep is None:
            blocks = blocks_of(cells_of(ds, False, own))
        if blocks:
            document["cells"] = {"size": SIZE, "blocks": len(blocks)}
        self.dataset = on_axes(ds) if START in ds.dims and START in ds.coords else ds
        self._axes = {str(axis["name"]): axis for axis in document["axes"]}
        offered = None if self.motions is None else self.motions.offered()
        super().__init__(document=document, blocks=blocks, offered=offered)
        longest = sorted(self._axes, key=lambda name: -len(self._axes[name]["values"]))[:2]
        self.cell = {name: len(axis["values"]) // 2 * (name in longest) for name, axis in self._axes.items()}
        self.on_msg(self._answer)

    @property
    def lane(self) -> xr.Dataset:
        """The dataset at the picked cell."""
        return self.dataset.isel({name: index for name, index in self.cell.items() if name in self.dataset.dims})

    @traitlets.validate("cell")
    def _known_cell(self, proposal: Any) -> dict[str, int]:
        """Indices of all axes, each within its axis."""
        given = {**self.cell, **proposal["value"]}
        if set(given) != set(self._axes):
            raise PLACE.error(f"a cell has an index for each of {', '.join(self._axes)}")
        return {name: int(np.clip(given[name], 0, len(axis["values"]) - 1)) for name, axis in self._axes.items()}

    @traitlets.observe("cell")
    def _picked(self, change: Any) -> None:
        self.point = self._point_of(change["new"])

    @traitlets.validate("point")
    def _known_point(self, proposal: Any) -> dict[str, Any]:
        return self._point_of(self._cell_at(proposal["value"]))

    @traitlets.observe("point")
    def _moved(self, change: Any) -> None:
        self.cell = self._cell_at(change["new"])

    def _point_of(self, cell: Mapping[str, int]) -> dict[str, Any]:
        """The coordinates of a cell by name, in SI."""
        found: dict[str, Any] = {}
        for name, axis in self._axes.items():
            columns = axis["columns"] or [axis]
            found |= {column["name"]: column["values"][cell[name]] for column in columns}
        return found

    def _cell_at(self, point: Mapping[str, Any]) -> dict[str, int]:
        """The cell nearest to a point; along axes of which nothing is said, the picked one."""
        cell, left = dict(self.cell), dict(point)
        for name, axis in self._axes.items():
            columns = {column["name"]: column for column in axis["columns"] or [axis]}
            wanted = {column: left.pop(column) for column in columns if column in left}
            if wanted:
                away = sum(_distance(PLACE.at(one), columns[one]["values"], value) for one, value in wanted.items())
                cell[name] = int(np.argmin(away))
        if left:
            there = self._point_of(self.cell)
            raise PLACE.at(min(left)).error(f"the map has no such axis; {suggestion(min(left), there)}")
        return cell

    def _answer(self, _: object, asked: Any, buffers: object) -> None:
        """A motion that the page has asked for, or why there is none."""
        if self.motions is None or not isinstance(asked, dict) or "id" not in asked:
            return
        question = {name: value for name, value in asked.items() if name != "id"}
        try:
            block = self.motions.answer(question, lambda *_: None)
        except InputError as error:
            self.send({"id": asked["id"], "error": str(error)})
        except Exception as error:  # the page should say something, whatever it was
            LOG.error("explore: %s: %s", type(error).__name__, error)
            self.send({"id": asked["id"], "error": "this could not be computed"})
        else:
            self.simulated = {} if "lane" in question else question
            self.send({"id": asked["id"]}, [block])


def _distance(place: Place, values: list[Any], wanted: object) -> np.ndarray:
    """How far each value is from the wanted one, over all of them; names are the same or not."""
    if isinstance(values[0], str):
        if wanted not in values:
            raise place.error(f"{shown(wanted)} is none of its values; {suggestion(str(wanted), values)}")
        return np.array([float(value != wanted) for value in values])
    if isinstance(wanted, bool) or not isinstance(wanted, (int, float, np.number)) or not np.isfinite(wanted):
        raise place.error(f"{shown(wanted)} is no number; give one, in SI units")
    numbers = np.array([np.nan if value is None else value for value in values], float)
    span = np.ptp(numbers[np.isfinite(numbers)]) or 1.0
    return np.nan_to_num((numbers - float(wanted)) / span, nan=np.inf) ** 2


def _motions(ds: xr.Dataset, own: Sweep | None, required: bool) -> Motions | None:
    """What computes motions around a dataset, None where it names no scene of the package, unless they are required."""
    try:
        sweep, _ = _sweep(ds, own)
        return motions_around(ds) if sweep is None else motions_of(sweep)
    except InputError:
        if required:
            raise
        return None
