"""Simulate one point: its trajectory as a dataset, and a picture beside it."""

import warnings
from argparse import ArgumentParser
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vibrojax.cli._command import Options
from vibrojax.cli._complete import scenes, values_with, with_completer
from vibrojax.cli._facts import found
from vibrojax.cli._found import found_lines
from vibrojax.cli._json import HELP, print_json
from vibrojax.cli._named_values import named_values
from vibrojax.cli._output import result_at, result_written
from vibrojax.errors import Place, shown

if TYPE_CHECKING:
    import xarray

    from vibrojax.sweep.input.names import Names
    from vibrojax.sweep.input.point import Point

# Settings of the run, which are no parameters of a scene.
_TEXTS = ("method", "solver")
_NUMBERS = ("duration", "error", "sampling", "step", "smoothing")
SETTINGS = ("start", *_TEXTS, *_NUMBERS)


def of_settings(_: "Names") -> dict[str, tuple[str, ...]]:
    """The names that may stand behind those of settings."""
    from vibrojax.stepping import STEPPERS

    return {"method": tuple(STEPPERS)}


def arguments(parser: ArgumentParser) -> None:
    """Add the command's arguments to `parser`."""
    scene = parser.add_argument(
        "scene", metavar="SCENE", help="rotary, vibro-impact, penetration, drilling or coupled-drilling"
    )
    with_completer(scene, scenes)
    values = parser.add_argument(
        "values",
        metavar="NAME=VALUE",
        nargs="*",
        default=[],  # else argparse calls them required before Python 3.13
        help="a parameter; friction; start (a name, or [x1,x1',x2,x2']); duration, sampling, error, method, solver, "
        "step, smoothing",
    )
    with_completer(values, values_with(SETTINGS, of_settings))
    parser.add_argument("-o", dest="out", metavar="OUT.nc", help="where to write (SCENE.nc in this folder)")
    parser.add_argument("--fresh", action="store_true", help="replace OUT, whatever it holds")
    parser.add_argument("--json", action="store_true", help=HELP)


def run(options: Options) -> None:
    """Run the command."""
    place = Place("simulate")
    settings, parameters = named_values(place, options.values, SETTINGS, lists=False)
    from vibrojax.sweep.input.plausible import UnusualValue
    from vibrojax.sweep.input.point import read_point

    point = read_point(place, options.scene, parameters, settings.pop("start", None))
    # Names and values are checked, each against what it is; that it fits the function's argument no type can say.
    arguments: dict[str, Any] = _checked(place, settings) | point.options | point.parameters
    if point.start is not None:
        arguments["start"] = point.start
    result = result_at(options, f"{point.scene}.nc", {"scene": point.scene, **arguments})

    from vibrojax.sweep.simulation import simulate

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnusualValue)  # said above
        dataset = simulate(point.scene, **arguments, progress=not options.quiet)
    drawn = result_written(options, dataset, result)
    if options.json:
        print_json(_facts(dataset, point, result.out, result.picture if drawn else None))
    elif not options.quiet:
        print("\n".join([*found_lines(dataset), f"{result.out}{drawn}"]))


def _facts(dataset: "xarray.Dataset", point: "Point", out: Path, picture: Path | None) -> dict[str, object]:
    """What `--json` prints; `found` has the names of a sweep's variables, `run` says over which time they hold."""
    from vibrojax.io.attributes import attribute_of

    return {
        "scene": point.scene,
        **point.options,
        "start": point.start,
        "parameters": point.parameters,
        "duration": float(dataset["time"][-1]),
        "run": attribute_of(dataset, "run"),
        "found": found(dataset),
        "solver": attribute_of(dataset, "solver"),
        "dataset": str(out),
        "picture": None if picture is None else str(picture),
    }


def _checked(place: Place, settings: dict[str, object]) -> dict[str, object]:
    """The settings but for start; which methods and solvers there are, the simulation knows."""
    from vibrojax.models.physics.parameters import positive
    from vibrojax.sweep.input.values import quantity

    checked = dict(settings)
    for name, value in settings.items():
        if name in _NUMBERS:
            units = {"smoothing": "m s-1", "error": "1"}
            checked[name] = quantity(place.at(name), value, positive(name, 1.0, units.get(name, "s"), name, name))
        elif not isinstance(value, str) or not value:
            raise place.at(name).error(f"{shown(value)} is not a name; give one, like {name}=...")
    return checked
