"""Run a sweep file: a labelled dataset, and a picture beside it."""

import shlex
from argparse import ArgumentParser, Namespace

from vibrojax.amounts import size_text, time_text
from vibrojax.cli._output import drawn, output, picture_beside, written


def arguments(parser: ArgumentParser) -> None:
    """Add the command's arguments to `parser`."""
    parser.add_argument("sweep", metavar="SWEEP", help="a bundled name, like regime-map, or the path of a TOML file")
    parser.add_argument("-o", dest="out", metavar="OUT.nc", help="where to write (NAME.nc in this folder)")
    start = parser.add_mutually_exclusive_group()
    start.add_argument("--resume", action="store_true", help="go on with the finished chunks beside OUT (the default)")
    start.add_argument("--fresh", action="store_true", help="start over")
    parser.add_argument("--dry-run", action="store_true", help="print lanes, memory, disk and time; compute nothing")
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")


def run(options: Namespace) -> None:
    """Run the command."""
    from vibrojax.sweep import check_size, estimate, read_sweep, run_to_file

    sweep = read_sweep(options.sweep)
    out = output(options.out or f"{sweep.name}.nc")
    picture = picture_beside(out)
    if options.dry_run:
        cost = estimate(sweep)
        print("\n".join(_estimated(sweep.shape, sweep.dims, cost)))
        return check_size(sweep, cost, out)
    command = shlex.join(["vibrojax", "sweep", options.sweep, "-o", str(out)])
    options.how_to_resume = f"finished chunks are kept; to go on: {command}"
    dataset = run_to_file(sweep, out, resume=not options.fresh, progress=not options.quiet)
    written(options, out)
    told = drawn(dataset, picture)
    if not options.quiet:
        print(f"{out}: {sweep.lanes} lanes{told}")


def _estimated(shape: tuple[int, ...], dims: tuple[str, ...], found: dict) -> list[str]:
    """The lines of a dry run."""
    grid = " x ".join(f"{size} {name}" for name, size in zip(dims, shape, strict=True))
    return [
        f"lanes   {found['lanes']} ({grid}) in {found['chunks']} chunks",
        f"memory  {size_text(found['memory_bytes'])}",
        f"disk    {size_text(found['disk_bytes'])}",
        f"time    {time_text(found['time_s'])}",
    ]
