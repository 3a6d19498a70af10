"""Lanes and settings of the accuracy study: the files `accuracy_lanes.csv` and `accuracy_settings.csv`.

The lanes are periodic motions that settle soon, so that errors are well defined. Settings that share a compiled program
are adjacent. A scene lacks a setting that would take long and add no information.
"""

import csv
from collections.abc import Iterator
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

SOLVERS = {
    "diffrax Tsit5": ("Tsit5", True),
    "diffrax Dopri8": ("Dopri8", True),
    "diffrax Kvaerno5": ("Kvaerno5", True),
    "diffrax Tsit5, fixed steps": ("Tsit5", False),
}
"""Name of the solver in diffrax, and whether its step size is adaptive, by method."""

SETTINGS_TEXT = (
    f"located over tolerance has strides of at most {LOCATED_STRIDE:g} over the mode's rate, over stride no tolerance; "
    f"smoothed over width has steps of {STEP_PER_WIDTH:g} s per m/s of it, over step and stride a width of {WIDTH:g}, "
    f"with strides of at most {STRIDE:g} over the mode's rate where they are not varied; "
    f"diffrax has the smoothed equations, with relative and absolute tolerances (SI) of {TOLERANCE_PER_WIDTH:g} of the "
    f"width, or fixed steps of {STEP_PER_WIDTH:g} s per m/s of it"
)

Columns = dict[str, list[Any]]


def _rows(file: str) -> Iterator[dict[str, str]]:
    with Path(__file__).with_name(file).open(encoding="utf-8", newline="") as text:
        yield from csv.DictReader(text)


def _read_lanes() -> dict[str, Columns]:
    """Read the lanes of each scene as columns by name; empty cells of the file are skipped."""
    scenes: dict[str, Columns] = {}
    for row in _rows("accuracy_lanes.csv"):
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


def lanes_of(scene: str, quick: bool = False) -> StudyLanes:
    """Return the lanes of a scene; fewer lanes and shorter times if `quick`."""
    columns = _LANES[scene]
    count = len(next(iter(columns.values())))
    points = {name: column[:: count // 4 if quick else 1] for name, column in columns.items()}
    if scene == "penetration":
        return StudyLanes(scene, points, 0.2 if quick else 0.5, 0.4 if quick else 0.5)
    return StudyLanes(scene, points, 6.0 if quick else 8.0, 2.0 if quick else 4.0)


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


def settings_of(scene: str, quick: bool = False) -> list[Setting]:
    """Return all settings of a scene; settings that share a compiled program are adjacent."""
    return [
        Setting(scene, row["method"], row["precision"], row["varied"], float(value))
        for row in _rows("accuracy_settings.csv")
        if row["run"] == ("quick" if quick else "full") and scene in row["scenes"].split()
        for value in row["values"].split()
    ]
