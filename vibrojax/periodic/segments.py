"""The return map of many segments at once, by all workers."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from vibrojax.compile.devices import precision, workers
from vibrojax.models.scenes import Scene
from vibrojax.periodic.newton import ReturnMap
from vibrojax.periodic.return_map import MOST_STEPS, Mapped, mapped
from vibrojax.stepping import LOCATED_STRIDE, Accuracy, Located
from vibrojax.sweep.engine.parallel import in_parallel

SEGMENTS = 512
"""Returns per call of the map, at most."""

FEWEST = 64
"""Returns per call below which another thread is not worth its while."""

STEPS = Accuracy(tolerance=1e-11, stride=LOCATED_STRIDE, step=np.inf)
"""Of the return map. Over the default map multipliers are within 1.2e-8 of those at 1e-14, periods within 3e-13 s."""


class Segments:
    """The return map of a scene and its derivative, in float64.

    **Arguments:** `along`: the parameters that it is taken by too; `most`: steps after which a lane is taken not to
    return.
    """

    def __init__(
        self, scene: Scene[Any], along: tuple[str, ...] = (), steps: Accuracy = STEPS, most: float = MOST_STEPS
    ) -> None:
        self._scene, self._along = scene, along
        self._steps = Accuracy(*map(np.float64, steps))
        self._most = np.float64(most)
        self._workers = workers()

    def of(self, parameters: Mapping[str, Float[np.ndarray, " lanes"]]) -> ReturnMap:
        """The return map of segments, each of one of the lanes that have such `parameters`."""
        return lambda lanes, states: self({name: x[lanes] for name, x in parameters.items()}, states)

    def __call__(
        self, parameters: Mapping[str, Float[np.ndarray, " segments"]], states: Float[np.ndarray, "states segments"]
    ) -> Mapped:
        """The next return of segments; arrays whose last axis is theirs."""
        number = states.shape[1]
        calls = max(-(-number // SEGMENTS), min(len(self._workers), number // FEWEST), 1)
        items = np.array_split(np.arange(number), calls)

        def work(_: jax.Device, some: np.ndarray) -> Mapped:
            with precision("float64"):
                p = {name: x[some] for name, x in parameters.items()}
                return mapped(self._scene, Located(), self._along, p, states[:, some], self._steps, self._most)

        if len(items) == 1:
            return work(self._workers[0], items[0])
        parts: list[Any] = [None] * len(items)
        for index, part in in_parallel(work, items, self._workers):
            parts[index] = part
        return jax.tree.map(lambda *x: np.concatenate(x, axis=-1), *parts)
