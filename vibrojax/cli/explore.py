"""Write an interactive HTML page: a map and, for every cell, its orbit, history, spectrum and numbers.

With --live, nothing is written: a server on this machine serves the page, and computes what the user clicks or drags.
"""

import os
import sys
import webbrowser
from argparse import ArgumentParser
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vibrojax.cli.completion import add_argument, files, values_with
from vibrojax.cli.output import Options, output
from vibrojax.cli.simulate import SETTINGS, method_choices
from vibrojax.cli.values import named_values
from vibrojax.errors import InputError, Place, shown
from vibrojax.progress import timed

if TYPE_CHECKING:
    import xarray


def arguments(parser: ArgumentParser) -> None:
    about = "a dataset of vibrojax: of a sweep, its orbits, attractors or borders, families, one motion, or a fit; "
    about += "with --live also a scene"
    add_argument(parser, "file", completer=files(".nc"), metavar="OUT.nc", help=about)
    about = "of a scene: where its motion begins, as for vibrojax simulate"
    completer = values_with(SETTINGS, method_choices)
    add_argument(parser, "values", completer=completer, metavar="NAME=VALUE", nargs="*", help=about)
    parser.add_argument("-o", dest="out", metavar="PAGE.html", help="where to write (OUT.html beside OUT.nc)")
    about = "lay over the map what vibrojax borders has found in the same plane"
    add_argument(parser, "--over", completer=files(".nc"), metavar="BORDERS.nc", help=about)
    about = "open the page from a server on this machine alone, with sliders for every parameter; Ctrl-C ends it"
    parser.add_argument("--live", action="store_true", help=about)
    parser.add_argument("--no-browser", action="store_true", help="with --live: print the address, and open no browser")


def run(options: Options) -> None:
    from vibrojax.io.dataset import open_dataset

    path = Path(options.file)
    _check_combination(options)
    if not options.live:
        out = output(options.out, (".html",)) if options.out else path.with_suffix(".html")
    elif not path.suffix:
        _serve(options, _motion(options), None)
        return
    with timed("read"):
        dataset = open_dataset(path)
        over = open_dataset(Path(options.over)) if options.over else None
    if options.live:
        _serve(options, dataset, over)
        return
    from vibrojax.explorer import write_page

    with dataset, timed("compute and write"):
        try:
            write_page(dataset, out, over, progress=not options.quiet)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    if not options.quiet:
        print(f"{out}: {out.stat().st_size / 1e6:.1f} MB")


def _check_combination(options: Options) -> None:
    """Raise `InputError` if options exclude each other."""
    if options.live and options.out:
        raise InputError("explore: -o: --live writes no page; leave one of them out")
    if options.no_browser and not options.live:
        raise InputError("explore: --no-browser: there is no browser to open without --live")
    scene = options.live and not Path(options.file).suffix
    if options.values and not scene:
        raise InputError(f"explore: {shown(options.values[0])}: values are for a scene, with --live; leave them out")
    if scene and options.over:
        raise InputError("explore: --over: a motion has no map to lay borders over; leave it out")


def _motion(options: Options) -> "xarray.Dataset":
    """Return the motion of a scene that the page shows first."""
    from vibrojax.sweep.simulation import simulate

    settings, parameters = named_values(Place("explore"), options.values, SETTINGS, lists=False)
    arguments: dict[str, Any] = settings | parameters
    return simulate(options.file, **arguments, progress=not options.quiet)


def _serve(options: Options, dataset: "xarray.Dataset", over: "xarray.Dataset | None") -> None:
    """Serve the live page until the process is interrupted."""
    from vibrojax.analyses.sweep.workers.lifetime import on_leaving
    from vibrojax.explorer.live import serve

    with dataset:
        try:
            live = serve(dataset, over, progress=not options.quiet)
        except InputError as error:
            raise InputError(f"{options.file}: {error}") from None
    with live, on_leaving(lambda: live.close(1.0)):
        words = [str(options.file), *options.values, *(["--over", str(options.over)] if options.over else [])]
        options.advise("the page is closed; to open it again", "explore", *words, "--live")
        print(live.url, flush=True)
        if not options.quiet:
            print("Ctrl-C ends it", file=sys.stderr, flush=True)
        # Without a display, some browsers open in the terminal.
        has_display = (
            sys.platform in ("darwin", "win32") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        )
        if not options.no_browser and has_display:
            webbrowser.open(live.url)
        live.wait()
