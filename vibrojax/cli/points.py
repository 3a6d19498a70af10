"""The commands `scenes`, `simulate`, `follow`, `push` and `tolerance`, which take a scene and NAME=VALUE."""

import re
from typing import TYPE_CHECKING, Any

from vibrojax.cli.command import (
    JSON,
    Options,
    argument,
    command,
    explained,
    named_values,
    output_options,
    point_arguments,
    whole,
)
from vibrojax.cli.output import answer
from vibrojax.errors import Place, shown
from vibrojax.studies import FAMILY_WORDS

if TYPE_CHECKING:
    import xarray

_UNITS = {"duration": "s", "error": "1", "sampling": "s", "step": "s", "smoothing": "m s-1"}
"""Settings of `simulate` that are positive numbers, with their units."""

SIMULATE_SETTINGS = ("start", "method", "solver", *_UNITS)
"""Arguments of `simulate` that are not parameters of a scene."""

_REQUIRED = ("along", "at", "from", "to")

FOLLOW_SETTINGS = (*_REQUIRED, "start", "settle", "observe", "cycles")
"""Arguments of `follow` that are not parameters of a scene."""

_FOLLOW_SYNTAX = "along=NAME at=VALUE from=A to=B"

_MOST = "most_"

PUSH_SETTINGS = ("start", "scan", "precision", "settle", "observe", "most_x1", "most_v1", "most_x2", "most_v2")
"""Arguments of `smallest_push` that are not parameters of a scene."""


TOLERANCE_SETTINGS = ("start", "settle", "observe", "error")
"""Arguments of `tolerance` that are not parameters of a scene."""

_HALF_WIDTH = re.compile(r"\+-|±|\+/-")


@command(argument("scene", "SCENE", "one of them, in full", nargs="?"))
def scenes(options: Options) -> None:
    """List the scenes, or a scene's parameters, initial conditions, friction laws, variables and settings."""
    from vibrojax.studies.catalogue import list_scenes, scene_text

    if options.scene is not None:
        print(scene_text(options.scene))
        return
    for name, row in list_scenes().iterrows():
        print(f"{name:<18}{row['what']}")
        print(f"{'':<18}starts: {row['starts'] or 'always the same'}")


@command(
    point_arguments(
        "a parameter; friction; start (a name, or [x1,x1',x2,x2']); duration, sampling, error, method, solver, step, "
        "smoothing",
    ),
    output_options("SCENE.nc, SCENE-2.nc, ..."),
    JSON,
)
def simulate(options: Options) -> None:
    """Simulate one point: write its trajectory as a dataset, and a picture."""
    place = Place("simulate")
    settings, parameters = named_values(place, options.values, SIMULATE_SETTINGS, lists=False)
    from vibrojax.maps.read import read_point
    from vibrojax.physics.parameters import positive
    from vibrojax.scenes import HasRock
    from vibrojax.settings.code_identity import code_identity
    from vibrojax.settings.values import quantity

    point = read_point(place, options.scene, parameters, settings.pop("start", None))
    for name, value in settings.items():
        if name in _UNITS:
            settings[name] = quantity(place.at(name), value, positive(name, 1.0, _UNITS[name], name, name))
        elif not isinstance(value, str) or not value:  # `simulate` itself checks the names of methods and solvers
            raise place.at(name).error(f"{shown(value)} is not a name; give one, like {name}=...")
    # Each value is checked at run time; its static type does not state that it fits the function's argument.
    arguments: dict[str, Any] = settings

    def compute() -> "xarray.Dataset":
        from vibrojax.studies.trajectory_run import simulate_point

        return simulate_point(point, **arguments, progress=not options.quiet)

    def facts(dataset: "xarray.Dataset") -> dict[str, object]:
        from vibrojax.io.attributes import attribute_of
        from vibrojax.studies.frequencies import frequency_part
        from vibrojax.studies.trajectory_analysis import features

        return {
            "scene": point.scene,
            **point.options,
            "start": point.start,
            "parameters": point.parameters,
            **({"bit_radius": point.hole_radius} if isinstance(point.system, HasRock) else {}),
            "duration": float(dataset["time"][-1]),
            "run": attribute_of(dataset, "run"),
            "found": features(dataset),
            **frequency_part(dataset).facts,
            "solver": attribute_of(dataset, "solver"),
        }

    identity = {**point.identity(), **arguments, **code_identity(point.system, point.options)}
    answer(options, f"{point.scene}.nc", identity, compute, facts, numbered=True)


@command(
    explained(*FAMILY_WORDS),
    point_arguments(
        f"{_FOLLOW_SYNTAX}: the parameter, where the family begins, and its bounds; start (a name, or [x1,x1',x2,x2'])"
        ", settle and observe (s, for which the motion at VALUE settles and is then watched: 40, 8) and cycles (the "
        "most returns of doubled branches: 8); parameters, and friction. A list, beta=0.3,0.4,0.5, is as many "
        "families, followed together; of several lists the first values belong to one family, the second ones to the "
        "next",
    ),
    output_options("SCENE-NAME.nc"),
    JSON,
)
def follow(options: Options) -> None:
    """Follow a family of periodic orbits, stable and unstable, along one parameter, with its special points."""
    place = Place("follow")
    settings, parameters = named_values(place, options.values, FOLLOW_SETTINGS, lists=True)
    missing = [name for name in _REQUIRED if name not in settings]
    if missing:
        raise place.error(f"{' and '.join(missing)} missing; write vibrojax follow SCENE {_FOLLOW_SYNTAX}")
    from vibrojax.measures.ledger import MOST_CYCLES
    from vibrojax.studies.family_run import continue_families, family_spec

    defaults = {"start": None, "settle": None, "observe": None, "cycles": MOST_CYCLES}
    arguments: dict[str, Any] = defaults | settings
    arguments |= {"span": (arguments.pop("from"), arguments.pop("to")), "cycles": whole(arguments["cycles"])}
    request = family_spec(options.scene, parameters=parameters, **arguments)

    def compute() -> "xarray.Dataset":
        return continue_families(request, progress=not options.quiet)

    def facts(dataset: "xarray.Dataset") -> dict[str, object]:
        from vibrojax.io.attributes import attribute_of
        from vibrojax.studies.family_analysis import family_facts

        machine = {"scene": dataset.attrs["scene"], "start": dataset.attrs.get("start")}
        return {**machine, "parameters": attribute_of(dataset, "parameters"), **family_facts(dataset)}

    answer(options, f"{request.sweep.scene}-{request.along}.nc", request.identity(), compute, facts)


@command(
    point_arguments(
        "parameters, and friction; a list, beta=0.3,0.4,0.5, is as many machines, pushed together. start (a name, "
        "or [x1,x1',x2,x2']: of the motion whose cycle is pushed), most_x1, most_v1, most_x2, most_v2 (the greatest "
        "push, m or m/s; by default the whole swing), scan (pushes of each scan in a direction: 256), precision "
        "(0.001), settle and observe (s, for which motions settle and are then watched: 40, 8)",
        scenes="rotary, vibro-impact or drilling",
    ),
    output_options("SCENE-push.nc, SCENE-push-2.nc, ..."),
)
def push(options: Options) -> None:
    """Find the smallest push in each state variable after which a machine no longer returns to its working cycle."""
    settings, parameters = named_values(Place("push"), options.values, PUSH_SETTINGS, lists=True)
    from vibrojax.studies.push_spec import PRECISION, SCAN, push_spec

    defaults = {"start": None, "scan": SCAN, "precision": PRECISION, "settle": None, "observe": None}
    arguments: dict[str, Any] = defaults | settings
    most = {name.removeprefix(_MOST): arguments.pop(name) for name in settings if name.startswith(_MOST)}
    arguments |= {"scan": whole(arguments["scan"]), "most": most or None}
    request = push_spec(options.scene, parameters=parameters, **arguments)

    def compute() -> "xarray.Dataset":
        from vibrojax.studies.push_run import find_pushes

        return find_pushes(request, progress=not options.quiet)

    answer(options, f"{request.sweep.scene}-push.nc", request.identity(), compute, numbered=True)


@command(
    point_arguments(
        "parameters; those with a tolerance as NAME=VALUE+-HALF_WIDTH, like delta=-0.002+-0.001 or gamma=0.64+-1%% "
        "(± is accepted). start (a name, or [x1,x1',x2,x2']; by default drive and stuck, where the scene has them), "
        "settle and observe (s: 40, 8), error (1e-4)",
    ),
    output_options("SCENE-tolerance.nc"),
    JSON,
)
def tolerance(options: Options) -> None:
    """Simulate a machine at samples of the box of its tolerances: regimes, worst sample, and where it occurs."""
    place = Place("tolerance")
    pairs: dict[str, tuple[float, float]] = {}
    for name, pair in (_pair(place, word) for word in options.values if _HALF_WIDTH.search(word)):
        if name in pairs:
            raise place.at(name).error("has a second value; give one")
        pairs[name] = pair
    words = [word for word in options.values if not _HALF_WIDTH.search(word)]
    settings, parameters = named_values(place, words, TOLERANCE_SETTINGS, lists=False)
    for name in pairs:
        if name in parameters or name in settings:
            raise place.at(name).error("has a second value; give one")
    from vibrojax.studies.tolerance_run import read_box, simulate_box

    box = read_box(options.scene, settings.pop("start", None), settings, parameters | pairs)

    def compute() -> "xarray.Dataset":
        return simulate_box(box, progress=not options.quiet)

    answer(options, f"{box.sweep.scene}-tolerance.nc", box.identity(), compute)


def _pair(place: Place, word: str) -> tuple[str, tuple[float, float]]:
    """Return the name, the nominal value and the half-width in NAME=VALUE+-HALF_WIDTH, which may end in %."""
    name, _, text = (part.strip() for part in word.partition("="))
    value, *widths = (part.strip() for part in _HALF_WIDTH.split(text, maxsplit=1))
    width = "".join(widths)
    try:
        nominal = float(value)
        return name, (nominal, abs(nominal) * float(width[:-1]) / 100 if width.endswith("%") else float(width))
    except ValueError:
        expected = "write NAME=VALUE+-HALF_WIDTH, like delta=0.005+-0.001 or gamma=0.64+-1%"
        raise place.error(f"{shown(word)} is not a tolerance; {expected}") from None
