"""Find the smallest push in each state variable after which a machine no longer returns to its working cycle."""

from argparse import ArgumentParser

from vibrojax.cli.output import Options, add_output, result_at, write_result
from vibrojax.cli.values import add_values, named_values, whole
from vibrojax.errors import Place

SETTINGS = ("start", "scan", "precision", "settle", "observe", "most_x1", "most_v1", "most_x2", "most_v2")
"""Arguments of `smallest_push` that are not parameters of a scene."""

_MOST = "most_"


def arguments(parser: ArgumentParser) -> None:
    about = (
        "parameters, and friction; a list, beta=0.3,0.4,0.5, is as many machines, pushed together. start (a name, "
        "or [x1,x1',x2,x2']: of the motion whose cycle is pushed), most_x1, most_v1, most_x2, most_v2 (the greatest "
        "push, m or m/s; by default the whole swing), scan (pushes of each scan in a direction: 256), precision "
        "(0.001), settle and observe (s, for which motions settle and are then watched: 40, 8)"
    )
    add_values(parser, SETTINGS, about, scene="rotary, vibro-impact or drilling")
    add_output(parser, "SCENE-push.nc")


def run(options: Options) -> None:
    settings, parameters = named_values(Place("push"), options.values, SETTINGS, lists=True)
    from vibrojax.analyses.push.spec import PRECISION, SCAN, push_spec

    bounds = {name.removeprefix(_MOST): value for name, value in settings.items() if name.startswith(_MOST)}
    request = push_spec(
        options.scene,
        start=settings.get("start"),
        most=bounds or None,
        scan=whole(settings.get("scan", SCAN)),
        precision=settings.get("precision", PRECISION),
        settle=settings.get("settle", 40.0),
        observe=settings.get("observe", 8.0),
        parameters=parameters,
    )
    result = result_at(options, f"{request.sweep.scene}-push.nc", request.identity())
    from vibrojax.analyses.push.analysis import push_lines
    from vibrojax.analyses.push.run import find_pushes

    dataset = find_pushes(request, progress=not options.quiet)
    drawn = write_result(options, dataset, result)
    if not options.quiet:
        print("\n".join([*push_lines(dataset), f"{result.out}{drawn}"]))
