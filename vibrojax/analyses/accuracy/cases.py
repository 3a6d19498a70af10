"""What is measured: the lanes of each scene, and the settings that they are stepped at.

The lanes are periodic motions that settle soon, so that errors mean something.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from vibrojax.stepping import LOCATED_STRIDE, Accuracy

REFERENCE = Accuracy(tolerance=1e-14, stride=0.5, step=np.inf, smoothing=0.0)
"""Far finer than what is measured, by the located method: its roundings are what is left."""

SECOND_REFERENCE = Accuracy(tolerance=1e-13, stride=0.35, step=np.inf, smoothing=0.0)
"""Another one, whose difference from the first is the least error that can be measured."""

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
_DRILL = ("beta", "gamma", "v", "delta", "threshold", "start")


@dataclass(frozen=True)
class StudyLanes:
    """Points of a scene: `points`, columns of equal length by name; `settle` and `observe` [s]."""

    scene: str
    points: dict[str, list[float] | list[str]]
    settle: float
    observe: float

    @property
    def count(self) -> int:
        """How many there are."""
        return len(next(iter(self.points.values())))

    def sweep(self, method: str, precision: str, copies: int) -> dict[str, object]:
        """The sweep of these lanes, over and over, `copies` times."""
        points = {name: column * copies for name, column in self.points.items()}
        times = {"settle": self.settle, "observe": self.observe, "end_early": False, "chunk": self.count * copies}
        return {"scene": self.scene, "points": points, "run": times | {"method": method, "precision": precision}}


@dataclass(frozen=True)
class Setting:
    """One way to step the lanes of a scene.

    - `method`: "located", "smoothed", or one of `SOLVERS`; `precision`: "float64" or "float32".
    - `varied`: what of it is varied, "tolerance", "stride", "width" [m/s] or "step" [s], and its `value`.
    """

    scene: str
    method: str
    precision: str
    varied: str
    value: float

    @property
    def accuracy(self) -> Accuracy:
        """All that the steps follow from."""
        if self.method == "located":
            if self.varied == "stride":  # of the mode's time scale, which no tolerance shortens
                return Accuracy(1e30, self.value, np.inf, 0.0)
            return Accuracy(self.value, LOCATED_STRIDE, np.inf, 0.0)
        if self.varied == "width":
            return Accuracy(0.0, STRIDE, STEP_PER_WIDTH * self.value, self.value)
        if self.varied == "step":
            return Accuracy(0.0, STRIDE, self.value, WIDTH)
        return Accuracy(0.0, self.value, LONGEST, WIDTH)


def lanes_of(scene: str, quick: bool = False) -> StudyLanes:
    """The lanes of `scene`; fewer and shorter ones where it is to be `quick`."""
    names, rows = _ROWS[scene]
    rows = rows[:: len(rows) // 4] if quick else rows
    columns = {name: list(column) for name, column in zip(names, zip(*rows, strict=True), strict=True)}
    if scene == "penetration":
        return StudyLanes(scene, columns, 0.2 if quick else 0.5, 0.4 if quick else 0.5)
    return StudyLanes(scene, columns, 6.0 if quick else 8.0, 2.0 if quick else 4.0)


def settings_of(scene: str, quick: bool = False) -> list[Setting]:
    """All settings of `scene`, those of one program together."""
    return [
        Setting(scene, method, precision, varied, value)
        for method, precision, varied, values in (_quick if quick else _full)(scene)
        for value in values
    ]


Varied = Iterator[tuple[str, str, str, tuple[float, ...]]]
"""Method, precision, what is varied, and its values."""


def _full(scene: str) -> Varied:
    yield "located", "float64", "tolerance", (1e-12, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5)
    yield "located", "float64", "stride", (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)
    yield "located", "float32", "tolerance", (1e-6, 1e-5, 1e-4, 1e-3)
    if scene == "penetration":  # nothing in it is smoothed
        yield "smoothed", "float64", "stride", (0.03, 0.1, 0.3, 1.0)
        yield "smoothed", "float32", "stride", (0.03, 0.1, 0.3, 1.0)
    else:
        finest = (1e-4,) if scene in NO_ROCK else ()  # it takes a minute where there is rock
        yield "smoothed", "float64", "width", (*finest, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2)
        yield "smoothed", "float64", "step", (1e-3, 3e-3, 1e-2)
        yield "smoothed", "float32", "width", (1e-3, 3e-3, 1e-2)
    yield from _diffrax(scene, {TSIT5: 5, DOPRI8: 3, KVAERNO5: 1, FIXED: 3})


def _quick(scene: str) -> Varied:
    yield "located", "float64", "tolerance", (1e-11, 1e-9, 1e-7)
    if scene == "penetration":
        yield "smoothed", "float64", "stride", (0.1, 0.3)
    else:
        yield "smoothed", "float64", "width", (3e-3, 1e-2)
        yield "smoothed", "float64", "step", (3e-2,)
    yield from _diffrax(scene, {TSIT5: 2})


def _diffrax(scene: str, how_many: dict[str, int]) -> Varied:
    widths = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
    for method, count in how_many.items():
        if method == KVAERNO5 and scene == "rotary":
            continue  # it takes a quarter of a minute, and says the same
        yield method, "float64", "width", widths[: count if scene in NO_ROCK else 1][::-1]


_ROTARY = (
    (0.24, 0.41, 2.0, "stuck"),
    (0.32, 0.39, 0.6, "drive"),
    (0.44, 0.46, 1.7, "stuck"),
    (0.40, 0.79, 0.7, "stuck"),
    (0.42, 0.83, 1.3, "stuck"),
    (0.34, 0.85, 0.8, "stuck"),
    (0.53, 0.53, 1.6, "stuck"),
    (0.30, 0.80, 1.5, "stuck"),
    (0.35, 0.34, 0.5, "stuck"),
    (0.41, 0.63, 1.2, "stuck"),
    (0.44, 0.83, 1.5, "stuck"),
    (0.27, 0.44, 0.8, "drive"),
    (0.23, 0.55, 1.2, "stuck"),
    (0.38, 0.45, 0.6, "drive"),
    (0.45, 0.74, 1.0, "stuck"),
    (0.26, 0.60, 0.6, "drive"),
)
_VIBRO_IMPACT = (
    (0.56, 0.59, 0.5, 0.0, "stuck"),
    (0.57, 0.83, 1.3, -0.005, "stuck"),
    (0.21, 0.58, 1.1, 0.005, "stuck"),
    (0.25, 0.60, 1.4, 0.0, "stuck"),
    (0.30, 0.88, 0.9, -0.005, "drive"),
    (0.34, 0.80, 1.7, -0.005, "stuck"),
    (0.35, 0.51, 0.5, 0.0, "stuck"),
    (0.35, 0.73, 1.8, 0.005, "stuck"),
    (0.28, 0.60, 1.8, -0.005, "drive"),
    (0.28, 0.82, 1.8, 0.005, "stuck"),
    (0.44, 0.74, 0.7, -0.005, "drive"),
    (0.41, 0.87, 1.8, 0.005, "stuck"),
    (0.53, 0.70, 1.7, -0.005, "stuck"),
    (0.39, 0.74, 1.9, 0.0, "stuck"),
    (0.33, 0.72, 0.8, 0.005, "stuck"),
    (0.41, 0.75, 1.3, -0.005, "drive"),
)
_DRILLING = (
    (0.41, 0.77, 1.9, 0.005, 61900.0, "stuck"),
    (0.40, 0.52, 2.0, 0.0, 30000.0, "stuck"),
    (0.40, 0.78, 1.8, -0.005, 61900.0, "drive"),
    (0.42, 0.61, 1.5, -0.005, 61900.0, "drive"),
    (0.32, 0.55, 1.9, 0.005, 30000.0, "stuck"),
    (0.38, 0.75, 1.7, -0.005, 30000.0, "drive"),
    (0.31, 0.73, 1.4, -0.005, 30000.0, "drive"),
    (0.38, 0.71, 1.0, -0.005, 30000.0, "stuck"),
    (0.60, 0.83, 1.3, -0.005, 30000.0, "stuck"),
    (0.42, 0.70, 1.2, 0.005, 61900.0, "stuck"),
    (0.26, 0.67, 1.9, -0.005, 30000.0, "stuck"),
    (0.61, 0.89, 1.2, -0.005, 61900.0, "drive"),
    (0.29, 0.67, 1.5, -0.005, 30000.0, "drive"),
    (0.29, 0.62, 1.8, 0.005, 61900.0, "stuck"),
    (0.65, 0.87, 1.1, -0.005, 30000.0, "drive"),
    (0.33, 0.62, 1.6, -0.005, 61900.0, "stuck"),
)
_COUPLED = (
    (0.32, 0.54, 1.7, 0.0, 30000.0, "stuck"),
    (0.38, 0.72, 0.9, 0.0, 30000.0, "stuck"),
    (0.26, 0.59, 1.4, -0.005, 30000.0, "stuck"),
    (0.28, 0.55, 1.7, -0.005, 30000.0, "drive"),
    (0.35, 0.58, 1.5, 0.0, 30000.0, "stuck"),
    (0.38, 0.83, 1.3, 0.0, 30000.0, "stuck"),
    (0.43, 0.80, 1.3, -0.005, 30000.0, "drive"),
    (0.31, 0.83, 1.5, -0.005, 30000.0, "drive"),
    (0.57, 0.60, 1.4, 0.0, 30000.0, "stuck"),
    (0.46, 0.71, 1.6, -0.005, 30000.0, "stuck"),
    (0.43, 0.60, 1.1, 0.005, 30000.0, "stuck"),
    (0.33, 0.52, 1.6, -0.005, 30000.0, "stuck"),
    (0.36, 0.60, 1.9, 0.005, 30000.0, "stuck"),
    (0.40, 0.71, 1.7, -0.005, 30000.0, "stuck"),
    (0.30, 0.72, 1.6, 0.005, 30000.0, "stuck"),
    (0.32, 0.67, 1.3, 0.005, 30000.0, "stuck"),
)
_PENETRATION = tuple(
    (force, frequency, k3, zeta)
    for force, zeta in ((300e3, 1.1), (250e3, 0.6))
    for frequency in (10.0, 20.0, 30.0, 40.0)
    for k3 in (100e6, 300e6)
)

_ROWS: dict[str, tuple[tuple[str, ...], tuple[tuple[float | str, ...], ...]]] = {
    "rotary": (("beta", "gamma", "v", "start"), _ROTARY),
    "vibro-impact": (("beta", "gamma", "v", "delta", "start"), _VIBRO_IMPACT),
    "penetration": (("force", "frequency", "k3", "zeta"), _PENETRATION),
    "drilling": (_DRILL, _DRILLING),
    "coupled-drilling": (_DRILL, _COUPLED),
}
SCENES = tuple(_ROWS)
