"""From finished chunks to a dataset: region by region, so that memory is bounded by a region whatever the lanes.

Regions go through three hands at once, each a thread: chunks are read and checked, lanes labelled, values written. A
large dataset is written about as fast as the disk takes it, which packing is not, see [vibrojax.io.packing][].
"""

import json
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from vibrojax.analyses.chaos import Natures
from vibrojax.analyses.sweep.workers.work import SECONDS, quiet
from vibrojax.io.packing import UP_TO, Sizes
from vibrojax.io.regions import Region, Regions
from vibrojax.io.targets import Frame, Stored, Target
from vibrojax.periodic import Nearby, Orbits
from vibrojax.progress import LOG
from vibrojax.sweep.engine.batch import Features
from vibrojax.sweep.engine.chunks import Chunks
from vibrojax.sweep.engine.labelled import attributes, certified, coordinates, labelled, variables_of
from vibrojax.sweep.input.definition import Sweep

REGION, REGION_BYTES = 1 << 16, 32e6
"""Lanes that are labelled and written together at most, and about how many bytes of features they have."""

AHEAD = 2
"""Regions that are read or labelled before they are written."""

SAMPLES = 4
"""Chunks from all over a large dataset that are looked at to tell what packing leaves of it."""

Read = Callable[[int], Features]
"""A finished chunk's features, by its index; asked for once each, in order, and before that for a few of a large sweep
that goes to a file."""

WallTime = Callable[[float], float]
"""The seconds that a sweep took, from those that its chunks took together."""


def join(sweep: Sweep, chunks: Chunks, read: Read, target: Target, wall_time: WallTime) -> None:
    """Label the lanes of all chunks and write them to `target`, which is then finished.

    Whole points are labelled together, since `hidden_motion` compares their starts.
    """
    lanes = _Lanes(chunks, read)
    counted: Counter[str] = Counter()
    begun = False
    with quiet():
        for part in _labelled(sweep, lanes):
            counted.update(certified(sweep, part.variables) | {"steps": part.steps})
            if not begun:
                frame = _frame(sweep, part.variables)
                if target.packs and frame.nbytes > UP_TO:
                    frame = frame.without_packing(_looked_at(sweep, chunks, read).plain(sweep.lanes))
                target.begin(frame)
                begun = True
            _write(sweep, target, part)
    solver = {
        "method": chunks.stepper.name,
        "order": chunks.stepper.order,
        "precision": sweep.run.precision,
        "compiler": chunks.engine.programs.compiler,
        "devices": _devices_text(chunks),
        "steps": counted.pop("steps"),
        **chunks.accuracy.described(),
    }
    LOG.info("chosen: %s, %d chunks of %d lanes", json.dumps(solver), chunks.count, chunks.size)
    found = attributes(sweep, solver, counted, wall_time(lanes.seconds))
    if sweep.run.orbits:
        found["orbits"] = json.dumps(Orbits(sweep).described | Nearby(sweep).described)
    if sweep.run.lyapunov:
        found["lyapunov"] = json.dumps(Natures(sweep).described)
    target.finish(found)


class _Part(NamedTuple):
    """Regions that are written together: the variables of their lanes, and the steps that these took."""

    regions: list[Region]
    variables: dict[str, np.ndarray]
    steps: int


def _labelled(sweep: Sweep, lanes: "_Lanes") -> Iterator[_Part]:
    """The parts of the dataset, in order; while one is written the next is labelled, and the one after read."""

    def label(regions: list[Region], reading: Future[Features]) -> _Part:
        features = reading.result()
        variables = labelled(sweep, regions[0].first, regions[-1].end, features)
        return _Part(regions, variables, int(features["steps"].sum()))

    ahead: deque[Future[_Part]] = deque()
    with ThreadPoolExecutor(1) as reader, ThreadPoolExecutor(1) as labeller:
        try:
            for regions in _groups(sweep):
                reading = reader.submit(lanes.take, regions[0].first, regions[-1].end)
                ahead.append(labeller.submit(label, regions, reading))
                if len(ahead) > AHEAD:
                    yield ahead.popleft().result()
            while ahead:
                yield ahead.popleft().result()
        finally:
            for one in ahead:
                one.cancel()


def _write(sweep: Sweep, target: Target, part: _Part) -> None:
    """Lanes are counted over the dimensions in another order than that of the dataset where they are carried."""
    first, order = part.regions[0].first, [sweep.counted.index(name) for name in sweep.dims]
    for region in part.regions:
        box = tuple(region.box[at] for at in order)
        for name, x in part.variables.items():
            values = x[region.first - first : region.end - first].reshape(*region.shape, *x.shape[1:])
            target.put(name, box, values.transpose(*order, *range(len(order), values.ndim)))


class _Lanes:
    """The lanes of all chunks one after the other; a chunk at a time is held."""

    def __init__(self, chunks: Chunks, read: Read) -> None:
        self._chunks, self._read = chunks, read
        self._index = -1
        self._features: Features = {}
        self.seconds = 0.0

    def take(self, first: int, end: int) -> Features:
        """Features of the lanes from `first` to before `end`, which come after those that were taken before."""
        parts = []
        for index in range(first // self._chunks.size, (end - 1) // self._chunks.size + 1):
            begin, _ = self._chunks.lanes(index)
            features = self._chunk(index)
            parts.append({name: x[max(first - begin, 0) : end - begin] for name, x in features.items()})
        return parts[0] if len(parts) == 1 else {n: np.concatenate([one[n] for one in parts]) for n in parts[0]}

    def _chunk(self, index: int) -> Features:
        if index != self._index:
            self._index, self._features = index, self._read(index)
            self.seconds += float(self._features.pop(SECONDS))
        return self._features


def _groups(sweep: Sweep) -> Iterator[list[Region]]:
    """Regions, so many together that they hold whole points."""
    starts = sweep.shape[-1] if sweep.crosses_starts else 1
    group: list[Region] = []
    for region in _regions(sweep):
        group.append(region)
        if region.end % starts == 0:
            yield group
            group = []


def _regions(sweep: Sweep) -> Regions:
    per_lane = 8 * (len(variables_of(sweep)) + 6 * sweep.run.keep_returns)
    sizes = dict(zip(sweep.dims, sweep.shape, strict=True))
    counted = tuple(sizes[name] for name in sweep.counted)
    return Regions(counted, int(min(REGION, max(1, REGION_BYTES // per_lane))))


def _frame(sweep: Sweep, variables: Mapping[str, np.ndarray]) -> Frame:
    """What the dataset is going to hold, from the variables of some of its lanes."""
    sizes = dict(zip(sweep.counted, _regions(sweep).chunk, strict=True))
    chunk, stored = tuple(sizes[name] for name in sweep.dims), {}
    rows: dict[str, int] = {}
    known = variables_of(sweep)
    for name, x in variables.items():
        along = (known[name].along,) if x.ndim == 2 else ()
        rows |= dict(zip(along, x.shape[1:], strict=True))
        stored[name] = Stored((*sweep.dims, *along), x.dtype, known[name].attributes(), (*chunk, *x.shape[1:]))
    sizes = dict(zip(sweep.dims, sweep.shape, strict=True)) | rows
    return Frame(sizes, coordinates(sweep, rows), stored)


def _looked_at(sweep: Sweep, chunks: Chunks, read: Read) -> Sizes:
    """What lanes from all over the sweep take."""
    sizes = Sizes()
    for index in dict.fromkeys(np.linspace(0, chunks.count - 1, SAMPLES).astype(int).tolist()):
        some = {name: x for name, x in read(index).items() if name != SECONDS}
        sizes.add(labelled(sweep, *chunks.lanes(index), some, whole=False))
    return sizes


def _devices_text(chunks: Chunks) -> str:
    """What lanes run on, in words."""
    device, count = chunks.engine.workers[0], len(chunks.engine.workers)
    return f"{count} cpu cores" if device.platform == "cpu" else f"{count} {device.device_kind}"
