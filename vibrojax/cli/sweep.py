"""The command `sweep`, and the executors that `--workers` names."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from vibrojax.cli.arguments import KEPT, Options, argument, command, either, flag
from vibrojax.cli.output import ZARR, output, result
from vibrojax.errors import InputError, counted, first_line, shown
from vibrojax.io.files import size_text, time_text

if TYPE_CHECKING:
    import xarray

    from vibrojax.maps.executor import Executor
    from vibrojax.maps.sweep import Sweep

_DASK, _SLURM = "dask://", "slurm"

MAX_JOBS = 1000
"""Maximum number of SLURM jobs at a time; a larger number is assumed to be a typing error."""


@command(
    argument("sweep", "SWEEP", "a bundled name such as regime-map, or the path of a TOML file"),
    argument("-o", "OUT.nc", "output file, .nc or .zarr (default: NAME.nc in this folder)", dest="out"),
    argument(
        "--set",
        "NAME=VALUE",
        "override a value of the file: a parameter (a list becomes an axis), a key of [run], starts, scene or title; "
        "can be repeated",
        dest="changes",
        action="append",
        default=[],
    ),
    either(
        flag("--resume", "continue from the finished chunks beside OUT; keep OUT if it is complete (default)"),
        flag("--fresh", "start over, and replace any vibrojax result in OUT"),
    ),
    argument(
        "--workers",
        "dask://HOST:PORT | slurm[:N]",
        "compute on the workers of a dask scheduler, or in SLURM jobs, N at a time (default: 10)",
    ),
    flag("--dry-run", "compute at most 256 lanes, and print the lanes, memory, disk space and time of the whole sweep"),
)
def sweep(options: Options) -> None:
    """Run a sweep file: write a dataset with the regime of each lane, and a picture."""
    from vibrojax.io.dataset import check_zarr
    from vibrojax.maps.read import read_sweep
    from vibrojax.maps.run import run_to_file

    engine = _read_workers(options.workers)
    plan = read_sweep(options.sweep, options.changes)
    default, endings, progress = f"{plan.name}.nc", (".nc", ZARR), not options.quiet
    if (options.out or "").endswith(ZARR):
        check_zarr(Path(options.out))
    if options.dry_run:
        _print_cost(plan, output(options.out or default, endings, drawn=True))
        return

    def computed(out: Path, _: ExitStack) -> "xarray.Dataset":
        again = [word for change in options.changes for word in ("--set", change)] + ["-o", str(out)]
        again += ["--workers", options.workers] if options.workers else []
        options.advise(KEPT, "sweep", options.sweep, *again)
        with engine(out) as executor:
            return run_to_file(plan, out, not options.fresh, progress, executor, meanwhile=_prepare_output)

    each = "a point from one start each" if plan.starts is not None else "a point each"
    result(
        options,
        default,
        plan.identity(),
        computed,
        endings=endings,
        written=True,
        counted=lambda _: f": {counted(plan.lanes, 'lane')} ({each})",
    ).print(options, lines=())


def _prepare_output() -> None:
    """Import what writing and drawing need, including what xarray and matplotlib import or read at their first use.

    This runs while lanes are stepped, which releases the interpreter lock.
    """
    from io import BytesIO

    import xarray as xr

    from vibrojax.pictures.draw import new_figure
    from vibrojax.studies import choose as pictures  # noqa: F401

    with suppress(Exception):  # an error would be reported when it matters
        xr.backends.list_engines()
        xr.Dataset({"x": ("a", [0.0])}, {"a": [0.0]}).load()
        figure = new_figure(1.0, 1.0)
        figure.add_subplot().set_title("x")
        figure.savefig(BytesIO(), format="png")


def _read_workers(text: str | None) -> "Callable[[Path], AbstractContextManager[Executor | None]]":
    """Return a function that opens, for an output file, the executor that `--workers` specifies.

    **Raises:** `InputError` if the option is malformed.
    """
    if text is None:
        return lambda _: nullcontext()
    if text.startswith(_DASK) and text.rpartition(":")[2].isdecimal():
        return lambda _: _dask_executor(text.removeprefix(_DASK))
    kind, colon, count = text.partition(":")
    if kind == _SLURM and (not colon or (count.isdecimal() and 1 <= int(count) <= MAX_JOBS)):
        from vibrojax.maps.executor import slurm_executor

        return lambda out: slurm_executor(out.with_name(out.name + ".jobs").absolute(), int(count or 10))
    raise InputError(f"--workers: {shown(text)} is not dask://HOST:PORT, slurm or slurm:N (N from 1 to {MAX_JOBS})")


@contextmanager
def _dask_executor(address: str) -> "Iterator[Executor]":
    """Yield an executor of the dask scheduler at `address`; raise `InputError` if dask or the scheduler is missing."""
    place = f"--workers {_DASK}{address}"
    try:
        from distributed import Client
    except ImportError:
        raise InputError(f'{place}: dask is not installed; pip install "vibrojax[dask]"') from None
    try:
        client = Client(f"tcp://{address}", timeout="10 s", set_as_default=False)
    except (OSError, ValueError) as error:  # asyncio's TimeoutError is an OSError
        problem = f"no scheduler of dask answers there ({first_line(error)}); start one: dask scheduler"
        raise InputError(f"{place}: {problem}") from None
    with client:
        yield client.get_executor()


def _print_cost(plan: "Sweep", out: Path) -> None:
    """Print the cost of a sweep; raise `InputError` if memory or disk of this machine are too small."""
    from vibrojax.maps.cost import check_size, tried

    check_size(plan, out, to_file=True)
    cost = tried(plan)
    grid = " x ".join(f"{size} {name}" for name, size in zip(plan.dims, plan.shape, strict=True))
    print(f"lanes   {plan.lanes} ({grid}) in {counted(plan.chunks, 'chunk')}")
    print(f"memory  {size_text(cost.memory)}")
    print(f"disk    {size_text(cost.disk)} while it runs, {size_text(cost.file)} then")
    # With two digits: an estimate is not more accurate.
    print(f"time    about {time_text(float(f'{cost.seconds:.2g}'))} on the cores of this machine")
    check_size(plan, out, cost=cost)
