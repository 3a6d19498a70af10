"""Draw the fitting picture for what a dataset holds."""

from argparse import ArgumentParser
from pathlib import Path

from vibrojax.cli._command import Options
from vibrojax.cli._complete import files, with_completer
from vibrojax.cli._output import PICTURES, output, picture_beside
from vibrojax.timings import timed


def arguments(parser: ArgumentParser) -> None:
    """Add the command's arguments to `parser`."""
    file = parser.add_argument("file", metavar="OUT.nc", help="a dataset written by vibrojax")
    with_completer(file, files(".nc"))
    parser.add_argument("-o", dest="out", metavar="PICTURE.png", help="where to draw (OUT.png beside OUT.nc)")


def run(options: Options) -> None:
    """Run the command."""
    from vibrojax.store.dataset import open_dataset

    path = Path(options.file)
    with timed("read"):
        dataset = open_dataset(path)
    picture = output(options.out, PICTURES) if options.out else picture_beside(path)
    from vibrojax.plot import save_picture

    with timed("draw"):
        save_picture(dataset, picture)
    if not options.quiet:
        print(picture)
