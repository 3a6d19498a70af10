"""Commands and their arguments: SCENE, NAME=VALUE, FILE and options."""

import json
import shlex
from argparse import Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable, Collection
from typing import Any, NamedTuple

from vibrojax.errors import Place, shown
from vibrojax.studies import glossary

AddArguments = Callable[[Any], None]
"""Function that adds arguments to a parser, or to a group of arguments of a parser."""


SWEEP = "a sweep: a bundled name, like regime-map, or the path of a TOML file; or "
"""Beginning of the help of FILE where it may be a sweep."""


class Options(Namespace):
    """The arguments of a command by name, and the advice printed after an interrupt."""

    command: str | None = None
    version: bool = False
    quiet: bool = False
    verbose: bool = False
    json: bool = False
    how_to_resume: str = ""
    """Advice printed after an interrupt; a command changes it as it proceeds."""

    def advise(self, state: str, *words: str) -> None:
        """Set the advice: the `state` of the work, and the command `vibrojax WORDS` that continues it."""
        self.how_to_resume = f"{state}: {shlex.join(['vibrojax', *words])}"


class Command(NamedTuple):
    """A command: its `summary` in `--help`, its arguments, and its work.

    `run` raises `InputError` for bad input, and `OSError` if the result cannot be written to the disk.
    """

    summary: str
    arguments: tuple[AddArguments, ...]
    run: Callable[[Options], None]


def command(*arguments: AddArguments) -> Callable[[Callable[[Options], None]], Command]:
    """Make a command of a function, whose docstring begins with the summary."""
    return lambda run: Command(str(run.__doc__).splitlines()[0].rstrip("."), arguments, run)


def argument(name: str, metavar: str, help_: str, **settings: Any) -> AddArguments:
    """Declare an argument with a value; `settings` are those of `ArgumentParser.add_argument`."""
    return lambda parser: parser.add_argument(name, metavar=metavar, help=help_, **settings)


def flag(name: str, help_: str) -> AddArguments:
    """Declare an option without a value."""
    return lambda parser: parser.add_argument(name, action="store_true", help=help_)


def either(*arguments: AddArguments) -> AddArguments:
    """Declare arguments of which at most one may be given."""

    def add(parser: Any) -> None:
        group = parser.add_mutually_exclusive_group()
        for add_argument in arguments:
            add_argument(group)

    return add


def explained(*words: str) -> AddArguments:
    """Add the definitions of terms to `--help`."""

    def add(parser: Any) -> None:
        parser.formatter_class = RawDescriptionHelpFormatter
        parser.epilog = f"words used in the output:\n{glossary(*words)}"

    return add


def output_options(default: str) -> AddArguments:
    """Declare `-o` and `--fresh`; `default` describes the default file name, in the current folder."""

    def add(parser: Any) -> None:
        argument("-o", "OUT.nc", f"where to write ({default} in this folder)", dest="out")(parser)
        flag("--fresh", "compute again, and replace OUT, whatever result of vibrojax it holds")(parser)

    return add


JSON = flag("--json", "print one JSON object on stdout, and nothing else there; a number that is not finite is null")


def point_arguments(
    about: str,
    scenes: str = "rotary, vibro-impact, penetration, drilling or coupled-drilling",
) -> AddArguments:
    """Declare SCENE, with the help string `scenes`, and NAME=VALUE, with the help string `about`."""

    def add(parser: Any) -> None:
        argument("scene", "SCENE", scenes)(parser)
        # Without a default, argparse before Python 3.13 requires the values.
        argument("values", "NAME=VALUE", about, nargs="*", default=[])(parser)

    return add


def named_values(
    place: Place, words: list[str], settings: Collection[str], lists: bool
) -> tuple[dict[str, object], dict[str, object]]:
    """Return the values of `settings` and the values of parameters, each keyed by name.

    **Arguments:** `lists`: whether a parameter may have several values.

    **Raises:** `InputError` if a word is not NAME=VALUE, or a name occurs twice.
    """
    chosen: dict[str, object] = {}
    parameters: dict[str, object] = {}
    for word in words:
        name, equals, text = (part.strip() for part in word.partition("="))
        if not equals or not name:
            raise place.error(f"{shown(word)} is not NAME=VALUE; write one, like beta=0.4")
        listed = lists and name not in settings
        if name in chosen or name in parameters:
            several = f", or a list like {name}=0.3,0.4" if listed else ""
            raise place.at(name).error(f"{shown(text)} is a second value; give one{several}")
        (chosen if name in settings else parameters)[name] = _value(place.at(name), text, listed)
    return chosen, parameters


def _value(place: Place, text: str, listed: bool) -> object:
    """Return a number, a name or a vector; if `listed`, also a list written as 0.3,0.4 or [0.3,0.4]."""
    if text.startswith("["):
        try:
            return list(json.loads(text))
        except (ValueError, RecursionError):
            expected = "list; write one like [0.3,0.4]" if listed else "vector; write one like [0,0,0.01,0]"
            raise place.error(f"{shown(text)} is not a {expected}") from None
    if listed and "," in text:
        return [number_or_name(part.strip()) for part in text.split(",")]
    return number_or_name(text)


def number_or_name(text: str) -> float | str:
    """Return a number if `text` is one, else `text`."""
    try:
        return float(text)
    except ValueError:
        return text


def whole(value: object) -> object:
    """Return a float with an integer value as int, and any other value unchanged."""
    return int(value) if isinstance(value, float) and value.is_integer() else value
