"""Write a page to click through, one HTML file: map, and of every cell its orbit, history, spectrum and numbers."""

from argparse import ArgumentParser
from pathlib import Path

from vibrojax.cli._command import Options
from vibrojax.cli._complete import files, with_completer
from vibrojax.cli._output import output
from vibrojax.errors import InputError
from vibrojax.timings import timed


def arguments(parser: ArgumentParser) -> None:
    """Add the command's arguments to `parser`."""
    file = parser.add_argument(
        "file",
        metavar="OUT.nc",
        help="a dataset of vibrojax: of a sweep, its orbits, attractors or borders, families, one motion, or a fit",
    )
    with_completer(file, files(".nc"))
    parser.add_argument("-o", dest="out", metavar="PAGE.html", help="where to write (OUT.html beside OUT.nc)")
    over = parser.add_argument(
        "--over", metavar="BORDERS.nc", help="lay over the map what vibrojax borders has found in the same plane"
    )
    with_completer(over, files(".nc"))


def run(options: Options) -> None:
    """Run the command."""
    from vibrojax.store.dataset import open_dataset

    path = Path(options.file)
    out = output(options.out, (".html",)) if options.out else path.with_suffix(".html")
    with timed("read"):
        dataset = open_dataset(path)
        over = open_dataset(Path(options.over)) if options.over else None
    from vibrojax.explorer import write_page

    with dataset, timed("compute and write"):
        try:
            write_page(dataset, out, over, progress=not options.quiet)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    if not options.quiet:
        print(f"{out}: {out.stat().st_size / 1e6:.1f} MB")
