"""Follow the family of periodic orbits over one parameter, stable and unstable, with its special points."""

import json
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path
from typing import TYPE_CHECKING

from vibrojax.cli._command import Options
from vibrojax.cli._complete import follow_values, scenes, with_completer
from vibrojax.cli._family_lines import family_facts, family_lines
from vibrojax.cli._json import HELP, from_json, print_json
from vibrojax.cli._output import dataset_written, draw, output, picture_beside
from vibrojax.errors import Place, shown
from vibrojax.timings import timed
from vibrojax.words import FAMILY_WORDS, glossary

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
    with_completer(values, follow_values)
    parser.add_argument("-o", dest="out", metavar="OUT.nc", help="where to write (SCENE-NAME.nc in this folder)")
    parser.add_argument("--fresh", action="store_true", help="replace OUT, whatever it holds")
    parser.add_argument("--json", action="store_true", help=HELP)


def run(options: Options) -> None:
    """Run the command."""
    settings, parameters = _read(options.values)
    from vibrojax.families.asked import OBSERVE, SETTLE, read_asked
    from vibrojax.measure.ledger import MOST_CYCLES

    asked = read_asked(
        options.scene,
        along=settings["along"],
        at=settings["at"],
        span=(settings["from"], settings["to"]),
        start=settings.get("start"),
        settle=settings.get("settle", SETTLE.default),
        observe=settings.get("observe", OBSERVE.default),
        cycles=_whole(settings.get("cycles", MOST_CYCLES)),
        parameters=parameters,
    )
    out = output(options.out or f"{asked.sweep.scene}-{asked.along}.nc")
    picture = picture_beside(out)

    from vibrojax.followed import follow_asked
    from vibrojax.store.dataset import write_dataset
    from vibrojax.store.finished import IDENTITY, check_replaceable, identity_text

    identity = asked.identity()
    if not options.fresh:
        check_replaceable(out, identity)
    dataset = follow_asked(asked, progress=not options.quiet)
    dataset = dataset.assign_attrs({IDENTITY: identity_text(identity)})
    with timed("write"):
        write_dataset(dataset, out)
    dataset_written(options, out)
    drawn = draw(dataset, picture)
    if options.json:
        print_json(_facts(dataset, out, picture if drawn else None))
    elif not options.quiet:
        print("\n".join([*family_lines(dataset), f"{out}{drawn}"]))


def _facts(dataset: "xarray.Dataset", out: Path, picture: Path | None) -> dict[str, object]:
    """What `--json` prints."""
    attributes = dataset.attrs
    return {
        "scene": attributes["scene"],
        "start": attributes.get("start"),
        "parameters": from_json(attributes, "parameters"),
        **family_facts(dataset),
        "dataset": str(out),
        "picture": None if picture is None else str(picture),
    }


def _read(words: list[str]) -> tuple[dict[str, object], dict[str, object]]:
    """Settings and parameters from words NAME=VALUE."""
    place = Place("follow")
    settings: dict[str, object] = {}
    parameters: dict[str, object] = {}
    for word in words:
        name, equals, text = (part.strip() for part in word.partition("="))
        if not equals or not name:
            raise place.error(f"{shown(word)} is no NAME=VALUE; write one, like beta=0.4")
        if name in settings or name in parameters:
            several = "" if name in SETTINGS else f", or a list like {name}=0.3,0.4"
            raise place.at(name).error(f"{shown(text)} is a second value; give one{several}")
        home = settings if name in SETTINGS else parameters
        home[name] = _value(place.at(name), text, listed=name not in SETTINGS)
    missing = [name for name in NEEDED if name not in settings]
    if missing:
        raise place.error(f"{' and '.join(missing)} missing; write vibrojax follow SCENE {_SYNTAX}")
    return settings, parameters


def _value(place: Place, text: str, listed: bool) -> object:
    """A number, a name or a vector; where values may be `listed`, 0.3,0.4 or [0.3,0.4]."""
    if text.startswith("["):
        try:
            return list(json.loads(text))
        except (ValueError, RecursionError):
            raise place.error(f"{shown(text)} is no list; write one like [0.3,0.4]") from None
    if listed and "," in text:
        return [_single(part.strip()) for part in text.split(",")]
    return _single(text)


def _single(text: str) -> object:
    try:
        return float(text)
    except ValueError:
        return text


def _whole(value: object) -> object:
    """A whole number as one."""
    return int(value) if isinstance(value, float) and value.is_integer() else value
