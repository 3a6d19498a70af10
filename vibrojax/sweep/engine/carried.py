"""Lanes along one axis one after another, up and down, each from where the last one ended.

What stays where it is although another motion is there too shows by this: the two ways part where it folds.
"""

import numpy as np

from vibrojax.progress import Portions
from vibrojax.sweep.engine.batch import Features, Report, unreported
from vibrojax.sweep.engine.chunks import CHUNK, Beyond, Chunks, joined
from vibrojax.sweep.engine.programs import END
from vibrojax.sweep.input.definition import DIRECTIONS, Sweep

FEWEST_ROWS = 64
"""Ways along the axis per chunk: those that run beside each other."""


class Carried(Chunks):
    """The chunks of a sweep whose lanes are carried along an axis: ways along it, each as a whole.

    A way is all lanes of one direction at one place of the other axes. They run beside each other, from one value of
    the axis to the next.
    """

    def __init__(self, sweep: Sweep, beyond: Beyond | None = None) -> None:
        super().__init__(sweep, beyond)
        assert sweep.run.carry is not None
        self._values = len(sweep.axes[sweep.run.carry])
        wanted = sweep.run.chunk or max(CHUNK, FEWEST_ROWS * self._values)
        self.size = max(wanted // self._values, 1) * self._values
        self.count = -(-sweep.lanes // self.size)

    def compute(self, index: int, report: Report = unreported) -> Features:
        first, end = self.lanes(index)
        self.compile()
        whole = self.engine.start(first, end, self.accuracy)
        ways = np.arange(end - first).reshape(-1, self._values)
        up = (first + ways[:, 0]) // self._values % len(DIRECTIONS) == DIRECTIONS.index("up")
        order = np.where(up[:, None], ways, ways[:, ::-1])
        runs: list[Features] = []
        ended = None
        for lanes in order.T:
            portions = Portions(len(lanes), report)
            batch = whole.of(lanes)
            if ended is not None:
                # A lane that failed leaves nothing to go on from: the way begins anew.
                assert batch.underway is not None
                usable = np.isfinite(ended).all(axis=1)
                begun = batch.underway.lane.state
                batch = self.engine.carried(
                    batch, tuple(np.where(usable, new, old) for new, old in zip(ended.T, begun, strict=True))
                )
            features = self.measured(batch, portions)
            portions.finish()
            ended = features.pop(END)
            runs.append(features)
        place = np.argsort(order.T.ravel())
        return self.finished(index, {name: x[place] for name, x in joined(runs).items()})
