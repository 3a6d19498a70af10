"""Commands, their arguments, and the words SCENE NAME=VALUE."""

import json
import re
import shlex
from argparse import Namespace
from collections.abc import Callable, Collection
from typing import Any, NamedTuple

from vibrojax.errors import Place, shown

AddArguments = Callable[[Any], object]
"""Function that adds arguments to a parser, or to a group of arguments of a parser."""

MANY: dict[str, Any] = {"action": "extend", "nargs": "+"}
"""Settings of an option that accepts several values, and may be repeated."""

SWEEP = "a sweep: a bundled name such as regime-map, or the path of a TOML file; or "
"""Beginning of the help of FILE where it may be a sweep."""

KEPT = "finished chunks are kept; to go on"
"""Advice for a command whose chunks of lanes stay beside its output until that is written."""

_HALF_WIDTH = re.compile(r"\+-|±|\+/-")


class Options(Namespace):
    """The arguments of a command by name, and the advice printed after an interrupt."""

    command: str | None = None
    version: bool = False
    quiet: bool = False
    verbose: bool = False
    json: bool = False
    fresh: bool = False
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


def words(about: str) -> AddArguments:
    """Declare NAME=VALUE, any number of them."""
    # Without a default, argparse before Python 3.13 requires the values.
    return argument("values", "NAME=VALUE", about, nargs="*", default=[])


def result_options(default: str) -> tuple[AddArguments, ...]:
    """Declare the options of a command that writes a result; `default` describes the default name of its file."""
    return (
        argument("-o", "OUT.nc", f"output file (default: {default} in this folder)", dest="out"),
        flag("--fresh", "compute again, and replace any vibrojax result in OUT"),
        JSON,
    )


JSON = flag("--json", "print only one JSON object on stdout; non-finite numbers become null")


def named_values(
    place: Place, given: Collection[str], settings: Collection[str] = (), lists: bool = False, tolerances: bool = False
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the values of `settings` and the values of parameters, each keyed by name.

    **Arguments:** `given`: words NAME=VALUE; `lists`: whether a parameter may have several values; `tolerances`:
    whether it may be written VALUE+-HALF_WIDTH, which gives a pair.

    **Raises:** `InputError` if a word is not NAME=VALUE, or a name occurs twice.
    """
    chosen: dict[str, Any] = {}
    parameters: dict[str, Any] = {}
    for word in given:
        name, equals, text = (part.strip() for part in word.partition("="))
        if not equals or not name:
            raise place.error(f"{shown(word)} is not NAME=VALUE; write one, like beta=0.4")
        here, is_setting = place.at(name), name in settings
        listed = lists and not is_setting
        if name in chosen or name in parameters:
            several = f", or a list like {name}=0.3,0.4" if listed else ""
            raise here.error(f"{shown(text)} is a second value; give one{several}")
        value: Any = number_or_name(text)
        if tolerances and not is_setting and _HALF_WIDTH.search(text):
            value = _pair(place, word, text)
        elif text.startswith("["):
            try:
                value = list(json.loads(text))
            except (ValueError, RecursionError):
                expected = "list; write one like [0.3,0.4]" if listed else "vector; write one like [0,0,0.01,0]"
                raise here.error(f"{shown(text)} is not a {expected}") from None
        elif listed and "," in text:
            value = [number_or_name(part.strip()) for part in text.split(",")]
        if is_setting:
            chosen[name] = int(value) if isinstance(value, float) and value.is_integer() else value
        else:
            parameters[name] = value
    return chosen, parameters


def _pair(place: Place, word: str, text: str) -> tuple[float, float]:
    """Return the nominal value and the half-width in VALUE+-HALF_WIDTH, which may end in %."""
    value, width = _HALF_WIDTH.split(text, maxsplit=1)
    try:
        nominal, half = float(value), float(width.strip().removesuffix("%"))
    except ValueError:
        expected = "write NAME=VALUE+-HALF_WIDTH, like delta=0.005+-0.001 or gamma=0.64+-1%"
        raise place.error(f"{shown(word)} is not a tolerance; {expected}") from None
    return nominal, abs(nominal) * half / 100 if width.rstrip().endswith("%") else half


def number_or_name(text: str) -> float | str:
    """Return a number if `text` is one, else `text`."""
    try:
        return float(text)
    except ValueError:
        return text
