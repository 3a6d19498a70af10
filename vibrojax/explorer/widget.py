"""The class behind [vibrojax.explorer.write.explore][], in its own module because it imports anywidget."""

from collections.abc import Mapping
from typing import Any

import anywidget
import numpy as np
import traitlets
import xarray as xr

from vibrojax.errors import InputError, Place, shown, suggestion
from vibrojax.explorer.write import LIVE_MODULES, module_text, page_contents, style_text
from vibrojax.maps.sweep import Sweep
from vibrojax.pictures.contents import START
from vibrojax.pictures.starts import on_axes
from vibrojax.progress import LOG

PLACE = Place("explore", "point")


class Explorer(anywidget.AnyWidget):
    """A page in a notebook; see `vibrojax.explore`."""

    _esm = module_text(*LIVE_MODULES, "widget.js")
    _css = style_text(live=True)

    document = traitlets.Dict().tag(sync=True)
    blocks: traitlets.List[str] = traitlets.List().tag(sync=True)
    offered = traitlets.Dict(allow_none=True).tag(sync=True)
    fragment = traitlets.Unicode().tag(sync=True)
    cell = traitlets.Dict().tag(sync=True)
    point = traitlets.Dict()
    simulated = traitlets.Dict()

    def __init__(
        self, ds: xr.Dataset, over: xr.Dataset | None, sweep: Sweep | Mapping[str, object] | None, live: bool | None
    ) -> None:
        ds, document, blocks, self.motions = page_contents(ds, over, sweep, live, progress=False)
        self.dataset = on_axes(ds) if START in ds.dims and START in ds.coords else ds
        self._axes = {str(axis["name"]): axis for axis in document["axes"]}
        offered = None if self.motions is None else self.motions.offered()
        super().__init__(document=document, blocks=blocks, offered=offered)
        longest = sorted(self._axes, key=lambda name: -len(self._axes[name]["values"]))[:2]
        middle = {name: len(axis["values"]) // 2 * (name in longest) for name, axis in self._axes.items()}
        self.cell = middle | document["first"]
        self.on_msg(self._answer)

    @property
    def lane(self) -> xr.Dataset:
        """The dataset of the lane that belongs to the selected map cell."""
        return self.dataset.isel({name: index for name, index in self.cell.items() if name in self.dataset.dims})

    @traitlets.validate("cell")
    def _checked_cell(self, proposal: Any) -> dict[str, int]:
        indices = {**self.cell, **proposal["value"]}
        if set(indices) != set(self._axes):
            raise PLACE.error(f"a cell has an index for each of {', '.join(self._axes)}")
        return {name: int(np.clip(indices[name], 0, len(axis["values"]) - 1)) for name, axis in self._axes.items()}

    @traitlets.observe("cell")
    def _update_point(self, change: Any) -> None:
        self.point = self._point_of(change["new"])

    @traitlets.validate("point")
    def _checked_point(self, proposal: Any) -> dict[str, Any]:
        return self._point_of(self._nearest_cell(proposal["value"]))

    @traitlets.observe("point")
    def _update_cell(self, change: Any) -> None:
        self.cell = self._nearest_cell(change["new"])

    def _point_of(self, cell: Mapping[str, int]) -> dict[str, Any]:
        """Return the coordinates of a map cell by name, in SI units."""
        columns = [(column, cell[name]) for name, axis in self._axes.items() for column in axis["columns"] or [axis]]
        return {column["name"]: column["values"][index] for column, index in columns}

    def _nearest_cell(self, point: Mapping[str, Any]) -> dict[str, int]:
        """Return the map cell nearest to a point.

        Along axes without a coordinate in `point`, the index of the selected cell is kept.
        """
        cell, remaining = dict(self.cell), dict(point)
        for name, axis in self._axes.items():
            columns = {column["name"]: column["values"] for column in axis["columns"] or [axis]}
            targets = {column: remaining.pop(column) for column in columns if column in remaining}
            if targets:
                distances = [_distance(PLACE.at(key), columns[key], value) for key, value in targets.items()]
                cell[name] = int(np.argmin(sum(distances)))
        if remaining:
            unknown = min(remaining)
            raise PLACE.at(unknown).error(f"the map has no such axis; {suggestion(unknown, self._point_of(self.cell))}")
        return cell

    def _answer(self, _: object, message: Any, buffers: object) -> None:
        """Send the motion that the page requests, or an error message."""
        if self.motions is None or not isinstance(message, dict) or "id" not in message:
            return
        request = {name: value for name, value in message.items() if name != "id"}
        try:
            block = self.motions.answer(request, lambda *_: None)
        except InputError as error:
            self.send({"id": message["id"], "error": str(error)})
        except Exception as error:  # the page must show something for any error
            LOG.error("explore: %s: %s", type(error).__name__, error)
            self.send({"id": message["id"], "error": "this could not be computed"})
        else:
            self.simulated = {} if "lane" in request else request
            self.send({"id": message["id"]}, [block])


def _distance(place: Place, values: list[Any], target: object) -> np.ndarray:
    """Return the squared distance of each value from the target, relative to the span of the values.

    The distance of a string is 0 if it equals the target, else 1.
    """
    if isinstance(values[0], str):
        if target not in values:
            raise place.error(f"{shown(target)} is not one of its values; {suggestion(str(target), values)}")
        return np.array([float(value != target) for value in values])
    if isinstance(target, bool) or not isinstance(target, (int, float, np.number)) or not np.isfinite(target):
        raise place.error(f"{shown(target)} is not a finite number; give one in SI units")
    numbers = np.array([np.nan if value is None else value for value in values], float)
    span = np.ptp(numbers[np.isfinite(numbers)]) or 1.0
    return np.nan_to_num((numbers - float(target)) / span, nan=np.inf) ** 2
