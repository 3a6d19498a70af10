"""Shell completion of scenes, sweeps, NAME= and its values, and files.

Completion needs `pip install vibrojax[completion]`, and in the shell: eval "$(register-python-argcomplete vibrojax)".
"""

import os
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from vibrojax.sweep.input.names import Names

Completer = Callable[..., Iterable[str]]
"""Function that returns the words beginning with `prefix`, given the arguments parsed before."""

SettingChoices = Callable[["Names"], dict[str, tuple[str, ...]]]
"""Function that returns the possible values of a command's settings, for the settings with a fixed set."""


def add_argument(parser: ArgumentParser, *names: str, completer: Completer, **options: Any) -> None:
    """Add an argument whose values `completer` completes."""
    parser.add_argument(*names, **options).completer = completer  # type: ignore[attr-defined] # argcomplete reads it


def complete(parser: ArgumentParser) -> None:
    """Respond to a shell's request for completions and exit; do nothing if there is no request."""
    if "_ARGCOMPLETE" not in os.environ:
        return
    try:
        import argcomplete
    except ImportError:  # an optional dependency: without it, nothing is completed
        return
    argcomplete.autocomplete(parser, always_complete_options="long")


def scenes(prefix: str, **_: object) -> list[str]:
    """Return the names of scenes that begin with `prefix`."""
    from vibrojax.models.scenes import SCENES

    return [name for name in SCENES if name.startswith(prefix)]


def sweeps(prefix: str, **_: object) -> list[str]:
    """Return bundled sweeps, and sweep files, that begin with `prefix`."""
    from vibrojax.sweep.input.source import bundled_names

    return [name for name in bundled_names() if name.startswith(prefix)] + files(".toml")(prefix)


def files(*endings: str) -> Callable[..., list[str]]:
    """Return a completer for folders, and for files with one of the suffixes `endings`."""

    def completer(prefix: str, **_: object) -> list[str]:
        folder, slash, start = prefix.rpartition("/")
        try:
            entries = sorted(os.scandir(folder + "/" if slash else "."), key=lambda entry: entry.name)
        except OSError:
            return []
        names = (entry.name + "/" if entry.is_dir() else entry.name for entry in entries)
        matches = (name for name in names if name.startswith(start) and name.endswith(("/", *endings)))
        return [f"{folder}{slash}{name}" for name in matches if start or not name.startswith(".")]

    return completer


def values_with(settings: tuple[str, ...], choices_of: SettingChoices = lambda names: {}) -> Completer:
    """Return a completer for NAME=VALUE, where NAME is a parameter of the scene or one of a command's `settings`.

    `choices_of` returns the values of settings that have a fixed set of values.
    """

    def completer(prefix: str, parsed_args: Namespace, **_: object) -> list[str]:
        from vibrojax.errors import InputError, Place
        from vibrojax.sweep.input.names import read_names

        words = [str(word).partition("=") for word in getattr(parsed_args, "values", None) or ()]
        options: dict[str, object] = {name: value for name, _, value in words}
        try:
            names = read_names(Place("simulate"), getattr(parsed_args, "scene", None) or parsed_args.file, options)
        except InputError:
            return []
        starts = {"start": names.starts} if names.starts else {}
        named = {name: tuple(names.system.choices[name]) for name in names.options} | starts
        choices = named | {name: tuple(values) for name, values in names.presets.items()} | choices_of(names)
        name, equals, _value = prefix.partition("=")
        if equals:
            return [word for value in choices.get(name, ()) if (word := f"{name}={value}").startswith(prefix)]
        taken = {word[0] for word in words}
        keys = dict.fromkeys([*choices, *names.writable, *settings])
        return [f"{key}=" for key in keys if key.startswith(prefix) and key not in taken]

    return completer
