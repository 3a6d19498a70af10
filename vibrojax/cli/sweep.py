"""Run a sweep file: a labelled dataset, and a picture beside it."""

import shlex
import threading
from argparse import ArgumentParser
from contextlib import nullcontext
from importlib import import_module
from typing import TYPE_CHECKING, Any

from vibrojax.cli.completion import sweeps, with_completer
from vibrojax.cli.output import ZARR, Options, dataset_written, draw, output, picture_beside
from vibrojax.cli.workers import dask_executor, read_share, read_workers
from vibrojax.errors import InputError
from vibrojax.io.formatting import size_text, time_text

if TYPE_CHECKING:
    from pathlib import Path

    from vibrojax.analyses.sweep.workers.measured import Measured
    from vibrojax.sweep.engine.resources import Cost
    from vibrojax.sweep.input.definition import Sweep


def arguments(parser: ArgumentParser) -> None:
    """Add the command's arguments to `parser`."""
    sweep = parser.add_argument(
        "sweep", metavar="SWEEP", help="a bundled name, like regime-map, or the path of a TOML file"
    )
    with_completer(sweep, sweeps)
    parser.add_argument("-o", dest="out", metavar="OUT.nc", help="where to write (NAME.nc in this folder); .zarr too")
    parser.add_argument(
        "--set",
        dest="changes",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="set over the file: a parameter (a list is an axis), a key of [run], starts, scene or title; may repeat",
    )
    start = parser.add_mutually_exclusive_group()
    start.add_argument("--resume", action="store_true", help="go on with the finished chunks beside OUT (the default)")
    start.add_argument("--fresh", action="store_true", help="start over, and replace OUT whatever it holds")
    by = parser.add_mutually_exclusive_group()
    by.add_argument(
        "--workers",
        metavar="N | dask://HOST:PORT | slurm",
        help="compute by N processes on this machine, the workers of a dask scheduler, or jobs of SLURM (slurm:JOBS)",
    )
    by.add_argument(
        "--only",
        metavar="I/N",
        help="compute each N-th chunk from the I-th, beside other processes that do the rest in the same folder",
    )
    parser.add_argument("--dry-run", action="store_true", help="print lanes, memory, disk and time; compute nothing")
    parser.add_argument("--measure", action="store_true", help="have --dry-run compute some chunks, to know better")


def run(options: Options) -> None:
    """Run the command."""
    from vibrojax.analyses.sweep.run import estimate, run_to_file
    from vibrojax.sweep.engine.resources import check_size
    from vibrojax.sweep.input.read import read_sweep

    workers, share = read_workers(options.workers), read_share(options.only)
    if share and options.fresh:
        raise InputError("--fresh: has no use with --only, whose processes share what is there; remove the folder")
    if options.measure and not options.dry_run:
        raise InputError("--measure: has no use without --dry-run")
    if workers.jobs is not None:
        from vibrojax.analyses.sweep.workers.slurm import check_slurm

        check_slurm(f"--workers {options.workers}")
    sweep = read_sweep(options.sweep, options.changes)
    out = output(options.out or f"{sweep.name}.nc", (".nc", ZARR))
    if out.suffix == ZARR:
        from vibrojax.io.dataset import check_zarr

        check_zarr(out)
    picture = picture_beside(out)
    if options.dry_run:
        cost = estimate(sweep, to_file=True, processes=workers.processes or 0, measured=_measured(options, sweep))
        print("\n".join(_cost_lines(sweep.shape, sweep.dims, cost)))
        check_size(sweep, cost, out)
        return
    changes = [part for word in options.changes for part in ("--set", word)]
    by = [part for name in ("workers", "only") if (word := getattr(options, name)) for part in (f"--{name}", word)]
    command = shlex.join(["vibrojax", "sweep", options.sweep, *changes, "-o", str(out), *by])
    options.how_to_resume = f"finished chunks are kept; to go on: {command}"
    # What draws is imported while the lanes step, which leave Python to itself.
    threading.Thread(target=import_module, args=("vibrojax.analyses.pictures",), daemon=True).start()
    progress = not options.quiet
    if share:
        from vibrojax.analyses.sweep.run import run_share
        from vibrojax.io.dataset import open_dataset

        if run_share(sweep, out, share, progress) is None:
            if progress:
                print(f"{out}: share {options.only} is done; {_unfinished(out)}")
            return
        dataset = open_dataset(out)
    else:
        with dask_executor(workers.dask) if workers.dask else nullcontext() as executor:
            by_whom = {"executor": executor, "processes": workers.processes, "jobs": workers.jobs}
            given: dict[str, Any] = {name: one for name, one in by_whom.items() if one is not None}
            dataset = run_to_file(sweep, out, resume=not options.fresh, progress=progress, **given)
    dataset_written(options, out)
    drawn = draw(dataset, picture)
    if not options.quiet:
        each = "a point from one start each" if sweep.starts is not None or sweep.point_vectors else "a point each"
        print(f"{out}: {sweep.lanes} lanes ({each}){drawn}")


def _measured(options: Options, sweep: "Sweep") -> "Measured | None":
    """What some of the sweep's lanes take, if that is asked for."""
    if not options.measure:
        return None
    from vibrojax.analyses.sweep.workers.measured import measured

    return measured(sweep)


def _unfinished(out: "Path") -> str:
    """What is left to do for the sweep of several processes that becomes `out`."""
    from vibrojax.io.standing import CHUNKS, standing

    try:
        found = standing(out.with_name(out.name + CHUNKS))
    except InputError:  # finished and removed this moment
        return "the dataset is whole"
    left = found.chunks - len(found.finished)
    return f"{left} of {found.chunks} chunks are left to others" if left else "another process writes the dataset"


def _cost_lines(shape: tuple[int, ...], dims: tuple[str, ...], cost: "Cost") -> list[str]:
    """The lines of a dry run."""
    grid = " x ".join(f"{size} {name}" for name, size in zip(dims, shape, strict=True))
    return [
        f"lanes   {cost['lanes']} ({grid}) in {cost['chunks']} chunks",
        f"memory  {size_text(cost['memory_bytes'])}",
        f"disk    {size_text(cost['disk_bytes'])} while it runs, {size_text(cost['file_bytes'])} then",
        f"time    about {_about(cost['time_s'])}: {_about(cost['compile_s'])} to start and compile, "
        f"{_about(cost['step_s'])} to step ({_about(cost['processor_s'])} of processor time)",
        *_hour_line(cost),
    ]


def _hour_line(cost: "Cost") -> list[str]:
    if cost["time_s"] <= 3600 or not cost["hour_workers"]:
        return []
    return [f"hour    {cost['hour_workers']} workers of one core each bring it under an hour"]


def _about(seconds: float) -> str:
    """A time of which two digits are known at best."""
    return time_text(float(f"{seconds:.2g}"))
