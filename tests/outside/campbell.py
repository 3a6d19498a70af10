"""A Campbell diagram as an analysis in a package of its own: the spectrum of the bit over a swept parameter."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import vibrojax as vj

SAMPLES = 4096

VARIABLES = {
    "amplitude": vj.Variable("m", "amplitude of the bit"),
    "mode": vj.Variable("Hz", "natural frequency without impact"),
    "fundamental": vj.Variable("Hz", "strongest frequency of the bit"),
}


@dataclass(frozen=True)
class Campbell(vj.Analysis):
    """Draw the spectrum of the bit over the axis of a sweep, with the linear modes and orders of the excitation."""

    highest: float = field(default=15.0, metadata={"help": "highest frequency, Hz (15)"})
    orders: int = field(default=4, metadata={"help": "orders of the fundamental frequency to draw (4)"})

    kind = "campbell"
    variables = VARIABLES

    def run(self, source: Any, progress: bool = True) -> xr.Dataset:
        sweep = vj.read_sweep(source)
        if len(sweep.axes) != 1:
            raise vj.InputError(f"campbell: the sweep has {len(sweep.axes)} axes; give one with a single axis")
        ((along, values),) = sweep.axes.items()
        columns = [self._spectrum(sweep, {**sweep.parameters, along: float(value)}) for value in values]
        frequency, amplitude, modes, fundamental = (np.array(column) for column in zip(*columns, strict=True))
        parameter = sweep.system.parameters()[along]
        return self.dataset(
            {
                "amplitude": ((along, "line"), amplitude),
                "mode": ((along, "order"), modes),
                "fundamental": (along, fundamental),
            },
            {
                along: (along, values, {"units": parameter.unit, "long_name": parameter.long_name}),
                "frequency": ("line", frequency[0], {"units": "Hz", "long_name": "frequency"}),
            },
            title=f"Campbell diagram over {along}",
        )

    def _spectrum(self, sweep: Any, point: dict[str, float]) -> tuple[Any, Any, Any, float]:
        end = sweep.run.settle + sweep.run.observe
        motion = vj.simulate(sweep.scene, **point, **sweep.options, duration=end, progress=False)
        time = np.linspace(sweep.run.settle, end, SAMPLES, endpoint=False)
        x1 = motion["x1"].interp(time=time).values
        window = np.hanning(SAMPLES)
        amplitude = 2 * np.abs(np.fft.rfft((x1 - x1.mean()) * window)) / window.sum()
        frequency = np.fft.rfftfreq(SAMPLES, time[1] - time[0])
        shown = frequency <= self.highest
        modes = (
            np.asarray(vj.modes.natural_frequencies(point)) / (2 * np.pi) if "gamma" in point else np.full(2, np.nan)
        )
        return frequency[shown], amplitude[shown], modes, float(frequency[amplitude.argmax()])

    def picture(self, ds: xr.Dataset, over: Any = ()) -> Figure:
        (along,) = ds["fundamental"].dims
        figure = Figure(figsize=(7, 4.5), layout="constrained")
        axes = figure.subplots()
        level = np.log10(np.maximum(ds["amplitude"].values.T, 1e-7))
        mesh = axes.pcolormesh(ds[along].values, ds["frequency"].values, level, shading="nearest", cmap="Greys")
        axes.plot(ds[along], ds["mode"], "C0--", label=["linear modes", "_"])
        for order in range(1, self.orders + 1):
            axes.plot(ds[along], order * ds["fundamental"], "C1:", label="orders" if order == 1 else "_")
        axes.set(xlabel=f"{along} [{ds[along].attrs['units']}]", ylabel="Frequency [Hz]", ylim=(0, self.highest))
        axes.legend(loc="upper right")
        figure.colorbar(mesh, label="log10 of the amplitude of the bit [m]")
        return figure

    def summary(self, ds: xr.Dataset) -> list[Any]:
        low, high = float(ds["fundamental"].min()), float(ds["fundamental"].max())
        lines = [f"fundamental frequency from {low:.4g} to {high:.4g} Hz"]
        return [vj.SummaryPart("spectrum", lines, {"fundamental": [low, high]})]
