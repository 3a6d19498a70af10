"""Lanes as arrays: what is given, the facts of the whole run on which results depend, and what a run returns."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.measures.labels import HOLE_RADIUS
from vibrojax.scenes import Scene
from vibrojax.settings.run_settings import RunSettings

Features = dict[str, np.ndarray]
"""Features of lanes by name: (lanes,), or (lanes, returns) for the last section crossings."""

Index = Int[np.ndarray, " _"]
PerLane = Float[np.ndarray, " lanes"]
Mask = Bool[np.ndarray, " lanes"]

Report = Callable[[int], None]
"""Callback that takes the number of lanes that have just been finished."""


def unreported(lanes: int) -> None:
    """Report nothing."""


@dataclass(frozen=True, eq=False)
class LaneInputs:
    """Lanes of one scene, which know no file, no grid and no chunk.

    - `parameters`: every parameter of the scene by name, each (lanes,), float64, in SI units.
    - `start`: for each lane the index of its initial condition in `start_names`, or their number for `states`.
    - `states`: initial states, each (lanes,); empty if all initial conditions have names.
    - `hole_radius`: radius of the hole [m] of which the specific energy is computed, one value or (lanes,).
    - `row`: number of lanes of a row, each of which begins in the final state of the previous one; 0: no rows.
    - `upwards`: for each row, whether it is run from its first lane to its last.
    """

    scene: Scene[Any]
    run: RunSettings
    parameters: Mapping[str, PerLane]
    start: Int[np.ndarray, " lanes"]
    start_names: tuple[str, ...] = ()
    states: tuple[PerLane, ...] = ()
    hole_radius: float | PerLane = HOLE_RADIUS
    row: int = 0
    upwards: Bool[np.ndarray, " rows"] | None = None

    def __len__(self) -> int:
        return len(self.start)

    def of(self, lanes: Index) -> "LaneInputs":
        """Return some lanes, by index, as independent lanes."""
        radius = self.hole_radius
        return replace(
            self,
            parameters={name: x[lanes] for name, x in self.parameters.items()},
            start=self.start[lanes],
            states=tuple(x[lanes] for x in self.states),
            hole_radius=radius[lanes] if isinstance(radius, np.ndarray) else radius,
            row=0,
            upwards=None,
        )

    @property
    def driving_parameters(self) -> dict[str, PerLane]:
        """The parameters of the scene's driving part, whose return map has the orbits."""
        return {name: self.parameters[name] for name in self.scene.driving_part().parameters()}


@dataclass(frozen=True)
class Plan:
    """Facts of a whole run on which the bits of one chunk depend.

    - `lanes`: number of lanes of the run. A small run affords more checks, a large one programs that take long to
      compile.
    - `starts_per_point`: mean number of lanes with the same parameters, which share orbits if there are many.
    - `chunk`: number of lanes that are computed together. Only orbits that are shared depend on it.
    """

    lanes: int
    starts_per_point: float
    chunk: int


class LaneResult(NamedTuple):
    """Results of lanes.

    - `features`: what was measured, with estimates and with the results of stages; the last section crossings
      (lanes, returns) only if a stage reads them or the run keeps them.
    - `variables`: what a dataset stores, with labels; NaN or 0 in lanes that failed or were refused.
    - `seconds` [s]: time of the computation.
    """

    features: Features
    variables: Features
    seconds: float = 0.0


@runtime_checkable
class Stage(Protocol):
    """Adds features to observed lanes: their orbits, nearby orbits, or Lyapunov exponents.

    `attribute`, `described`: name and entries of the dataset's attribute that describes the stage.
    """

    attribute: str

    @property
    def described(self) -> Mapping[str, object]: ...

    def __call__(self, inputs: LaneInputs, features: Features) -> Features: ...
