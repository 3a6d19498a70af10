"""Draw the picture that suits what a dataset holds, or specified variables, at specified values of its axes."""

from argparse import ArgumentParser
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from vibrojax.cli.completion import add_argument, files
from vibrojax.cli.output import PICTURES, Options, output, picture_beside
from vibrojax.errors import InputError, shown
from vibrojax.progress import timed


def arguments(parser: ArgumentParser) -> None:
    several: dict[str, Any] = {"action": "extend", "nargs": "+"}
    add_argument(parser, "file", completer=files(".nc"), metavar="OUT.nc", help="a dataset written by vibrojax")
    parser.add_argument("-o", dest="out", metavar="PICTURE.png", help="where to draw (OUT.png beside OUT.nc)")
    about = "draw these variables, over all that varies; regime is one of them"
    parser.add_argument("--variable", metavar="NAME", help=about, **several)
    about = "draw only the lanes there, as in delta=0.005 start=stuck"
    parser.add_argument("--where", metavar="AXIS=VALUE", help=about, **several)
    about = "over the returns of a sweep: what vibrojax follow has found along its axis"
    add_argument(parser, "--over", completer=files(".nc"), metavar="FAMILY.nc", help=about, **several)
    parser.add_argument("--colours", metavar="MAP", help="matplotlib's colour map for quantities")


def run(options: Options) -> None:
    from vibrojax.io.dataset import open_dataset

    path, where = Path(options.file), _axis_values(options.where or ())
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


def _axis_values(words: Sequence[str]) -> dict[str, float | str]:
    """Return the values of words such as delta=0.005, keyed by name."""
    values: dict[str, float | str] = {}
    for word in words:
        name, equals, value = word.partition("=")
        if not (name and equals and value):
            raise InputError(f"--where: {shown(word)} is not AXIS=VALUE; write delta=0.005")
        try:
            values[name.strip()] = float(value)
        except ValueError:
            values[name.strip()] = value.strip()
    return values
