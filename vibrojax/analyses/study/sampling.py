"""Samples of a study: Saltelli's sample for Sobol indices, and the corners of a two-level factorial design."""

from dataclasses import dataclass
from itertools import product
from types import ModuleType

import numpy as np
from jaxtyping import Float

from vibrojax.errors import InputError

MAX_PARAMETERS = 12
"""Largest number of varied parameters."""

FULL_FACTORIAL = 8
"""Largest number of parameters whose corners are all run, 256 of them. Beyond, a fraction of the corners is run."""

# Each further parameter is the product of the signs of some of the first seven, or eight. Main effects and interactions
# of two parameters are not confounded with each other (resolution V).
_BASIC = {9: 7, 10: 7, 11: 7, 12: 8}
_GENERATORS = {
    7: ((0, 1, 2, 6), (1, 2, 3, 4), (0, 2, 3, 5), (0, 1, 2, 3, 4, 5, 6)),
    8: ((0, 1, 2, 3), (0, 1, 4, 5), (0, 2, 4, 6), (1, 2, 4, 7)),
}

Points = Float[np.ndarray, "points parameters"]


@dataclass(frozen=True, eq=False)
class Sampling:
    """Samples of a box.

    - `bounds`: least and greatest value of each parameter, by name.
    - `samples`: number of base samples, a power of two; `seed`: seed of the scrambled Sobol sequence.
    """

    bounds: dict[str, tuple[float, float]]
    samples: int
    seed: int = 0

    @property
    def names(self) -> list[str]:
        """Names of the parameters."""
        return list(self.bounds)

    @property
    def group(self) -> int:
        """Number of consecutive points of the Sobol sample that belong to one base sample: 2 D + 2."""
        return 2 * len(self.bounds) + 2

    @property
    def problem(self) -> dict[str, object]:
        """The description of the box for SALib."""
        return {"num_vars": len(self.bounds), "names": self.names, "bounds": [list(x) for x in self.bounds.values()]}

    def sobol_points(self) -> Points:
        """Return Saltelli's sample, `samples` groups of `group` points each.

        **Raises:** `InputError` if SALib is not installed.
        """
        points: Points = salib("sample").sample(self.problem, self.samples, calc_second_order=True, seed=self.seed)
        return points

    def corner_signs(self) -> Points:
        """Return the signs, -1 or 1, of each parameter at each corner of the design."""
        return factorial_signs(len(self.bounds))

    def corners(self) -> Points:
        """Return the corners of the two-level design."""
        low, high = np.array(list(self.bounds.values())).T
        return np.where(self.corner_signs() > 0, high, low)

    def points(self) -> Points:
        """Return all points: the Sobol sample, followed by the corners."""
        return np.concatenate([self.sobol_points(), self.corners()])


def factorial_signs(parameters: int) -> Points:
    """Return the signs of a two-level design: full for up to eight parameters, else a fraction of resolution V."""
    basic = _BASIC.get(parameters, parameters)
    signs = np.array(list(product((-1.0, 1.0), repeat=basic)))
    further = _GENERATORS[basic][: parameters - basic] if parameters > basic else ()
    return np.column_stack([signs, *(signs[:, list(word)].prod(axis=1) for word in further)])


def salib(part: str) -> ModuleType:
    """Return the module `SALib.sample.sobol` or `SALib.analyze.sobol`; `part` is "sample" or "analyze".

    **Raises:** `InputError` if SALib is not installed.
    """
    from importlib import import_module

    try:
        return import_module(f"SALib.{part}.sobol")
    except ImportError:
        advice = "install it with: pip install 'vibrojax[design]'"
        raise InputError(f"study: the package SALib, which computes Sobol indices, is missing; {advice}") from None
