"""Words NAME=VALUE of a command: its settings, and a scene's parameters, of which there may be lists."""

import json
from collections.abc import Collection

from vibrojax.errors import Place, shown


def named_values(
    place: Place, words: list[str], settings: Collection[str], lists: bool
) -> tuple[dict[str, object], dict[str, object]]:
    """The values of `settings`, and those of parameters, by name; raises `InputError` where a word is none.

    `lists`: whether a parameter may have several values.
    """
    chosen: dict[str, object] = {}
    parameters: dict[str, object] = {}
    for word in words:
        name, equals, text = (part.strip() for part in word.partition("="))
        if not equals or not name:
            raise place.error(f"{shown(word)} is no NAME=VALUE; write one, like beta=0.4")
        if name in chosen or name in parameters:
            several = f", or a list like {name}=0.3,0.4" if lists and name not in settings else ""
            raise place.at(name).error(f"{shown(text)} is a second value; give one{several}")
        home = chosen if name in settings else parameters
        home[name] = _value(place.at(name), text, listed=lists and name not in settings)
    return chosen, parameters


def _value(place: Place, text: str, listed: bool) -> object:
    """A number, a name or a vector; where values may be `listed`, 0.3,0.4 or [0.3,0.4]."""
    if text.startswith("["):
        try:
            return list(json.loads(text))
        except (ValueError, RecursionError):
            right = "list; write one like [0.3,0.4]" if listed else "vector; write one like [0,0,0.01,0]"
            raise place.error(f"{shown(text)} is no {right}") from None
    if listed and "," in text:
        return [_single(part.strip()) for part in text.split(",")]
    return _single(text)


def _single(text: str) -> object:
    try:
        return float(text)
    except ValueError:
        return text


def whole(value: object) -> object:
    """A whole number as one."""
    return int(value) if isinstance(value, float) and value.is_integer() else value
