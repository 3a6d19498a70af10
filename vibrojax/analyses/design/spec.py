"""The specification of a design: what varies, what is maximised, and what must hold."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from vibrojax.errors import Place
from vibrojax.io.variables import Variable
from vibrojax.sweep.input.definition import Sweep
from vibrojax.sweep.input.read import read_sweep

DRAWN_BOX = 1.04
"""Size of the box from which verification draws, relative to the tolerances: what holds there holds in the box."""


@dataclass(frozen=True)
class Constraint:
    """A limit of a variable; `end`: "least" or "most". `margin`: amount by which the search tightens the limit."""

    variable: str
    end: str
    limit: float
    margin: float = 0.0

    def slack(self, values: Any) -> Any:
        """Return the distance from the tightened limit, negative where it is violated, relative to the limit."""
        distance = self.limit - values if self.end == "most" else values - self.limit
        return (distance - self.margin) / self.scale

    @property
    def scale(self) -> float:
        """Unit of the slack."""
        return abs(self.limit) or 1.0

    @property
    def sign(self) -> float:
        """Sign of the slack's derivative with respect to the variable."""
        return -1.0 if self.end == "most" else 1.0

    def at(self, limit: float) -> "Constraint":
        """Return the constraint with another limit, and its margin in proportion."""
        return replace(self, limit=limit, margin=self.margin * abs(limit) / self.scale)


@dataclass(frozen=True)
class Front:
    """A front: the best objective over values of `against`, a limited variable, or "tolerance" (a factor)."""

    against: str
    end: str
    points: int
    span: tuple[float, float] | None


@dataclass(frozen=True, eq=False)
class DesignSpec:
    """A checked design.

    - `varied`: names, with bounds `low` and `high`; the search scales these to the unit box.
    - `tolerances`: half-widths by name; `fixed`: nominal values of those parameters that are not varied.
    - `share`: least and greatest share of good starts, or None if all starts must be good.
    - `tables`: the tables of every sweep of the search. `template`: a sweep at the bounds.
    """

    name: str
    file: str
    text: str
    tables: dict[str, Any]
    template: Sweep
    maximise: str
    varied: tuple[str, ...]
    low: Float[np.ndarray, " varied"]
    high: Float[np.ndarray, " varied"]
    tolerances: dict[str, float]
    fixed: dict[str, float]
    regime: str | None
    share: tuple[float, float] | None
    constraints: tuple[Constraint, ...]
    front: Front | None
    variables: dict[str, Variable]

    @property
    def place(self) -> Place:
        """The place of the design in messages."""
        return Place(self.file)

    def columns(
        self, unit: Float[np.ndarray, "points varied"], offsets: Float[np.ndarray, "points tolerances"]
    ) -> dict[str, np.ndarray]:
        """Return the parameters of points: nominal values in the unit box, and offsets in half-widths."""
        values = dict(zip(self.varied, (self.low + unit * (self.high - self.low)).T, strict=True))
        for name, value in self.fixed.items():
            values[name] = np.full(len(unit), value)
        for k, (name, width) in enumerate(self.tolerances.items()):
            values[name] = values[name] + offsets[:, k] * width
        return values

    def sweep(self, columns: Mapping[str, np.ndarray]) -> Sweep:
        """Return the sweep of points, from every start."""
        return read_sweep(self.tables | {"points": {name: x.tolist() for name, x in columns.items()}})

    def identity(self) -> dict[str, object]:
        """Return all settings on which the result depends, as flat JSON values."""
        own = {f"tolerance.{name}": width for name, width in self.tolerances.items()}
        own |= {f"subject.{c.variable}.{c.end}": c.limit for c in self.constraints}
        front = None if self.front is None else [self.front.against, self.front.end, self.front.points, self.front.span]
        subject = {"maximise": self.maximise, "regime": self.regime, "share": self.share, "front": front}
        return self.template.identity() | {f"design.{name}": value for name, value in (own | subject).items()}
