"""Run a sweep file: a labelled dataset, and a picture beside it."""

import shlex
import threading
from argparse import ArgumentParser
from importlib import import_module
from typing import TYPE_CHECKING

from vibrojax.amounts import size_text, time_text
from vibrojax.cli._command import Options
from vibrojax.cli._complete import sweeps, with_completer
from vibrojax.cli._output import dataset_written, draw, output, picture_beside

if TYPE_CHECKING:
    from vibrojax.engine.resources import Cost


def arguments(parser: ArgumentParser) -> None:
    """Add the command's arguments to `parser`."""
    sweep = parser.add_argument(
        "sweep", metavar="SWEEP", help="a bundled name, like regime-map, or the path of a TOML file"
    )
    with_completer(sweep, sweeps)
    parser.add_argument("-o", dest="out", metavar="OUT.nc", help="where to write (NAME.nc in this folder)")
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
    parser.add_argument("--dry-run", action="store_true", help="print lanes, memory, disk and time; compute nothing")


def run(options: Options) -> None:
    """Run the command."""
    from vibrojax.engine.resources import check_size
    from vibrojax.input.read import read_sweep
    from vibrojax.sweep import estimate, run_to_file

    sweep = read_sweep(options.sweep, options.changes)
    out = output(options.out or f"{sweep.name}.nc")
    picture = picture_beside(out)
    if options.dry_run:
        cost = estimate(sweep)
        print("\n".join(_cost_lines(sweep.shape, sweep.dims, cost)))
        check_size(sweep, cost, out)
        return
    changes = [part for word in options.changes for part in ("--set", word)]
    command = shlex.join(["vibrojax", "sweep", options.sweep, *changes, "-o", str(out)])
    options.how_to_resume = f"finished chunks are kept; to go on: {command}"
    # What draws is imported while the lanes step, which leave Python to itself.
    threading.Thread(target=import_module, args=("vibrojax.plot",), daemon=True).start()
    dataset = run_to_file(sweep, out, resume=not options.fresh, progress=not options.quiet)
    dataset_written(options, out)
    drawn = draw(dataset, picture)
    if not options.quiet:
        each = "a point from one start each" if sweep.starts is not None or sweep.point_vectors else "a point each"
        print(f"{out}: {sweep.lanes} lanes ({each}){drawn}")


def _cost_lines(shape: tuple[int, ...], dims: tuple[str, ...], cost: "Cost") -> list[str]:
    """The lines of a dry run."""
    grid = " x ".join(f"{size} {name}" for name, size in zip(dims, shape, strict=True))
    return [
        f"lanes   {cost['lanes']} ({grid}) in {cost['chunks']} chunks",
        f"memory  {size_text(cost['memory_bytes'])}",
        f"disk    {size_text(cost['disk_bytes'])}",
        f"time    about {_about(cost['time_s'])}: {_about(cost['compile_s'])} to start and compile, "
        f"{_about(cost['step_s'])} to step ({_about(cost['processor_s'])} of processor time)",
    ]


def _about(seconds: float) -> str:
    """A time of which two digits are known at best."""
    return time_text(float(f"{seconds:.2g}"))
