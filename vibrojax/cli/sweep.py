"""Run a sweep file: write a dataset with the regime of each lane, and a picture."""

import threading
from argparse import ArgumentParser
from contextlib import nullcontext
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vibrojax.cli.completion import add_argument, sweeps
from vibrojax.cli.output import ZARR, Options, draw, output, picture_beside
from vibrojax.cli.workers import dask_executor, read_share, read_workers
from vibrojax.errors import InputError
from vibrojax.io.formatting import size_text, time_text

if TYPE_CHECKING:
    from vibrojax.sweep.engine.costs import Cost
    from vibrojax.sweep.input.definition import Sweep


def arguments(parser: ArgumentParser) -> None:
    about = "a bundled name, like regime-map, or the path of a TOML file"
    add_argument(parser, "sweep", completer=sweeps, metavar="SWEEP", help=about)
    parser.add_argument("-o", dest="out", metavar="OUT.nc", help="where to write (NAME.nc in this folder); .zarr too")
    about = "set over the file: a parameter (a list is an axis), a key of [run], starts, scene or title; may repeat"
    parser.add_argument("--set", dest="changes", metavar="NAME=VALUE", action="append", default=[], help=about)
    start = parser.add_mutually_exclusive_group()
    start.add_argument("--resume", action="store_true", help="go on with the finished chunks beside OUT (the default)")
    start.add_argument("--fresh", action="store_true", help="start over, and replace OUT whatever it holds")
    by = parser.add_mutually_exclusive_group()
    about = "compute by N processes on this machine, the workers of a dask scheduler, or jobs of SLURM (slurm:JOBS)"
    by.add_argument("--workers", metavar="N | dask://HOST:PORT | slurm", help=about)
    about = "compute each N-th chunk from the I-th, beside other processes that do the rest in the same folder"
    by.add_argument("--only", metavar="I/N", help=about)
    parser.add_argument("--dry-run", action="store_true", help="print lanes, memory, disk and time; compute nothing")
    parser.add_argument("--measure", action="store_true", help="have --dry-run compute some chunks, to know better")


def run(options: Options) -> None:
    from vibrojax.analyses.sweep.run import run_to_file
    from vibrojax.sweep.input.read import read_sweep

    workers, share = read_workers(options.workers), read_share(options.only)
    if share and options.fresh:
        raise InputError("--fresh: has no use with --only, whose processes share what is there; remove the folder")
    if options.measure and not options.dry_run:
        raise InputError("--measure: has no use without --dry-run")
    if workers.jobs is not None:
        from vibrojax.analyses.sweep.workers.processes import check_slurm

        check_slurm(f"--workers {options.workers}")
    sweep = read_sweep(options.sweep, options.changes)
    out = output(options.out or f"{sweep.name}.nc", (".nc", ZARR))
    if out.suffix == ZARR:
        from vibrojax.io.dataset import check_zarr

        check_zarr(out)
    picture = picture_beside(out)
    if options.dry_run:
        _print_cost(sweep, out, workers.processes or 0, options.measure)
        return
    words = [word for change in options.changes for word in ("--set", change)]
    by = [word for name in ("workers", "only") if (value := getattr(options, name)) for word in (f"--{name}", value)]
    options.advise("finished chunks are kept; to go on", "sweep", options.sweep, *words, "-o", str(out), *by)
    # Import the drawing modules while the lanes are stepped: stepping releases the interpreter lock.
    threading.Thread(target=import_module, args=("vibrojax.analyses.pictures",), daemon=True).start()
    progress = not options.quiet
    if share:
        from vibrojax.analyses.sweep.run import run_share
        from vibrojax.io.dataset import open_dataset

        if run_share(sweep, out, share, progress) is None:
            if progress:
                print(f"{out}: share {options.only} is done; {_remaining_work(out)}")
            return
        dataset = open_dataset(out)
    else:
        with dask_executor(workers.dask) if workers.dask else nullcontext() as executor:
            engines = {"executor": executor, "processes": workers.processes, "jobs": workers.jobs}
            engine: dict[str, Any] = {name: value for name, value in engines.items() if value is not None}
            dataset = run_to_file(sweep, out, resume=not options.fresh, progress=progress, **engine)
    drawn = draw(options, dataset, out, picture)
    if progress:
        each = "a point from one start each" if sweep.starts is not None or sweep.point_vectors else "a point each"
        print(f"{out}: {sweep.lanes} lanes ({each}){drawn}")


def _remaining_work(out: Path) -> str:
    """Return the state of a sweep whose chunks several processes compute for the dataset `out`, as a string."""
    from vibrojax.io.standing import CHUNKS, standing

    try:
        state = standing(out.with_name(out.name + CHUNKS))
    except InputError:  # the sweep has just been finished, and the folder removed
        return "the dataset is whole"
    missing = state.chunks - len(state.finished)
    return f"{missing} of {state.chunks} chunks are left to others" if missing else "another process writes the dataset"


def _print_cost(sweep: "Sweep", out: Path, processes: int, measure: bool) -> None:
    """Print the estimated cost of a sweep; raise `InputError` if memory or disk of this machine are too small."""
    from vibrojax.analyses.sweep.run import estimate
    from vibrojax.sweep.engine.costs import check_size

    measured = None
    if measure:
        from vibrojax.analyses.sweep.workers.work import measured as measure_lanes

        measured = measure_lanes(sweep)
    cost: Cost = estimate(sweep, to_file=True, processes=processes, measured=measured)
    grid = " x ".join(f"{size} {name}" for name, size in zip(sweep.dims, sweep.shape, strict=True))
    print(f"lanes   {cost['lanes']} ({grid}) in {cost['chunks']} chunks")
    print(f"memory  {size_text(cost['memory_bytes'])}")
    print(f"disk    {size_text(cost['disk_bytes'])} while it runs, {size_text(cost['file_bytes'])} then")
    print(f"time    about {_about(cost['time_s'])}: {_about(cost['compile_s'])} to start and compile, ", end="")
    print(f"{_about(cost['step_s'])} to step ({_about(cost['processor_s'])} of processor time)")
    if cost["time_s"] > 3600 and cost["hour_workers"]:
        print(f"hour    {cost['hour_workers']} workers of one core each bring it under an hour")
    check_size(sweep, cost, out)


def _about(seconds: float) -> str:
    """Return a time as a string with two digits: an estimate is not more accurate."""
    return time_text(float(f"{seconds:.2g}"))
