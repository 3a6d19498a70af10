"""Follow the family of periodic orbits over one parameter, stable and unstable, with its special points."""

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path
from typing import TYPE_CHECKING

from vibrojax.analyses.glossary import FAMILY_WORDS, glossary
from vibrojax.cli._command import Options
from vibrojax.cli._complete import scenes, values_with, with_completer
from vibrojax.cli._family_lines import family_facts, family_lines
from vibrojax.cli._json import HELP, print_json
from vibrojax.cli._named_values import named_values, whole
from vibrojax.cli._output import result_at, result_written
from vibrojax.errors import Place

if TYPE_CHECKING:
    import xarray

NEEDED = {"along": "NAME", "at": "VALUE", "from": "A", "to": "B"}
"""What there is no default for, and what stands behind it in the help."""

SETTINGS = (*NEEDED, "start", "settle", "observe", "cycles")
"""Arguments of `follow` that are no parameters of a scene."""

_SYNTAX = "along=NAME at=VALUE from=A to=B"


def arguments(parser: ArgumentParser) -> None:
    """Add the command's arguments to `parser`."""
    parser.formatter_class = RawDescriptionHelpFormatter
    parser.epilog = f"words that stand in what is printed:\n{glossary(*FAMILY_WORDS)}"
    scene = parser.add_argument(
        "scene", metavar="SCENE", help="rotary, vibro-impact, penetration, drilling or coupled-drilling"
    )
    with_completer(scene, scenes)
    values = parser.add_argument(
        "values",
        metavar="NAME=VALUE",
        nargs="*",
        default=[],  # else argparse calls them required before Python 3.13
        help=f"{_SYNTAX}: the parameter, where the family begins, and its bounds; start (a name, or [x1,x1',x2,x2']), "
        "settle and observe (s, for which the motion at VALUE settles and is then watched: 40, 8) and cycles (the most "
        "returns of doubled branches: 8); "
        "parameters, and friction. A list, beta=0.3,0.4,0.5, is as many families, followed together; of several lists "
        "the first values are of one family, the second ones of the next",
    )
    with_completer(values, values_with(SETTINGS, lambda names: {"along": tuple(names.parameters)}))
    parser.add_argument("-o", dest="out", metavar="OUT.nc", help="where to write (SCENE-NAME.nc in this folder)")
    parser.add_argument("--fresh", action="store_true", help="replace OUT, whatever it holds")
    parser.add_argument("--json", action="store_true", help=HELP)


def run(options: Options) -> None:
    """Run the command."""
    settings, parameters = _read(options.values)
    from vibrojax.analyses.continuation.spec import OBSERVE, SETTLE, read_asked
    from vibrojax.measures.ledger import MOST_CYCLES

    asked = read_asked(
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
    result = result_at(options, f"{asked.sweep.scene}-{asked.along}.nc", asked.identity())

    from vibrojax.analyses.continuation.run import follow_asked

    dataset = follow_asked(asked, progress=not options.quiet)
    drawn = result_written(options, dataset, result)
    if options.json:
        print_json(_facts(dataset, result.out, result.picture if drawn else None))
    elif not options.quiet:
        print("\n".join([*family_lines(dataset), f"{result.out}{drawn}"]))


def _facts(dataset: "xarray.Dataset", out: Path, picture: Path | None) -> dict[str, object]:
    """What `--json` prints."""
    from vibrojax.io.attributes import attribute_of

    attributes = dataset.attrs
    return {
        "scene": attributes["scene"],
        "start": attributes.get("start"),
        "parameters": attribute_of(dataset, "parameters"),
        **family_facts(dataset),
        "dataset": str(out),
        "picture": None if picture is None else str(picture),
    }


def _read(words: list[str]) -> tuple[dict[str, object], dict[str, object]]:
    """Settings and parameters from words NAME=VALUE."""
    place = Place("follow")
    settings, parameters = named_values(place, words, SETTINGS, lists=True)
    missing = [name for name in NEEDED if name not in settings]
    if missing:
        raise place.error(f"{' and '.join(missing)} missing; write vibrojax follow SCENE {_SYNTAX}")
    return settings, parameters
