"""What is compiled once and run at many settings: the lanes of a scene with one method in one precision."""

from abc import ABC, abstractmethod

from vibrojax.accuracy._lanes import Lanes
from vibrojax.devices import workers
from vibrojax.sweep import Accuracy, Chunks, read_sweep

MOST_STEPS = 1e5
"""Steps after which a lane is given up, beyond those that its longest step asks for: far fewer than in a sweep, because
a setting that is too coarse for a scene should not keep the others waiting."""

BLOCK = 64
"""Lanes per core: as many as step together in a sweep."""


class Program(ABC):
    """The lanes of a scene and how to run them all, copied until every core has a block of them."""

    def __init__(self, lanes: Lanes):
        self.lanes = lanes
        self.workers = workers()
        self.copies = max(BLOCK // lanes.count, 1) * len(self.workers)

    @property
    def lane_seconds(self) -> float:
        """Simulated time of all lanes together [s]."""
        return self.copies * self.lanes.count * (self.lanes.settle + self.lanes.observe)

    @abstractmethod
    def compile(self, accuracy: Accuracy) -> None:
        """Compile it; nothing is run."""

    @abstractmethod
    def run(self, accuracy: Accuracy) -> dict:
        """Run all lanes: what is timed. Returns `steps` and `finished` at least, (lanes and their copies,)."""

    @abstractmethod
    def features(self, accuracy: Accuracy, ran: dict) -> dict:
        """The features of each lane, by name, of what `run` gave; `finite` and `finished` among them."""


class Own(Program):
    """The located or the smoothed stepper, as in a sweep but without the check run."""

    def __init__(self, lanes: Lanes, method: str, precision: str):
        super().__init__(lanes)
        self._chunks = Chunks(read_sweep(lanes.sweep(method, precision, self.copies)))
        self._chunks.programs.most_steps = MOST_STEPS

    def compile(self, accuracy):
        self._chunks.compile()

    def run(self, accuracy):
        return self._chunks.at(accuracy)

    def features(self, accuracy, ran):
        return {name: x[: self.lanes.count] for name, x in ran.items()}
