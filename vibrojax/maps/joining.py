"""Assembly of a sweep's dataset from its finished chunks, one block of lanes after another, to limit memory.

A block, here called region, fills a box in the dataset's arrays. Three threads work on successive regions: one reads
and checks chunks, one labels lanes, and one writes values. A large dataset is written about as fast as the disk allows;
file compression is slower, see [vibrojax.io.dataset][].
"""

import json
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from vibrojax.io.targets import Region, Regions, Target
from vibrojax.lanes.batch import Features
from vibrojax.lanes.chunks import Chunks
from vibrojax.lanes.labelled import attributes, certified, coordinates, labelled, variables_of
from vibrojax.maps.sweep import Sweep
from vibrojax.maps.work import SECONDS, quiet
from vibrojax.periodic import Nearby, Orbits
from vibrojax.periodic.natures import EXPONENTS_DESCRIBED
from vibrojax.progress import LOG

REGION, REGION_BYTES = 1 << 16, 32e6
"""Maximum number of lanes that are labelled and written together, and approximate limit on their features [bytes]."""

REGIONS_AHEAD = 2
"""Number of regions that are read or labelled in advance of writing."""

COMPRESSED_BYTES = 64e6
"""Size of a dataset [bytes] up to which all variables are compressed. In a larger one, flags, counts and variables that
most lanes lack are, since they shrink to a fifth or less. Measured numbers shrink to four fifths only, which takes one
core several times as long as writing them."""

Read = Callable[[int], Features]
"""Function that returns a finished chunk's features. Every index is read once, in order."""

WallTime = Callable[[float], float]
"""Function that returns the duration [s] of a sweep, given the sum of its chunks' computing times [s]."""


def join(sweep: Sweep, chunks: Chunks, read: Read, target: Target, wall_time: WallTime) -> None:
    """Label the lanes of all chunks, write them to `target`, and finish the target.

    All initial conditions of a point are labelled together, since `hidden_motion` compares them.
    """
    lanes = _Lanes(chunks, read)
    counts: Counter[str] = Counter()
    begun = False
    with quiet():
        for part in _parts(sweep, lanes):
            counts.update(certified(sweep, part.variables) | {"steps": part.steps})
            if not begun:
                template = _template(sweep, part.variables)
                known = {name: np.mean(np.isfinite(x)) for name, x in part.variables.items() if x.dtype.kind == "f"}
                large = template.nbytes > COMPRESSED_BYTES
                plain = {name for name, share in known.items() if share > 0.5 and large}
                region = dict(zip(sweep.counted, _regions(sweep).chunk, strict=True))
                target.begin(template, tuple(region[name] for name in sweep.dims), frozenset(plain))
                begun = True
            _write(sweep, target, part)
    device, cores = chunks.engine.workers[0], len(chunks.engine.workers)
    solver = {
        "method": chunks.stepper.name,
        "order": chunks.stepper.order,
        "precision": sweep.run.precision,
        "compiler": chunks.engine.programs.compiler,
        "devices": f"{cores} cpu cores" if device.platform == "cpu" else f"{cores} {device.device_kind}",
        "steps": counts.pop("steps"),
        **chunks.accuracy.described(),
    }
    LOG.info("chosen: %s, %d chunks of %d lanes", json.dumps(solver), chunks.count, chunks.size)
    values = attributes(sweep, solver, counts, wall_time(lanes.seconds))
    if sweep.run.orbits:
        values["orbits"] = json.dumps(Orbits(sweep).described | Nearby(sweep).described)
    if sweep.run.lyapunov:
        values["lyapunov"] = json.dumps(EXPONENTS_DESCRIBED)
    target.finish(values)


class _Part(NamedTuple):
    """Array regions that are written together, the variables of their lanes, and the lanes' number of time steps."""

    regions: list[Region]
    variables: dict[str, np.ndarray]
    steps: int


def _parts(sweep: Sweep, lanes: "_Lanes") -> Iterator[_Part]:
    """Yield the parts of the dataset in order.

    While one part is written, the next one is labelled, and the one after that is read.
    """

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
                if len(ahead) > REGIONS_AHEAD:
                    yield ahead.popleft().result()
            while ahead:
                yield ahead.popleft().result()
        finally:
            for future in ahead:
                future.cancel()


def _write(sweep: Sweep, target: Target, part: _Part) -> None:
    # With `carry`, the order of dimensions in which lanes are numbered differs from that of the dataset.
    first, order = part.regions[0].first, [sweep.counted.index(name) for name in sweep.dims]
    for region in part.regions:
        box = tuple(region.box[axis] for axis in order)
        for name, x in part.variables.items():
            values = x[region.first - first : region.end - first].reshape(*region.shape, *x.shape[1:])
            target.put(name, box, values.transpose(*order, *range(len(order), values.ndim)))


class _Lanes:
    """Sequential access to the lanes of all chunks, with one chunk in memory at a time."""

    def __init__(self, chunks: Chunks, read: Read) -> None:
        self._chunks, self._read = chunks, read
        self._index = -1
        self._features: Features = {}
        self.seconds = 0.0

    def take(self, first: int, end: int) -> Features:
        """Return the features of the lanes from `first` (inclusive) to `end` (exclusive).

        These lanes must follow those of earlier calls.
        """
        parts = []
        for index in range(first // self._chunks.size, (end - 1) // self._chunks.size + 1):
            if index != self._index:
                self._index, self._features = index, self._read(index)
                self.seconds += float(self._features.pop(SECONDS))
            begin, _ = self._chunks.lanes(index)
            parts.append({name: x[max(first - begin, 0) : end - begin] for name, x in self._features.items()})
        return parts[0] if len(parts) == 1 else {n: np.concatenate([part[n] for part in parts]) for n in parts[0]}


def _groups(sweep: Sweep) -> Iterator[list[Region]]:
    """Yield groups of array regions; each group holds all initial conditions of its points."""
    starts = sweep.shape[-1] if sweep.crosses_starts else 1
    group: list[Region] = []
    for region in _regions(sweep):
        group.append(region)
        if region.end % starts == 0:
            yield group
            group = []


def _regions(sweep: Sweep) -> Regions:
    lane_bytes = 8 * (len(variables_of(sweep)) + 6 * sweep.run.keep_returns)
    sizes = dict(zip(sweep.dims, sweep.shape, strict=True))
    return Regions(tuple(sizes[name] for name in sweep.counted), int(min(REGION, max(1, REGION_BYTES // lane_bytes))))


def _template(sweep: Sweep, variables: Mapping[str, np.ndarray]) -> xr.Dataset:
    """Return the dataset with placeholder values that take no memory, given the variables of some of its lanes."""
    columns: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, Any]]] = {}
    rows: dict[str, int] = {}
    known = variables_of(sweep)
    for name, x in variables.items():
        along = (known[name].along,) if x.ndim == 2 else ()
        rows |= dict(zip(along, x.shape[1:], strict=True))
        placeholder = np.broadcast_to(np.zeros((), x.dtype), (*sweep.shape, *x.shape[1:]))
        columns[name] = ((*sweep.dims, *along), placeholder, known[name].attributes())
    return xr.Dataset(columns, dict(coordinates(sweep, rows)))
