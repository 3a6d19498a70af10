"""Run a sweep: to a dataset in memory, or to a file that loses nothing.

The road of the data: a sweep file is read and checked (`input`); its lanes go in chunks through compiled programs
(`engine`), which step the scene and measure it in the loop; features become labels and a dataset (`engine.labelled`),
which the store writes whole or not at all, its finished chunks kept meanwhile.
"""

import json
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from math import ceil
from os import PathLike
from pathlib import Path

import numpy as np
import xarray as xr

from vibrojax.chaos import Natures
from vibrojax.engine.batch import Features, Report, unreported
from vibrojax.engine.carried import Carried
from vibrojax.engine.chunks import Beyond, Chunks
from vibrojax.engine.costs import by_the_clock, processor_time
from vibrojax.engine.labelled import dataset_of
from vibrojax.engine.resources import Cost, check_size
from vibrojax.input.definition import Sweep
from vibrojax.input.read import read_sweep
from vibrojax.periodic import Nearby, Orbits, early_ends
from vibrojax.progress import Progress
from vibrojax.store.dataset import write_dataset
from vibrojax.store.finished import check_replaceable
from vibrojax.store.provenance import provenance
from vibrojax.store.shards import DamagedShard, Shards, report_damage
from vibrojax.store.variables import VARIABLES
from vibrojax.timings import LOG, timed


def run_sweep(source: str | PathLike[str] | Mapping[str, object] | Sweep, progress: bool = True) -> xr.Dataset:
    """Run a sweep and return its dataset.

    **Arguments:**

    - `source`: path of a TOML file, a bundled name such as "regime-map", or a dict of the same shape.
    - `progress`: whether to say on stderr how far it is.

    **Returns:** the dataset, over the grid's dimensions and `start`.

    **Raises:** `InputError`, before any work, where the sweep is not right or the computer too small for it.
    """
    sweep = source if isinstance(source, Sweep) else read_sweep(source)
    check_size(sweep, estimate(sweep))
    began = time.monotonic()
    chunks = _chunks(sweep)
    shown = Progress(sweep.lanes, "lanes", progress)
    with shown, timed("compile and step"):
        parts = [_computed(chunks, index, shown.add) for index in range(chunks.count)]
    return _assembled(sweep, chunks, parts, time.monotonic() - began)


def run_to_file(sweep: Sweep, out: Path, resume: bool = True, progress: bool = True) -> xr.Dataset:
    """Run a sweep into the netCDF file `out`; its finished chunks lie beside it until it is whole.

    **Arguments:**

    - `resume`: go on with the chunks that are there, if any; otherwise start over, and replace whatever `out` holds.

    **Returns:** the dataset that was written.

    **Raises:** `InputError` where the chunks that are there, or the dataset, are of another sweep, or the computer is
    too small for it.
    """
    if resume:
        check_replaceable(out, sweep.identity())
    check_size(sweep, estimate(sweep), out)
    began = time.monotonic()
    chunks = _chunks(sweep)
    manifest = sweep.identity() | provenance() | {"chunk size": chunks.size}
    shown = Progress(sweep.lanes, "lanes", progress)
    with shown, Shards(out.with_name(out.name + ".chunks"), manifest) as shards:
        shards.open(resume)
        finished = shards.finished()
        shown.resume(sum(chunks.width(index) for index in finished))
        with timed("compile and step"):
            for index in sorted(set(range(chunks.count)) - finished):
                shards.write(index, _timed(chunks, index, shown.add))
        parts = [_read_or_compute(shards, chunks, index) for index in range(chunks.count)]
        seconds = [float(part.pop("seconds")) for part in parts]
        # Also what an interrupted run took; what lies between the runs does not count.
        dataset = _assembled(sweep, chunks, parts, max(sum(seconds), time.monotonic() - began))
        with timed("write"):
            write_dataset(dataset, out)
        shards.remove()
    return dataset


def estimate(sweep: Sweep) -> Cost:
    """What a sweep will take, before any work; the time is rough (see [vibrojax.engine.costs][])."""
    chunks = _chunks(sweep)
    per_lane = 8 * (len(VARIABLES) + 6 * sweep.run.keep_returns)
    processor, cores = processor_time(chunks), len(chunks.engine.workers)
    passing = by_the_clock(processor, cores)
    return Cost(
        lanes=sweep.lanes,
        chunks=chunks.count,
        # A lane in the loop carries some 500 numbers; the results are held once to be labelled and written.
        memory_bytes=400e6 + chunks.size * 8 * 500 + 3 * sweep.lanes * per_lane,
        disk_bytes=ceil(sweep.lanes * per_lane),
        time_s=sum(passing),
        compile_s=passing.start + passing.compile,
        step_s=passing.step,
        processor_s=sum(processor),
    )


def _chunks(sweep: Sweep) -> Chunks:
    if sweep.run.carry is None:
        return Chunks(sweep, _beyond(sweep), early_ends(sweep))
    return Carried(sweep, _beyond(sweep))


def _beyond(sweep: Sweep) -> Beyond | None:
    """What is to be found of lanes that have been observed."""
    parts: list[Beyond] = [Orbits(sweep), Nearby(sweep)] if sweep.run.orbits else []
    parts += [Natures(sweep)] if sweep.run.lyapunov else []

    def found(first: int, end: int, features: Features) -> Features:
        more: Features = {}
        for part in parts:
            more |= part(first, end, features | more)
        return more

    return found if parts else None


def _read_or_compute(shards: Shards, chunks: Chunks, index: int) -> Features:
    """A finished chunk from its file; computed again where that has been damaged meanwhile."""
    try:
        return shards.read(index)
    except DamagedShard as damage:
        report_damage(damage)
        return _timed(chunks, index)


def _timed(chunks: Chunks, index: int, report: Report = unreported) -> Features:
    """A chunk's features, and the `seconds` that they took."""
    began = time.monotonic()
    features = _computed(chunks, index, report)
    return features | {"seconds": np.array(time.monotonic() - began)}


def _computed(chunks: Chunks, index: int, report: Report) -> Features:
    with _quiet():
        return chunks.compute(index, report)


@contextmanager
def _quiet() -> Iterator[None]:
    """Lanes that blow up are flagged: numpy's warnings beside, from any thread, would be a storm."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        yield


def _assembled(sweep: Sweep, chunks: Chunks, parts: list[Features], wall_time: float) -> xr.Dataset:
    features = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    solver = {
        "method": chunks.stepper.name,
        "order": chunks.stepper.order,
        "precision": sweep.run.precision,
        "compiler": chunks.engine.programs.compiler,
        "devices": _devices_text(chunks),
        "steps": int(features["steps"].sum()),
        **chunks.accuracy.described(),
    }
    LOG.info("chosen: %s, %d chunks of %d lanes", json.dumps(solver), chunks.count, chunks.size)
    with _quiet():
        dataset = dataset_of(sweep, features, solver, wall_time)
    if sweep.run.orbits:
        dataset.attrs["orbits"] = json.dumps(Orbits(sweep).described | Nearby(sweep).described)
    if sweep.run.lyapunov:
        dataset.attrs["lyapunov"] = json.dumps(Natures(sweep).described)
    return dataset


def _devices_text(chunks: Chunks) -> str:
    """What lanes run on, in words."""
    device, count = chunks.engine.workers[0], len(chunks.engine.workers)
    return f"{count} cpu cores" if device.platform == "cpu" else f"{count} {device.device_kind}"
