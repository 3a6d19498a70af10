"""Simulate one point: write its trajectory as a dataset, and a picture."""

import warnings
from argparse import ArgumentParser
from typing import TYPE_CHECKING, Any

from vibrojax.cli.output import Options, add_json, add_output, file_facts, print_json, result_at, write_result
from vibrojax.cli.values import add_values, named_values
from vibrojax.errors import Place, shown

if TYPE_CHECKING:
    from vibrojax.sweep.input.names import Names

_UNITS = {"duration": "s", "error": "1", "sampling": "s", "step": "s", "smoothing": "m s-1"}
"""Settings that are positive numbers, with their units."""

SETTINGS = ("start", "method", "solver", *_UNITS)
"""Arguments of `simulate` that are not parameters of a scene."""


def method_choices(_: "Names") -> dict[str, tuple[str, ...]]:
    """Return the values of the settings that have a fixed set."""
    from vibrojax.stepping import STEPPERS

    return {"method": tuple(STEPPERS)}


def arguments(parser: ArgumentParser) -> None:
    about = "a parameter; friction; start (a name, or [x1,x1',x2,x2']); duration, sampling, error, method, solver, "
    add_values(parser, SETTINGS, about + "step, smoothing", method_choices)
    add_output(parser, "SCENE.nc")
    add_json(parser)


def run(options: Options) -> None:
    place = Place("simulate")
    settings, parameters = named_values(place, options.values, SETTINGS, lists=False)
    from vibrojax.sweep.input.read import read_point
    from vibrojax.sweep.input.values import UnusualValue

    point = read_point(place, options.scene, parameters, settings.pop("start", None))
    # Each value is checked at run time; its static type does not state that it fits the function's argument.
    arguments: dict[str, Any] = _checked(place, settings) | point.options | point.parameters
    if point.start is not None:
        arguments["start"] = point.start
    result = result_at(options, f"{point.scene}.nc", {"scene": point.scene, **arguments})

    from vibrojax.analyses.trajectory.analysis import feature_lines, features
    from vibrojax.io.attributes import attribute_of
    from vibrojax.sweep.simulation import simulate

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnusualValue)  # `read_point` has already warned
        dataset = simulate(point.scene, **arguments, progress=not options.quiet)
    drawn = write_result(options, dataset, result)
    if options.json:
        facts: dict[str, object] = {
            "scene": point.scene,
            **point.options,
            "start": point.start,
            "parameters": point.parameters,
            "duration": float(dataset["time"][-1]),
            "run": attribute_of(dataset, "run"),
            "found": features(dataset),
            "solver": attribute_of(dataset, "solver"),
        }
        print_json(facts | file_facts(result, drawn))
    elif not options.quiet:
        print("\n".join([*feature_lines(dataset), f"{result.out}{drawn}"]))


def _checked(place: Place, settings: dict[str, object]) -> dict[str, object]:
    """Return the settings after checking them; `simulate` itself checks the names of methods and solvers."""
    from vibrojax.models.physics.parameters import positive
    from vibrojax.sweep.input.values import quantity

    checked = dict(settings)
    for name, value in settings.items():
        if name in _UNITS:
            checked[name] = quantity(place.at(name), value, positive(name, 1.0, _UNITS[name], name, name))
        elif not isinstance(value, str) or not value:
            raise place.at(name).error(f"{shown(value)} is not a name; give one, like {name}=...")
    return checked
