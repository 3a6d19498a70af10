"""The arguments SCENE and NAME=VALUE: settings of a command and parameters of a scene, possibly with several values."""

import json
from argparse import ArgumentParser
from collections.abc import Collection

from vibrojax.cli.completion import SettingChoices, add_argument, scenes, values_with
from vibrojax.errors import Place, shown

ALL_SCENES = "rotary, vibro-impact, penetration, drilling or coupled-drilling"


def add_values(
    parser: ArgumentParser,
    settings: tuple[str, ...],
    about: str,
    choices_of: SettingChoices = lambda names: {},
    scene: str = ALL_SCENES,
) -> None:
    """Add SCENE, with the help string `scene`, and NAME=VALUE, with the help string `about`, to a parser."""
    add_argument(parser, "scene", completer=scenes, metavar="SCENE", help=scene)
    # Without a default, argparse before Python 3.13 requires the values.
    completer = values_with(settings, choices_of)
    add_argument(parser, "values", completer=completer, metavar="NAME=VALUE", nargs="*", default=[], help=about)


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
        if name in chosen or name in parameters:
            several = f", or a list like {name}=0.3,0.4" if lists and name not in settings else ""
            raise place.at(name).error(f"{shown(text)} is a second value; give one{several}")
        table = chosen if name in settings else parameters
        table[name] = _value(place.at(name), text, listed=lists and name not in settings)
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
        return [_single(part.strip()) for part in text.split(",")]
    return _single(text)


def _single(text: str) -> object:
    try:
        return float(text)
    except ValueError:
        return text


def whole(value: object) -> object:
    """Return a float with an integer value as int, and any other value unchanged."""
    return int(value) if isinstance(value, float) and value.is_integer() else value
