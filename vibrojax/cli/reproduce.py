"""Put every table and figure of the source that the model can answer beside its number: a page and a table.

Nothing is kept of an interrupted run.
"""

import shlex
from argparse import ArgumentParser
from pathlib import Path

from vibrojax.cli._command import Options
from vibrojax.cli._output import output
from vibrojax.errors import InputError, shown


def arguments(parser: ArgumentParser) -> None:
    """Add the command's arguments to `parser`."""
    parser.add_argument("-o", dest="out", metavar="DIR", default="reproduction", help="the folder (reproduction)")
    parser.add_argument("--quick", action="store_true", help="only what half a minute answers, to see that it works")


def run(options: Options) -> None:
    """Run the command."""
    folder = _folder(Path(options.out))
    command = shlex.join(["vibrojax", "reproduce", "-o", options.out, *["--quick"] * options.quick])
    options.how_to_resume = f"nothing is kept; to start again: {command}"
    from vibrojax.reproduce import run_reproduction, write_reproduction

    reproduction = run_reproduction(quick=options.quick, progress=not options.quiet)
    write_reproduction(reproduction, folder)
    if not options.quiet:
        score = ", ".join(f"{count} {verdict}" for verdict, count in reversed(reproduction.score.items()))
        print(f"{folder / 'index.html'}: {len(reproduction.results)} results: {score}; table {folder / 'table.md'}")


def _folder(folder: Path) -> Path:
    """The folder to write to, made if it is not there.

    **Raises:** `InputError` where the page cannot be written in it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"-o: {shown(str(folder))} cannot be made a folder ({error.strerror})") from None
    output(folder / "index.html", (".html",))
    output(folder / "table.md", (".md",))
    return folder
