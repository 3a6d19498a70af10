"""What a command is: a module that adds its arguments to a parser, and runs with what was given."""

from argparse import ArgumentParser, Namespace
from typing import Protocol


class Options(Namespace):
    """The arguments that a command was given, by name, and what becomes of it when it is interrupted."""

    command: str | None = None
    version: bool = False
    quiet: bool = False
    verbose: bool = False
    how_to_resume: str = ""
    """How to go on after an interrupt, as it is said then; a command sets it as it goes."""


class Command(Protocol):
    """A module of this folder; the first line of its docstring is what `--help` says of it."""

    __doc__: str | None

    def arguments(self, parser: ArgumentParser) -> None:
        """Add the command's arguments to `parser`."""

    def run(self, options: Options) -> None:
        """Run the command.

        **Raises:** `InputError` where what was given is not right, `OSError` where the disk does not take the result.
        """
