"""Lanes and settings of the accuracy study.

The lanes are periodic motions that settle soon, so that errors are well defined.
"""

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vibrojax.stepping import LOCATED_STRIDE, Accuracy

REFERENCE = Accuracy(tolerance=1e-14, stride=0.5, step=np.inf, smoothing=0.0)
"""Accuracy of the reference: the located method with tolerances so small that only rounding error remains."""

SECOND_REFERENCE = Accuracy(tolerance=1e-13, stride=0.35, step=np.inf, smoothing=0.0)
"""Accuracy of a second reference; the difference between both references is the least error that can be measured."""

STEP_PER_WIDTH = 0.3  # s per m/s
WIDTH = 1e-3  # m/s
STRIDE = 0.3
LONGEST_STEP = 1e-2  # s; steps limited by a stride are shorter
TOLERANCE_PER_WIDTH = 1e-2
NO_TOLERANCE = 1e30

TSIT5, FIXED = "diffrax Tsit5", "diffrax Tsit5, fixed steps"
DOPRI8, KVAERNO5 = "diffrax Dopri8", "diffrax Kvaerno5"
SOLVERS = {
    TSIT5: ("Tsit5", True),
    DOPRI8: ("Dopri8", True),
    KVAERNO5: ("Kvaerno5", True),
    FIXED: ("Tsit5", False),
}
"""Name of the solver in diffrax, and whether its step size is adaptive, by method."""

SETTINGS_TEXT = (
    f"located over tolerance has strides of at most {LOCATED_STRIDE:g} over the mode's rate, over stride no tolerance; "
    f"smoothed over width has steps of {STEP_PER_WIDTH:g} s per m/s of it, over step and stride a width of {WIDTH:g}, "
    f"with strides of at most {STRIDE:g} over the mode's rate where they are not varied; "
    f"diffrax has the smoothed equations, with relative and absolute tolerances (SI) of {TOLERANCE_PER_WIDTH:g} of the "
    f"width, or fixed steps of {STEP_PER_WIDTH:g} s per m/s of it"
)
NO_ROCK = ("rotary", "vibro-impact")

Columns = dict[str, list[Any]]


def _read_lanes() -> dict[str, Columns]:
    """Read the lanes of each scene as columns by name; empty cells of the file are skipped."""
    scenes: dict[str, Columns] = {}
    with Path(__file__).with_name("lanes.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            columns = scenes.setdefault(row.pop("scene"), {})
            for name, text in row.items():
                if text:
                    columns.setdefault(name, []).append(text if name == "start" else float(text))
    return scenes


_LANES = _read_lanes()
SCENES = tuple(_LANES)


@dataclass(frozen=True)
class StudyLanes:
    """Lanes of a scene: `points`, as columns of equal length by name, and durations `settle` and `observe` [s]."""

    scene: str
    points: Columns
    settle: float
    observe: float

    @property
    def count(self) -> int:
        return len(next(iter(self.points.values())))

    def sweep(self, method: str, precision: str, copies: int) -> dict[str, object]:
        """Return the definition of a sweep that contains these lanes `copies` times."""
        points = {name: column * copies for name, column in self.points.items()}
        times = {"settle": self.settle, "observe": self.observe, "end_early": False, "chunk": self.count * copies}
        return {"scene": self.scene, "points": points, "run": times | {"method": method, "precision": precision}}


@dataclass(frozen=True)
class Setting:
    """Method, precision and accuracy with which the lanes of a scene are stepped.

    - `method`: "located", "smoothed", or one of `SOLVERS`; `precision`: "float64" or "float32".
    - `varied`: the quantity that is varied: "tolerance", "stride", "width" [m/s] or "step" [s]; `value`: its value.
    """

    scene: str
    method: str
    precision: str
    varied: str
    value: float

    @property
    def accuracy(self) -> Accuracy:
        if self.method == "located":
            if self.varied == "stride":  # relative to the mode's time scale
                return Accuracy(NO_TOLERANCE, self.value, np.inf, 0.0)
            return Accuracy(self.value, LOCATED_STRIDE, np.inf, 0.0)
        if self.varied == "width":
            return Accuracy(0.0, STRIDE, STEP_PER_WIDTH * self.value, self.value)
        if self.varied == "step":
            return Accuracy(0.0, STRIDE, self.value, WIDTH)
        return Accuracy(0.0, self.value, LONGEST_STEP, WIDTH)


def lanes_of(scene: str, quick: bool = False) -> StudyLanes:
    """Return the lanes of a scene; fewer lanes and shorter times if `quick`."""
    columns = _LANES[scene]
    count = len(next(iter(columns.values())))
    points = {name: column[:: count // 4 if quick else 1] for name, column in columns.items()}
    if scene == "penetration":
        return StudyLanes(scene, points, 0.2 if quick else 0.5, 0.4 if quick else 0.5)
    return StudyLanes(scene, points, 6.0 if quick else 8.0, 2.0 if quick else 4.0)


def settings_of(scene: str, quick: bool = False) -> list[Setting]:
    """Return all settings of a scene; settings that share a compiled program are adjacent."""
    smooth = scene != "penetration"  # that scene has nothing to smooth
    finest = (1e-4,) if scene in NO_ROCK else ()  # takes a minute in scenes with rock
    rows: list[tuple[str, str, str, tuple[float, ...]]]
    if quick:
        rows = [("located", "float64", "tolerance", (1e-11, 1e-9, 1e-7))]
        rows += [("smoothed", "float64", "width", (3e-3, 1e-2)), ("smoothed", "float64", "step", (3e-2,))] * smooth
        rows += [("smoothed", "float64", "stride", (0.1, 0.3))] * (not smooth)
        counts = {TSIT5: 2}
    else:
        rows = [
            ("located", "float64", "tolerance", (1e-12, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5)),
            ("located", "float64", "stride", (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)),
            ("located", "float32", "tolerance", (1e-6, 1e-5, 1e-4, 1e-3)),
        ]
        if smooth:
            rows += [
                ("smoothed", "float64", "width", (*finest, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2)),
                ("smoothed", "float64", "step", (1e-3, 3e-3, 1e-2)),
                ("smoothed", "float32", "width", (1e-3, 3e-3, 1e-2)),
            ]
        else:
            rows += [("smoothed", precision, "stride", (0.03, 0.1, 0.3, 1.0)) for precision in ("float64", "float32")]
        counts = {TSIT5: 5, DOPRI8: 3, KVAERNO5: 1, FIXED: 3}
        if scene == "rotary":
            del counts[KVAERNO5]  # takes a quarter of a minute, and adds no information
    widths = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
    for method, count in counts.items():
        rows.append((method, "float64", "width", widths[: count if scene in NO_ROCK else 1][::-1]))
    return [
        Setting(scene, method, precision, varied, value)
        for method, precision, varied, values in rows
        for value in values
    ]
