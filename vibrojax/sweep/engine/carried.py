"""Continuation along one axis, up and down: each lane begins in the final state of the previous lane.

Where attractors coexist between two folds, the two directions differ: each stays on its own attractor (hysteresis).
"""

import numpy as np

from vibrojax.progress import Portions
from vibrojax.sweep.engine.batch import Features, Report, unreported
from vibrojax.sweep.engine.chunks import CHUNK, Chunks, PostProcessor, joined
from vibrojax.sweep.engine.programs import END
from vibrojax.sweep.input.definition import DIRECTIONS, Sweep

CARRIED_MIN_ROWS = 64
"""Minimum number of rows per chunk. Rows run in parallel, and fewer would leave blocks of lanes partly empty."""


class Carried(Chunks):
    """Chunks of a sweep with continuation along an axis. Each chunk consists of complete rows.

    A row consists of all lanes along this axis, for one direction and one value of each other axis. All rows advance in
    parallel from one value of the axis to the next.
    """

    def __init__(self, sweep: Sweep, beyond: PostProcessor | None = None) -> None:
        super().__init__(sweep, beyond)
        assert sweep.run.carry is not None
        self._values = len(sweep.axes[sweep.run.carry])
        size = sweep.run.chunk or max(CHUNK, CARRIED_MIN_ROWS * self._values)
        self.size = max(size // self._values, 1) * self._values
        self.count = -(-sweep.lanes // self.size)

    def compute(self, index: int, report: Report = unreported) -> Features:
        first, end = self.lanes(index)
        self.compile()
        whole = self.engine.start(first, end, self.accuracy)
        rows = np.arange(end - first).reshape(-1, self._values)
        up = (first + rows[:, 0]) // self._values % len(DIRECTIONS) == DIRECTIONS.index("up")
        order = np.where(up[:, None], rows, rows[:, ::-1])
        runs: list[Features] = []
        ended = None
        for lanes in order.T:
            portions = Portions(len(lanes), report)
            batch = whole.of(lanes)
            if ended is not None:
                # A failed lane has no final state. The next lane of its row begins in its own initial state.
                assert batch.underway is not None
                usable = np.isfinite(ended).all(axis=1)
                initial = zip(ended.T, batch.underway.lane.state, strict=True)
                batch = self.engine.carried(batch, tuple(np.where(usable, new, old) for new, old in initial))
            features = self.measured(batch, portions)
            portions.finish()
            ended = features.pop(END)
            runs.append(features)
        place = np.argsort(order.T.ravel())
        return self.finished(index, {name: x[place] for name, x in joined(runs).items()})
