"""The commands `plot`, `info` and `explore`, which show a dataset, and `scenes`."""

import os
import re
import sys
import webbrowser
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from vibrojax.cli.command import (
    JSON,
    Options,
    argument,
    command,
    flag,
    named_values,
    number_or_name,
)
from vibrojax.cli.output import PICTURES, print_json, shortened, view_path, write_view
from vibrojax.errors import InputError, Place, shown
from vibrojax.progress import timed
from vibrojax.threads import on_leaving

_SEVERAL: dict[str, Any] = {"action": "extend", "nargs": "+"}


@command(
    argument("file", "OUT.nc", "a dataset written by vibrojax"),
    argument(
        "-o",
        "PICTURE.png",
        "where to draw (OUT.png beside OUT.nc; with options OUT-VARIABLE.png, OUT-over-FAMILY.png, ...)",
        dest="out",
    ),
    argument("--variable", "NAME", "draw these variables, over all that varies; regime is one of them", **_SEVERAL),
    argument(
        "--where", "CONDITION", 'draw only the lanes there, as in delta=0.005 start=stuck "v (m/s) < 2"', **_SEVERAL
    ),
    argument(
        "--over",
        "FAMILY.nc",
        "over the returns of a sweep: what vibrojax follow has found along its axis; over a map: borders or curves",
        **_SEVERAL,
    ),
    argument(
        "--diagram",
        "NAME",
        "of a sweep: campbell (frequencies over the speed), rate-over-force (rate of penetration with its onset) or "
        "chart (the robust single impact over two parameters, with lines of energy, force and rate)",
    ),
    argument("--colours", "MAP", "matplotlib's colour map for quantities"),
    argument("--width", "WIDTH", "width of the picture, such as 85mm or 170mm for a column or a page of a journal"),
)
def plot(options: Options) -> None:
    """Draw the picture that suits what a dataset holds, or specified variables, at specified values of its axes."""
    from vibrojax.io.dataset import open_dataset
    from vibrojax.io.log_filters import read_conditions
    from vibrojax.settings.values import check_distinct

    where: dict[str, float | str] = {}
    for condition in read_conditions(options.where):
        if condition.name in where:
            raise InputError(f"--where: {condition.name}: {shown(condition.value)} is a second value; give one")
        is_value = condition.operator == "=" and condition.unit is None
        where[condition.name] = number_or_name(condition.value) if is_value else condition.text
    path = Path(options.file)
    check_distinct(Place("plot", "--over"), options.over or (), "file")
    with timed("read"):
        dataset = open_dataset(path)
        over = [open_dataset(Path(name)) for name in options.over or ()] or None
    with dataset:
        places = [re.sub("=|[ =<>!()]*[<>!][=<>!() ]*", "-", word) for word in options.where or ()]
        stems = [Path(name).stem for name in options.over or ()]
        parts = [*shortened(options.variable or ()), *filter(None, [options.diagram]), *shortened(places)]
        parts += [*filter(None, [options.colours, options.width]), *(["over", *shortened(stems)] if stems else [])]
        picture = view_path(options, path, PICTURES, parts)
        from vibrojax.studies.choose import save_picture

        asked = options.variable, where, options.colours, over, options.diagram, options.width
        drawn: list[str] = []
        with timed("draw"):
            picture, replaced = write_view(
                picture,
                lambda path: drawn.append(save_picture(dataset, path, *asked)),
                numbered=bool(parts) and not options.out,
            )
    if not options.quiet:
        notes = [*drawn, f"{replaced} picture" if replaced and not options.out else ""]
        print(": ".join(filter(None, (str(picture), "; ".join(filter(None, notes))))))


@command(
    argument("file", "OUT.nc", "a dataset written by vibrojax"),
    JSON,
)
def info(options: Options) -> None:
    """Show what a dataset holds: scene, grid, regimes, failures, accuracy, provenance."""
    from vibrojax.io.dataset import open_dataset
    from vibrojax.studies.summary import summarise, summary_facts, summary_lines

    with timed("read"):
        dataset = open_dataset(Path(options.file))
    if options.json:
        print_json(summary_facts(dataset, options.file))
    else:
        print("\n".join(summary_lines(summarise(dataset))))


@command(
    argument(
        "file",
        "OUT.nc",
        "a dataset of vibrojax: of a sweep, its orbits, attractors or borders, families, one motion, or a fit; "
        "with --live also a scene",
    ),
    argument(
        "values",
        "NAME=VALUE",
        "of a scene: where its motion begins, as for vibrojax simulate",
        nargs="*",
        default=[],  # without it, argparse before Python 3.13 requires the values
    ),
    argument(
        "-o", "PAGE.html", "where to write (OUT.html beside OUT.nc; with --over OUT-over-BORDERS.html)", dest="out"
    ),
    argument(
        "--over",
        "CURVES.nc",
        "lay over the map what vibrojax borders or curves has found in the same plane",
    ),
    flag(
        "--live", "open the page from a server on this machine alone, with sliders for every parameter; Ctrl-C ends it"
    ),
    flag("--no-browser", "with --live: print the address, and open no browser"),
)
def explore(options: Options) -> None:
    """Write an interactive HTML page: plots of the dataset and, for every cell, its machine in motion and numbers.

    It shows a map, a bifurcation diagram, families, attractors, a fit, or the plots of another analysis. Each plot
    can be zoomed and saved, and motions compared. With --live, nothing is written: a server on this machine serves the
    page, and computes what the user clicks or drags, and the part of a map that is zoomed into.
    """
    from vibrojax.io.dataset import open_dataset

    path, progress = Path(options.file), not options.quiet
    scene = options.live and not path.suffix
    if options.live and options.out:
        raise InputError("explore: -o: --live writes no page; leave one of them out")
    if options.no_browser and not options.live:
        raise InputError("explore: --no-browser: there is no browser to open without --live")
    if options.values and not scene:
        raise InputError(f"explore: {shown(options.values[0])}: values are for a scene, with --live; leave them out")
    if scene and options.over:
        raise InputError("explore: --over: a motion has no map to lay curves over; leave it out")
    parts = ["over", Path(options.over).stem] if options.over else []
    if not options.live:
        out = view_path(options, path, (".html",), parts)
    over = None
    if scene:
        from vibrojax.studies.trajectory import Trajectories, simulate

        settings, parameters = named_values(Place("explore"), options.values, Trajectories.words(), lists=False)
        arguments: dict[str, Any] = settings | parameters
        dataset = simulate(options.file, **arguments, progress=progress)
    else:
        with timed("read"):
            dataset = open_dataset(path)
            over = open_dataset(Path(options.over)) if options.over else None
    with dataset:
        try:
            if options.live:
                from vibrojax.explorer.live import serve

                live = serve(dataset, over, progress=progress)
            else:
                from vibrojax.explorer import write_page

                def write(page: Path) -> None:
                    write_page(dataset, page, over, progress=progress)

                with timed("compute and write"):
                    out, replaced = write_view(out, write, numbered=bool(parts) and not options.out)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    if options.live:
        _serve(options, live)
    elif progress:
        note = f"; {replaced} page" if replaced and not options.out else ""
        print(f"{out}: {out.stat().st_size / 1e6:.1f} MB{note}")


def _serve(options: Options, live: Any) -> None:
    private = TemporaryDirectory(prefix="vibrojax-")
    with live, on_leaving(lambda: live.close(1.0)), on_leaving(private.cleanup), private:
        words = [str(options.file), *options.values, *(["--over", str(options.over)] if options.over else [])]
        options.advise("the page is closed; to open it again", "explore", *words, "--live")
        if not options.quiet:
            print("Ctrl-C ends it", file=sys.stderr, flush=True)
        # Who reads the address may end the command at once; then nothing else is being written.
        print(live.url, flush=True)
        # Without a display, some browsers open in the terminal.
        has_display = (
            sys.platform in ("darwin", "win32") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        )
        if not options.no_browser and has_display:
            # All users of a computer see the arguments of a browser, so the address is in a file of this user.
            redirect = Path(private.name) / "page.html"
            redirect.touch(0o600)
            redirect.write_text(f'<meta http-equiv="refresh" content="0; url={live.url}"><a href="{live.url}">page</a>')
            webbrowser.open(redirect.as_uri())
        live.wait()


@command(argument("scene", "SCENE", "one of them, in full", nargs="?"))
def scenes(options: Options) -> None:
    """List the scenes, or a scene's parameters, initial conditions, friction laws, variables and settings."""
    from vibrojax.studies.catalogue import scene_rows, scene_text

    if options.scene is not None:
        print(scene_text(options.scene))
        return
    for name, row in scene_rows().items():
        print(f"{name:<18}{row['what']}")
        print(f"{'':<18}starts: {row['starts'] or 'always the same'}")
