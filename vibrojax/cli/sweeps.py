"""The command `sweep`, and its options for workers."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vibrojax.cli.command import Options, argument, command, either, flag, sweep_names
from vibrojax.cli.output import ZARR, draw, output, stored_line, stored_picture, stored_result
from vibrojax.errors import InputError, counted, shown
from vibrojax.io.formatting import size_text, time_text

if TYPE_CHECKING:
    from vibrojax.sweep.engine.costs import Cost
    from vibrojax.sweep.input.definition import Sweep

_DASK, _SLURM = "dask://", "slurm"

SCHEDULER_TIMEOUT = "10 s"
"""Maximum time to wait for a response of the scheduler."""

MAX_WORKERS = 1000
"""Maximum number of processes or jobs; a larger number is assumed to be a typing error."""

DEFAULT_JOBS = 10
"""Number of SLURM jobs if the option specifies none."""


@command(
    argument("sweep", "SWEEP", "a bundled name, like regime-map, or the path of a TOML file", sweep_names),
    argument("-o", "OUT.nc", "where to write (NAME.nc in this folder); .zarr too", dest="out"),
    argument(
        "--set",
        "NAME=VALUE",
        "set over the file: a parameter (a list is an axis), a key of [run], starts, scene or title; may repeat",
        dest="changes",
        action="append",
        default=[],
    ),
    either(
        flag("--resume", "go on with the finished chunks beside OUT; a finished OUT is kept (the default)"),
        flag("--fresh", "start over, and replace OUT, whatever result of vibrojax it holds"),
    ),
    either(
        argument(
            "--workers",
            "N | dask://HOST:PORT | slurm",
            "compute by N processes on this machine, the workers of a dask scheduler, or jobs of SLURM (slurm:JOBS)",
        ),
        argument(
            "--only",
            "I/N",
            "compute each N-th chunk from the I-th, beside other processes that do the rest in the same folder",
        ),
    ),
    flag("--dry-run", "print lanes, memory, disk and time; compute nothing"),
    flag("--measure", "have --dry-run compute some chunks, to know better"),
)
def sweep(options: Options) -> None:
    """Run a sweep file: write a dataset with the regime of each lane, and a picture."""
    from vibrojax.analyses.sweep.run import run_to_file
    from vibrojax.sweep.input.read import read_sweep

    workers, share = _read_workers(options.workers), _read_share(options.only)
    if share and options.fresh:
        raise InputError("--fresh: has no use with --only, whose processes share what is there; remove the folder")
    if options.measure and not options.dry_run:
        raise InputError("--measure: has no use without --dry-run")
    if "jobs" in workers:
        from vibrojax.analyses.sweep.workers.processes import check_slurm

        check_slurm(f"--workers {options.workers}")
    plan = read_sweep(options.sweep, options.changes)
    out = output(options.out or f"{plan.name}.nc", (".nc", ZARR), drawn=True)
    if out.suffix == ZARR:
        from vibrojax.io.dataset import check_zarr

        check_zarr(out)
    if options.dry_run:
        _print_cost(plan, out, workers.get("processes", 0), options.measure)
        return
    stored = stored_result(options, out, plan.identity())
    if stored is not None:
        drawn = stored_picture(options, stored, out)
        if not options.quiet:
            print(stored_line(stored, out, drawn))
        return
    words = [word for change in options.changes for word in ("--set", change)]
    by = [word for name in ("workers", "only") if (value := getattr(options, name)) for word in (f"--{name}", value)]
    options.advise("finished chunks are kept; to go on", "sweep", options.sweep, *words, "-o", str(out), *by)
    # Stepping releases the interpreter lock.
    threading.Thread(target=_prepare_output, daemon=True).start()
    progress = not options.quiet
    if share:
        from vibrojax.analyses.sweep.run import run_share
        from vibrojax.io.dataset import open_dataset

        if run_share(plan, out, share, progress) is None:
            if progress:
                print(f"{out}: share {options.only} is done; {_remaining_work(out)}")
            return
        dataset = open_dataset(out)
    else:
        with _executor(workers) as engine:
            dataset = run_to_file(plan, out, resume=not options.fresh, progress=progress, **engine)
    drawn = draw(options, dataset, out)
    if progress:
        each = "a point from one start each" if plan.starts is not None or plan.point_vectors else "a point each"
        print(f"{out}: {counted(plan.lanes, 'lane')} ({each}){drawn}")


def _prepare_output() -> None:
    """Import what writing and drawing need, including what xarray and matplotlib import or read at their first use."""
    from io import BytesIO

    import xarray as xr

    from vibrojax.analyses import pictures  # noqa: F401
    from vibrojax.plot.style import new_figure

    with suppress(Exception):  # an error would be reported when it matters
        xr.backends.list_engines()
        xr.Dataset({"x": ("a", [0.0])}, {"a": [0.0]}).load()
        figure = new_figure(1.0, 1.0)
        figure.add_subplot().set_title("x")
        figure.savefig(BytesIO(), format="png")


def _read_workers(text: str | None) -> dict[str, Any]:
    """Return the workers that `--workers` specifies: `processes`, a `dask` scheduler HOST:PORT, SLURM `jobs`, or none.

    **Raises:** `InputError` if the option is malformed.
    """
    if text is None:
        return {}
    if text.isdecimal() and 1 <= int(text) <= MAX_WORKERS:
        return {"processes": int(text)}
    if text.startswith(_DASK) and text.rpartition(":")[2].isdecimal():
        return {"dask": text.removeprefix(_DASK)}
    kind, colon, count = text.partition(":")
    if kind == _SLURM and (not colon or (count.isdecimal() and 1 <= int(count) <= MAX_WORKERS)):
        return {"jobs": int(count or DEFAULT_JOBS)}
    choices = f"a number (1 to {MAX_WORKERS}), dask://HOST:PORT, slurm or slurm:JOBS"
    raise InputError(f"--workers: {shown(text)} is not {choices}")


def _read_share(text: str | None) -> tuple[int, int] | None:
    """Return (I, N) of `--only I/N`, or None without the option; raise `InputError` if it is malformed."""
    if text is None:
        return None
    part, slash, whole = text.partition("/")
    if slash and part.isdecimal() and whole.isdecimal() and 1 <= int(part) <= int(whole):
        return int(part), int(whole)
    raise InputError(f"--only: {shown(text)} is not I/N with I from 1 to N; write 2/3 for the second of three shares")


@contextmanager
def _executor(workers: dict[str, Any]) -> "Iterator[dict[str, Any]]":
    """Yield `workers` as arguments of `run_to_file`, with the executor of a dask scheduler in place of its address.

    **Raises:** `InputError` if dask or the scheduler is missing.
    """
    if "dask" not in workers:
        yield workers
        return
    address = workers["dask"]
    place = f"--workers {_DASK}{address}"
    try:
        from distributed import Client
    except ImportError:
        raise InputError(f'{place}: dask is not installed; pip install "vibrojax[dask]"') from None
    try:
        client = Client(f"tcp://{address}", timeout=SCHEDULER_TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:  # asyncio's TimeoutError is an OSError
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{place}: no scheduler of dask answers there ({reason}); start one: dask scheduler") from None
    with client:
        yield {"executor": client.get_executor()}


def _remaining_work(out: Path) -> str:
    """Return the state of a sweep whose chunks several processes compute for the dataset `out`, as a string."""
    from vibrojax.io.standing import CHUNKS, standing

    try:
        state = standing(out.with_name(out.name + CHUNKS))
    except InputError:  # the sweep has just been finished, and the folder removed
        return "the dataset is whole"
    missing = state.chunks - len(state.finished)
    left = f"of {state.chunks} chunks {{}} left to others".format
    return counted(missing, left("is"), left("are")) if missing else "another process writes the dataset"


def _print_cost(plan: "Sweep", out: Path, processes: int, measure: bool) -> None:
    """Print the estimated cost of a sweep; raise `InputError` if memory or disk of this machine are too small."""
    from vibrojax.analyses.sweep.run import estimate
    from vibrojax.sweep.engine.costs import check_size

    def about(seconds: float) -> str:  # with two digits: an estimate is not more accurate
        return time_text(float(f"{seconds:.2g}"))

    measured = None
    if measure:
        from vibrojax.analyses.sweep.workers.work import measured as measure_lanes

        measured = measure_lanes(plan)
    cost: Cost = estimate(plan, to_file=True, processes=processes, measured=measured)
    grid = " x ".join(f"{size} {name}" for name, size in zip(plan.dims, plan.shape, strict=True))
    print(f"lanes   {cost['lanes']} ({grid}) in {counted(cost['chunks'], 'chunk')}")
    print(f"memory  {size_text(cost['memory_bytes'])}")
    print(f"disk    {size_text(cost['disk_bytes'])} while it runs, {size_text(cost['file_bytes'])} then")
    print(f"time    about {about(cost['time_s'])}: {about(cost['compile_s'])} to start and compile, ", end="")
    print(f"{about(cost['step_s'])} to step ({about(cost['processor_s'])} of processor time)")
    if cost["time_s"] > 3600 and cost["hour_workers"]:
        bring = counted(cost["hour_workers"], "worker of one core brings", "workers of one core each bring")
        print(f"hour    {bring} it under an hour")
    check_size(plan, cost, out)
