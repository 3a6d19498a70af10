"""The settings whose errors and times are measured, and the reference that errors are told against."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from vibrojax.sweep import LOCATED_STRIDE, Accuracy

REFERENCE = Accuracy(tolerance=1e-14, stride=0.5, step=np.inf, smoothing=0.0)
"""Far finer than what is measured, by the located method: its roundings are what is left."""

SECOND_REFERENCE = Accuracy(tolerance=1e-13, stride=0.35, step=np.inf, smoothing=0.0)
"""Another one, whose difference from the first tells how far down errors can be told."""

STEP_PER_WIDTH = 0.3  # s per m/s
WIDTH = 1e-3  # m/s
STRIDE = 0.3
LONGEST = 1e-2  # s, which no stride reaches
TOLERANCE_PER_WIDTH = 1e-2

TSIT5, FIXED = "diffrax Tsit5", "diffrax Tsit5, fixed steps"
DOPRI8, KVAERNO5 = "diffrax Dopri8", "diffrax Kvaerno5"
SOLVERS = {
    TSIT5: ("Tsit5", True),
    DOPRI8: ("Dopri8", True),
    KVAERNO5: ("Kvaerno5", True),
    FIXED: ("Tsit5", False),
}
"""Name of the solver in diffrax, and whether its steps adapt."""

SETTINGS_TEXT = (
    f"located over tolerance has strides of at most {LOCATED_STRIDE:g} over the mode's rate, over stride no tolerance; "
    f"smoothed over width has steps of {STEP_PER_WIDTH:g} s per m/s of it, over step and stride a width of {WIDTH:g}, "
    f"with strides of at most {STRIDE:g} over the mode's rate where they are not varied; "
    f"diffrax has the smoothed equations, with relative and absolute tolerances (SI) of {TOLERANCE_PER_WIDTH:g} of the "
    f"width, or fixed steps of {STEP_PER_WIDTH:g} s per m/s of it"
)
NO_ROCK = ("rotary", "vibro-impact")


@dataclass(frozen=True)
class Setting:
    """One way to step the lanes of a scene.

    - `method`: "located", "smoothed", or one of `SOLVERS`; `precision`: "float64" or "float32".
    - `varied`: what of it is varied, "tolerance", "stride", "width" [m/s] or "step" [s], and its `value`.
    - `accuracy`: all of it.
    """

    scene: str
    method: str
    precision: str
    varied: str
    value: float
    accuracy: Accuracy

    @property
    def program(self) -> tuple[str, str]:
        """What is compiled once for many settings."""
        return self.method, self.precision


def settings_of(scene: str, quick: bool = False) -> list[Setting]:
    """All settings of `scene`, those of one program together."""
    return [Setting(scene, *one) for one in (_quick if quick else _full)(scene)]


def _full(scene: str) -> Iterator[tuple]:
    for tolerance in (1e-12, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5):
        yield "located", "float64", "tolerance", tolerance, _tolerance(tolerance)
    for stride in (0.125, 0.25, 0.5, 1.0, 2.0, 4.0):
        yield "located", "float64", "stride", stride, _stride(stride)
    for tolerance in (1e-6, 1e-5, 1e-4, 1e-3):
        yield "located", "float32", "tolerance", tolerance, _tolerance(tolerance)
    if scene == "penetration":  # nothing in it is smoothed
        for stride in (0.03, 0.1, 0.3, 1.0):
            yield "smoothed", "float64", "stride", stride, _smoothed_stride(stride)
        for stride in (0.03, 0.1, 0.3, 1.0):
            yield "smoothed", "float32", "stride", stride, _smoothed_stride(stride)
    else:
        finest = (1e-4,) if scene in NO_ROCK else ()  # it takes a minute where there is rock
        for width in (*finest, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2):
            yield "smoothed", "float64", "width", width, _width(width)
        for step in (1e-3, 3e-3, 1e-2):
            yield "smoothed", "float64", "step", step, _step(step)
        for width in (1e-3, 3e-3, 1e-2):
            yield "smoothed", "float32", "width", width, _width(width)
    yield from _diffrax(scene, {TSIT5: 5, DOPRI8: 3, KVAERNO5: 1, FIXED: 3})


def _quick(scene: str) -> Iterator[tuple]:
    for tolerance in (1e-11, 1e-9, 1e-7):
        yield "located", "float64", "tolerance", tolerance, _tolerance(tolerance)
    if scene == "penetration":
        for stride in (0.1, 0.3):
            yield "smoothed", "float64", "stride", stride, _smoothed_stride(stride)
    else:
        for width in (3e-3, 1e-2):
            yield "smoothed", "float64", "width", width, _width(width)
        yield "smoothed", "float64", "step", 3e-2, _step(3e-2)
    yield from _diffrax(scene, {TSIT5: 2})


def _diffrax(scene: str, how_many: dict[str, int]) -> Iterator[tuple]:
    widths = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
    for method, count in how_many.items():
        if method == KVAERNO5 and scene == "rotary":
            continue  # it takes a quarter of a minute, and says the same
        for width in widths[: count if scene in NO_ROCK else 1][::-1]:
            yield method, "float64", "width", width, _width(width)


def _tolerance(tolerance: float) -> Accuracy:
    return Accuracy(tolerance, LOCATED_STRIDE, np.inf, 0.0)


def _stride(stride: float) -> Accuracy:
    """Steps of a fixed fraction of the mode's time scale, which no tolerance shortens."""
    return Accuracy(1e30, stride, np.inf, 0.0)


def _width(width: float) -> Accuracy:
    return Accuracy(0.0, STRIDE, STEP_PER_WIDTH * width, width)


def _step(step: float) -> Accuracy:
    return Accuracy(0.0, STRIDE, step, WIDTH)


def _smoothed_stride(stride: float) -> Accuracy:
    return Accuracy(0.0, stride, LONGEST, WIDTH)
