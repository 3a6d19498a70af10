"""Draw the fitting picture for what a dataset holds, or variables of it, at values of its axes."""

from argparse import ArgumentParser
from collections.abc import Sequence
from pathlib import Path

from vibrojax.cli.completion import files, with_completer
from vibrojax.cli.output import PICTURES, Options, output, picture_beside
from vibrojax.errors import InputError, shown
from vibrojax.progress import timed


def arguments(parser: ArgumentParser) -> None:
    """Add the command's arguments to `parser`."""
    file = parser.add_argument("file", metavar="OUT.nc", help="a dataset written by vibrojax")
    with_completer(file, files(".nc"))
    parser.add_argument("-o", dest="out", metavar="PICTURE.png", help="where to draw (OUT.png beside OUT.nc)")
    parser.add_argument(
        "--variable",
        metavar="NAME",
        action="extend",
        nargs="+",
        help="draw these variables, over all that varies; regime is one of them",
    )
    parser.add_argument(
        "--where",
        metavar="AXIS=VALUE",
        action="extend",
        nargs="+",
        help="draw only the lanes there, as in delta=0.005 start=stuck",
    )
    over = parser.add_argument(
        "--over",
        metavar="FAMILY.nc",
        action="extend",
        nargs="+",
        help="over the returns of a sweep: what vibrojax follow has found along its axis",
    )
    with_completer(over, files(".nc"))
    parser.add_argument("--colours", metavar="MAP", help="matplotlib's colour map for quantities")


def run(options: Options) -> None:
    """Run the command."""
    from vibrojax.io.dataset import open_dataset

    path, where = Path(options.file), _values(options.where or ())
    with timed("read"):
        dataset = open_dataset(path)
        over = [open_dataset(Path(name)) for name in options.over or ()] or None
    with dataset:
        picture = output(options.out, PICTURES) if options.out else picture_beside(path)
        from vibrojax.analyses.pictures import save_picture

        with timed("draw"):
            part = save_picture(dataset, picture, options.variable, where, options.colours, over)
    if not options.quiet:
        print(f"{picture}: {part}" if part else picture)


def _values(words: Sequence[str]) -> dict[str, float | str]:
    """What `words` like delta=0.005 say, by name."""
    found: dict[str, float | str] = {}
    for word in words:
        name, equals, value = word.partition("=")
        if not (name and equals and value):
            raise InputError(f"--where: {shown(word)} is no AXIS=VALUE; write delta=0.005")
        try:
            found[name.strip()] = float(value)
        except ValueError:
            found[name.strip()] = value.strip()
    return found
