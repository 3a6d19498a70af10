"""What may stand in the place of an argument, for shells that complete: scenes, sweeps, NAME= and its values, files.

It takes `pip install vibrojax[completion]`, and in the shell: eval "$(register-python-argcomplete vibrojax)".
"""

import os
from argparse import Action, ArgumentParser, Namespace
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from vibrojax.sweep.input.names import Names

Completer = Callable[..., Iterable[str]]
"""Gives the words that may begin with `prefix`, by what was parsed before it."""

Besides = Callable[["Names"], dict[str, tuple[str, ...]]]
"""Which names may stand behind those of a command's settings that have a few."""


def with_completer(action: Action, completer: Completer) -> None:
    """Let `completer` say what may stand for an argument."""
    action.completer = completer  # type: ignore[attr-defined] # argcomplete looks for it there


def complete(parser: ArgumentParser) -> None:
    """Answer the shell, if it is it that asks, and leave."""
    if "_ARGCOMPLETE" not in os.environ:
        return
    try:
        import argcomplete
    except ImportError:  # an extra: without it nothing is completed
        return
    argcomplete.autocomplete(parser, always_complete_options="long")


def scenes(prefix: str, **_: object) -> list[str]:
    """The names of the scenes."""
    from vibrojax.models.scenes import SCENES

    return [name for name in SCENES if name.startswith(prefix)]


def sweeps(prefix: str, **_: object) -> list[str]:
    """The bundled sweeps, and sweep files."""
    from vibrojax.sweep.input.source import bundled_names

    return [name for name in bundled_names() if name.startswith(prefix)] + files(".toml")(prefix)


def files(*endings: str) -> Callable[..., list[str]]:
    """A completer for files that end so, and for folders on the way to them."""

    def completer(prefix: str, **_: object) -> list[str]:
        folder, _slash, begun = prefix.rpartition("/")
        try:
            there = sorted(os.scandir(folder + "/" if _slash else "."), key=lambda entry: entry.name)
        except OSError:
            return []
        names = (entry.name + "/" if entry.is_dir() else entry.name for entry in there)
        fitting = (name for name in names if name.startswith(begun) and name.endswith(("/", *endings)))
        return [f"{folder}{_slash}{name}" for name in fitting if begun or not name.startswith(".")]

    return completer


def values_with(settings: tuple[str, ...], besides: Besides = lambda names: {}) -> Completer:
    """A completer for NAME= of the scene's parameters and of a command's `settings`, and behind it the names that may
    stand there; `besides`: those of settings."""

    def completer(prefix: str, parsed_args: Namespace, **_: object) -> list[str]:
        return _values(prefix, parsed_args, settings, besides)

    return completer


def _values(prefix: str, parsed_args: Namespace, settings: tuple[str, ...], besides: Besides) -> list[str]:
    from vibrojax.errors import InputError, Place
    from vibrojax.models.physics.rock import ROCKS
    from vibrojax.sweep.input.names import CHOICES, read_names

    given = [str(word).partition("=") for word in getattr(parsed_args, "values", None) or ()]
    chosen = {name: value for name, _, value in given if name in CHOICES}
    try:
        names = read_names(Place("simulate"), getattr(parsed_args, "scene", None) or parsed_args.file, chosen)
    except InputError:
        return []
    rock = {"rock": tuple(ROCKS)} if names.has_rock else {}
    starts = {"start": names.starts} if names.starts else {}
    choices = {name: tuple(CHOICES[name]) for name in names.options} | starts | rock | besides(names)
    there = [*choices, *names.writable, *settings]
    taken = {name for name, _, _ in given}
    name, equals, _value = prefix.partition("=")
    if equals:
        return [word for word in (f"{name}={one}" for one in choices.get(name, ())) if word.startswith(prefix)]
    return [f"{one}=" for one in dict.fromkeys(there) if one.startswith(prefix) and one not in taken]
