"""The return map of many segments (motions to the next section crossing) at once, distributed over all workers."""

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

MAX_SEGMENTS_PER_CALL = 512
"""Largest number of segments per call of the map."""

MIN_SEGMENTS_PER_THREAD = 64
"""Smallest number of segments per thread; with fewer, another thread costs more than it saves."""

STEPS = Accuracy(tolerance=1e-11, stride=LOCATED_STRIDE, step=np.inf)
"""Accuracy of the steps. Over the default map, multipliers deviate by up to 1.2e-8 from those at tolerance 1e-14, and
periods by up to 3e-13 s."""


class Segments:
    """The return map of a scene and its derivative, in float64.

    **Arguments:** `along`: names of parameters with respect to which the map is differentiated in addition to the
    states; `steps`: accuracy of the steps; `most`: step limit, above which a lane counts as not returning.
    """

    def __init__(
        self, scene: Scene[Any], along: tuple[str, ...] = (), steps: Accuracy = STEPS, most: float = MOST_STEPS
    ) -> None:
        self._scene, self._along = scene, along
        self._steps = Accuracy(*map(np.float64, steps))
        self._most = np.float64(most)
        self._workers = workers()

    def of(self, parameters: Mapping[str, Float[np.ndarray, " lanes"]]) -> ReturnMap:
        """Return the map `(lanes, states) -> Mapped` for lanes with the given parameters."""
        return lambda lanes, states: self({name: x[lanes] for name, x in parameters.items()}, states)

    def __call__(
        self, parameters: Mapping[str, Float[np.ndarray, " segments"]], states: Float[np.ndarray, "states segments"]
    ) -> Mapped:
        """Return the image of each segment at the next section crossing; the last axis of all arrays is the segment."""
        number = states.shape[1]
        by_threads = min(len(self._workers), number // MIN_SEGMENTS_PER_THREAD)
        calls = max(-(-number // MAX_SEGMENTS_PER_CALL), by_threads, 1)
        items = np.array_split(np.arange(number), calls)

        def work(_: jax.Device, part: np.ndarray) -> Mapped:
            with precision("float64"):
                p = {name: x[part] for name, x in parameters.items()}
                return mapped(self._scene, Located(), self._along, p, states[:, part], self._steps, self._most)

        if len(items) == 1:
            return work(self._workers[0], items[0])
        parts: list[Any] = [None] * len(items)
        for index, part in in_parallel(work, items, self._workers):
            parts[index] = part
        return jax.tree.map(lambda *x: np.concatenate(x, axis=-1), *parts)
