"""A Campbell diagram as an analysis in a package of its own: the spectrum of the bit over a swept parameter."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import vibrojax as vj

SAMPLES = 4096


@dataclass(frozen=True)
class Campbell(vj.Analysis):
    """Draw the spectrum of the bit over the axis of a sweep, with the orders of its strongest frequency."""

    highest: float = field(default=15.0, metadata={"help": "highest frequency, Hz (15)"})
    orders: int = field(default=4, metadata={"help": "orders of the strongest frequency to draw (4)"})

    kind = "campbell"
    variables: ClassVar[Mapping[str, vj.Variable]] = {
        "amplitude": vj.Variable("m", "amplitude of the bit"),
        "fundamental": vj.Variable("Hz", "strongest frequency of the bit"),
        "frequency": vj.Variable("Hz", "frequency"),
    }

    def run(self, source: Any, progress: bool = True) -> xr.Dataset:
        sweep = vj.read_sweep(source)
        if len(sweep.axes) != 1:
            raise vj.InputError(f"campbell: the sweep has {len(sweep.axes)} axes; give one with a single axis")
        [(along, values)], end = sweep.axes.items(), sweep.run.settle + sweep.run.observe
        time, window = np.linspace(sweep.run.settle, end, SAMPLES, endpoint=False), np.hanning(SAMPLES)
        frequency, rows = np.fft.rfftfreq(SAMPLES, time[1] - time[0]), []
        for value in values.tolist():
            point = {**sweep.parameters, **sweep.options, along: value, "duration": end, "progress": False}
            x1 = vj.simulate(sweep.scene, **point)["x1"].interp(time=time).values
            rows.append(2 * np.abs(np.fft.rfft((x1 - x1.mean()) * window)) / window.sum())
        shown, amplitude, unit = frequency <= self.highest, np.array(rows), sweep.system.parameters()[along].unit
        variables = {"fundamental": (along, frequency[amplitude.argmax(axis=1)])}
        variables |= {"amplitude": ((along, "frequency"), amplitude[:, shown])}
        axes = {along: (along, values, {"units": unit}), "frequency": ("frequency", frequency[shown])}
        return self.dataset(variables, axes)

    def picture(self, ds: xr.Dataset, over: Any = ()) -> Figure:
        [along], figure = ds["fundamental"].dims, Figure(figsize=(7, 4.5), layout="constrained")
        axes, level = figure.subplots(), np.log10(np.maximum(ds["amplitude"].T, 1e-7))
        mesh = axes.pcolormesh(ds[along], ds["frequency"], level, shading="nearest", cmap="Greys")
        for order in range(1, self.orders + 1):
            axes.plot(ds[along], order * ds["fundamental"], "C1:")
        axes.set(xlabel=f"{along} [{ds[along].units}]", ylabel="frequency [Hz]", ylim=(0, self.highest))
        figure.colorbar(mesh, label="log10 of the amplitude of the bit [m]")
        return figure

    def summary(self, ds: xr.Dataset) -> list[Any]:
        low, high = np.sort(ds["fundamental"])[[0, -1]].tolist()
        text = f"fundamental frequency from {low:.4g} to {high:.4g} Hz"
        return [vj.SummaryPart("spectrum", [text], {"fundamental": [low, high]})]
