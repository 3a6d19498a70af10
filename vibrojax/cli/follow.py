"""Follow a family of periodic orbits, stable and unstable, along one parameter, with its special points."""

from argparse import ArgumentParser, RawDescriptionHelpFormatter

from vibrojax.analyses.glossary import FAMILY_WORDS, glossary
from vibrojax.cli.output import Options, add_json, add_output, file_facts, print_json, result_at, write_result
from vibrojax.cli.values import add_values, named_values, whole
from vibrojax.errors import Place

REQUIRED = ("along", "at", "from", "to")
"""Settings without a default value."""

SETTINGS = (*REQUIRED, "start", "settle", "observe", "cycles")
"""Arguments of `follow` that are not parameters of a scene."""

_SYNTAX = "along=NAME at=VALUE from=A to=B"


def arguments(parser: ArgumentParser) -> None:
    parser.formatter_class = RawDescriptionHelpFormatter
    parser.epilog = f"words used in the output:\n{glossary(*FAMILY_WORDS)}"
    about = (
        f"{_SYNTAX}: the parameter, where the family begins, and its bounds; start (a name, or [x1,x1',x2,x2']), "
        "settle and observe (s, for which the motion at VALUE settles and is then watched: 40, 8) and cycles (the most "
        "returns of doubled branches: 8); parameters, and friction. A list, beta=0.3,0.4,0.5, is as many families, "
        "followed together; of several lists the first values belong to one family, the second ones to the next"
    )
    add_values(parser, SETTINGS, about, lambda names: {"along": tuple(names.parameters)})
    add_output(parser, "SCENE-NAME.nc")
    add_json(parser)


def run(options: Options) -> None:
    place = Place("follow")
    settings, parameters = named_values(place, options.values, SETTINGS, lists=True)
    missing = [name for name in REQUIRED if name not in settings]
    if missing:
        raise place.error(f"{' and '.join(missing)} missing; write vibrojax follow SCENE {_SYNTAX}")
    from vibrojax.analyses.continuation.run import OBSERVE, SETTLE, family_spec
    from vibrojax.measures.ledger import MOST_CYCLES

    request = family_spec(
        options.scene,
        along=settings["along"],
        at=settings["at"],
        span=(settings["from"], settings["to"]),
        start=settings.get("start"),
        settle=settings.get("settle", SETTLE.default),
        observe=settings.get("observe", OBSERVE.default),
        cycles=whole(settings.get("cycles", MOST_CYCLES)),
        parameters=parameters,
    )
    result = result_at(options, f"{request.sweep.scene}-{request.along}.nc", request.identity())
    from vibrojax.analyses.continuation.analysis import family_facts, family_lines
    from vibrojax.analyses.continuation.run import continue_families
    from vibrojax.io.attributes import attribute_of

    dataset = continue_families(request, progress=not options.quiet)
    drawn = write_result(options, dataset, result)
    if options.json:
        machine = {"scene": dataset.attrs["scene"], "start": dataset.attrs.get("start")}
        machine["parameters"] = attribute_of(dataset, "parameters")
        print_json({**machine, **family_facts(dataset), **file_facts(result, drawn)})
    elif not options.quiet:
        print("\n".join([*family_lines(dataset), f"{result.out}{drawn}"]))
