"""The commands `plot`, `info` and `explore`, which show a dataset, and `scenes`."""

import os
import re
import sys
import webbrowser
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from vibrojax.cli.arguments import JSON, MANY, Options, argument, command, flag, named_values, number_or_name, words
from vibrojax.cli.output import PICTURES, print_json, shortened, view_file, write_view
from vibrojax.errors import InputError, Place, shown
from vibrojax.progress import timed
from vibrojax.threads import on_leaving


@command(
    argument("file", "OUT.nc", "a dataset written by vibrojax"),
    argument(
        "-o",
        "PICTURE.png",
        "picture file (default: OUT.png beside OUT.nc; with options OUT-VARIABLE.png, OUT-over-FAMILY.png, ...)",
        dest="out",
    ),
    argument("--variable", "NAME", "variables to draw over all varied axes; regime is one of them", **MANY),
    argument(
        "--where",
        "CONDITION",
        'draw only lanes that meet these conditions: delta=0.005 start=stuck "v (m/s) < 2"',
        **MANY,
    ),
    argument(
        "--over",
        "FAMILY.nc",
        "result to draw on top: of vibrojax follow, over the returns of a sweep along the same parameter; of borders "
        "or curves, over a map",
        **MANY,
    ),
    argument(
        "--diagram",
        "NAME",
        "diagram of a sweep: campbell (frequencies over the speed), rate-over-force (rate of penetration with its "
        "onset) or chart (where the single impact is robust, with maps of energy, force, rate and blows)",
    ),
    argument("--colours", "MAP", "name of a matplotlib colour map for quantities"),
    argument("--width", "WIDTH", "width of the picture, such as 85mm or 170mm for a column or a page of a journal"),
)
def plot(options: Options) -> None:
    """Draw the picture that fits a dataset, or specified variables at specified values of its axes."""
    from vibrojax.io.dataset import open_dataset
    from vibrojax.io.riglog import read_conditions
    from vibrojax.settings.values import check_distinct
    from vibrojax.studies.choose import save_picture

    where: dict[str, float | str] = {}
    for condition in read_conditions(options.where):
        if condition.name in where:
            raise InputError(f"--where: {condition.name}: {shown(condition.value)} is a second value; give one")
        is_value = condition.operator == "=" and condition.unit is None
        where[condition.name] = number_or_name(condition.value) if is_value else condition.text
    path, above = Path(options.file), [Path(name) for name in options.over or ()]
    check_distinct(Place("plot", "--over"), options.over or (), "file")
    with timed("read"):
        dataset = open_dataset(path)
        over = [open_dataset(name) for name in above] or None
    with dataset:
        places = [re.sub("=|[ =<>!()]*[<>!][=<>!() ]*", "-", word) for word in options.where or ()]
        parts = [*shortened(options.variable or ()), *filter(None, [options.diagram]), *shortened(places)]
        parts += filter(None, [options.colours, options.width])
        parts += ["over", *shortened([name.stem for name in above])] if above else []
        view = view_file(options, path, PICTURES, parts)
        choices = options.variable, where, options.colours, over, options.diagram, options.width
        notes: list[str] = []
        with timed("draw"):
            picture, replaces = write_view(*view, lambda path: notes.append(save_picture(dataset, path, *choices)))
    notes += ["replaces another picture"] if replaces and not options.out else []
    if not options.quiet:
        print(": ".join(filter(None, (str(picture), "; ".join(filter(None, notes))))))


@command(argument("file", "OUT.nc", "a dataset written by vibrojax"), JSON)
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
    words("for a scene: parameters and other values as for vibrojax simulate"),
    argument(
        "-o", "PAGE.html", "page file (default: OUT.html beside OUT.nc; with --over OUT-over-BORDERS.html)", dest="out"
    ),
    argument("--over", "CURVES.nc", "result of vibrojax borders or curves, to draw over the map of the same plane"),
    flag("--live", "serve the page to this machine only, with a slider for every parameter; Ctrl-C stops the server"),
    flag("--no-browser", "with --live: print the address and do not open a browser"),
)
def explore(options: Options) -> None:
    """Write an interactive HTML page: plots of a dataset and, for each cell, its values and the machine in motion.

    It shows a map, a bifurcation diagram, families, attractors, a fit, or the plots of another analysis. Each plot
    can be zoomed and saved, and motions compared. With --live, nothing is written: a server on this machine serves the
    page, and computes what the user clicks or drags, and the part of a map that is zoomed into.
    """
    path, is_scene = Path(options.file), options.live and not Path(options.file).suffix
    if options.live and options.out:
        raise InputError("explore: -o: --live writes no page; leave one of them out")
    if options.no_browser and not options.live:
        raise InputError("explore: --no-browser: there is no browser to open without --live")
    if options.values and not is_scene:
        raise InputError(f"explore: {shown(options.values[0])}: values are for a scene, with --live; leave them out")
    if is_scene and options.over:
        raise InputError("explore: --over: a motion has no map to lay curves over; leave it out")
    parts = ["over", Path(options.over).stem] if options.over else []
    view = None if options.live else view_file(options, path, (".html",), parts)
    from vibrojax.explorer.live import serve
    from vibrojax.explorer.write import write_page
    from vibrojax.io.dataset import open_dataset
    from vibrojax.studies.trajectory import Trajectories, simulate

    progress, over = not options.quiet, None
    if is_scene:
        settings, parameters = named_values(Place("explore"), options.values, Trajectories.words())
        arguments: dict[str, Any] = settings | parameters
        dataset = simulate(options.file, **arguments, progress=progress)
    else:
        with timed("read"):
            dataset = open_dataset(path)
            over = open_dataset(Path(options.over)) if options.over else None
    with dataset:
        try:
            if view is None:
                live = serve(dataset, over, progress=progress)
            else:
                with timed("compute and write"):
                    out, replaces = write_view(*view, lambda page: write_page(dataset, page, over, progress=progress))
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    if view is None:
        _serve(options, live)
    elif progress:
        note = "; replaces another page" if replaces and not options.out else ""
        print(f"{out}: {out.stat().st_size / 1e6:.1f} MB{note}")


def _serve(options: Options, live: Any) -> None:
    """Print the address of a live page, open it in a browser, and serve it until the user ends it."""
    private = TemporaryDirectory(prefix="vibrojax-")
    with live, on_leaving(lambda: live.close(1.0)), on_leaving(private.cleanup), private:
        given = [str(options.file), *options.values, *(["--over", str(options.over)] if options.over else [])]
        options.advise("the page is closed; to open it again", "explore", *given, "--live")
        if not options.quiet:
            print("Ctrl-C ends it", file=sys.stderr, flush=True)
        # Who reads the address may end the command at once; then nothing else is being written.
        print(live.url, flush=True)
        # Without a display, some browsers open in the terminal.
        has_display = sys.platform == "darwin" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        if not options.no_browser and has_display:
            # All users of a computer see the arguments of a browser, so the address is in a file of this user.
            redirect = Path(private.name) / "page.html"
            redirect.touch(0o600)
            redirect.write_text(f'<meta http-equiv="refresh" content="0; url={live.url}"><a href="{live.url}">page</a>')
            webbrowser.open(redirect.as_uri())
        live.wait()


@command(argument("scene", "SCENE", "name of the scene to describe in full", nargs="?"))
def scenes(options: Options) -> None:
    """List the scenes, or a scene's parameters, initial conditions, friction laws, variables and settings."""
    from vibrojax.studies.catalogue import scene_rows, scene_text

    if options.scene is not None:
        print(scene_text(options.scene))
        return
    for name, row in scene_rows().items():
        print(f"{name:<18}{row['what']}")
        print(f"{'':<18}starts: {row['starts'] or 'always the same'}")
