"""From the error that a user accepts to the steps that keep it."""

from dataclasses import asdict, dataclass, replace

import numpy as np

from vibrojax.scenes import Scene
from vibrojax.sweep._settings import RunSettings

COARSEST = 1e-6
"""Tolerance beyond which little is gained, because most steps end at events, and from which on the difference from a
coarser run tells of the error."""

COARSEST_DRIVEN = 1e-8
"""The same where pulses drive: nearly all steps end with them, and are the same at any tolerance above."""

LOCATED_STRIDE = 2.0
"""Longest step of the located method, in units of 1/rate: in it no surface is touched and left twice."""


@dataclass(frozen=True)
class Accuracy:
    """What the steps follow from: `tolerance` and `stride` (located), `step` [s], `smoothing` [m/s]."""

    tolerance: float
    stride: float
    step: float
    smoothing: float

    def settings(self) -> dict:
        """What the steppers take, by name."""
        return asdict(self)

    def described(self) -> dict:
        """What a dataset tells of it, as JSON values."""
        return {name: value for name, value in asdict(self).items() if np.isfinite(value) and value > 0}

    def coarser(self, factor: float) -> "Accuracy":
        """The accuracy of the run that the error is estimated with."""
        step = self.step * (factor if self.smoothing else 1)
        return replace(self, tolerance=self.tolerance * factor, smoothing=self.smoothing * factor, step=step)


def accuracy_for(run: RunSettings, scene: Scene) -> Accuracy:
    """Steps that keep the accepted error in `scene`, unless the user chose them."""
    if run.method == "smoothed":
        # Over the reference cases the error of the width is at most its power 3/4, in m/s; that of a step of 0.3 s per
        # m/s of it is far below.
        width = run.smoothing if run.smoothing is not None else max(run.error ** (4 / 3), 1e-6)
        return Accuracy(0.0, 0.3, run.step if run.step is not None else 0.3 * width, width)
    rounding = 1e-12 if run.precision == "float64" else 3e-6
    # Errors of period and impact velocity are below the tolerance, but a hundred times it on hard lanes.
    tolerance = max(min(1e-3 * run.error, COARSEST if scene.autonomous else COARSEST_DRIVEN), rounding)
    return Accuracy(tolerance, LOCATED_STRIDE, run.step if run.step is not None else np.inf, 0.0)
