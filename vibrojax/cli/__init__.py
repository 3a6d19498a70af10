"""The command `vibrojax`: parse, call, print.

Nothing heavy is imported until a command runs, so that `--help` answers at once.
"""

import logging
import os
import signal
import sys
import traceback
import warnings
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import entry_points
from typing import NoReturn, TextIO

from vibrojax.analyses.glossary import glossary
from vibrojax.analyses.sweep.workers.shutdown import leave
from vibrojax.cli import (
    accuracy,
    explore,
    fit,
    follow,
    info,
    orbits,
    plot,
    push,
    reproduce,
    scenes,
    simulate,
    sweep,
)
from vibrojax.cli.analysis import AnalysisCommand
from vibrojax.cli.completion import complete
from vibrojax.cli.output import Command, Options
from vibrojax.errors import InputError, printable
from vibrojax.io.provenance import package_version
from vibrojax.io.threads import asked_to_end, in_own_thread
from vibrojax.progress import LOG, end_lines, timed

DONE, FAILED, BAD_INPUT, INTERRUPTED, PIPE_CLOSED, TERMINATED = 0, 1, 2, 130, 141, 143

_DATASETS = (".nc", ".zarr")
_MISFITS = (ArithmeticError, AssertionError, AttributeError, LookupError, RecursionError, TypeError, ValueError)
"""What is raised where parts of a dataset do not fit together in a way that is not checked."""

_LONGEST_LINE = 4000
"""Characters of a line on stderr, which may hold what a file says."""

_COMMANDS: dict[str, Command] = {
    "sweep": sweep,
    "simulate": simulate,
    "orbits": orbits,
    "follow": follow,
    "borders": AnalysisCommand(
        "borders", "Draw the borders of the stable single impact in a sweep's plane: curves named by what happens there"
    ),
    "attractors": AnalysisCommand(
        "attractors", "Find the attractors that a sweep's starts lead to, and the share of starts of each"
    ),
    "push": push,
    "plot": plot,
    "explore": explore,
    "info": info,
    "fit": fit,
    "accuracy": accuracy,
    "reproduce": reproduce,
    "scenes": scenes,
}


class Terminated(KeyboardInterrupt):
    """The process was asked to end (SIGTERM), by a shutdown or a batch system's limit; it ends as after Ctrl-C."""


class _Parser(ArgumentParser):
    """Wrong arguments are bad input like any other: one line, status 2."""

    def error(self, message: str) -> NoReturn:
        command = self.prog.partition(" ")[2]
        raise InputError(f"{command}{': ' * bool(command)}{message}; see {self.prog} --help")


def command() -> None:
    """The process `vibrojax`: run it and leave."""
    if signal.getsignal(signal.SIGTERM) == signal.SIG_DFL:  # who started it may have chosen that it be ignored
        signal.signal(signal.SIGTERM, _terminate)
    if signal.getsignal(signal.SIGINT) == signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)
    warnings.showwarning = _warn
    status = main(do=in_own_thread)
    for sent in (signal.SIGINT, signal.SIGTERM):  # all is done: what Python still tidies up needs no interrupt
        signal.signal(sent, signal.SIG_IGN)
    if status in (INTERRUPTED, TERMINATED, BAD_INPUT):
        # Threads may still be at their lanes, or at a file that has no end: nobody waits for them.
        leave()
        sys.stderr.flush()
        os._exit(status)
    sys.exit(status)


def main(argv: Sequence[str] | None = None, do: Callable[[Callable[[], None]], object] = lambda work: work()) -> int:
    """Run the command.

    **Arguments:**

    - `argv`: its arguments; None: the process's.
    - `do`: does the work, in this thread or another.

    **Returns:** the exit status: 0 done, 2 bad input, 130 interrupted, 143 terminated, 1 where the computer failed (a
    full disk), 141 where the reader of the output went away.
    """
    options = Options()
    try:
        words = sys.argv[1:] if argv is None else argv
        parser = _parser([*words, *os.environ.get("COMP_LINE", "").split()])
        complete(parser)
        parser.parse_args(words, options)
        if options.version:
            print(f"vibrojax {package_version()}")
        elif options.command is None:
            raise InputError(f"no command; choose from {', '.join(_commands())}, or see vibrojax --help")
        else:
            command = _commands()[options.command]
            with _verbosely(options):
                do(lambda: _run(command.run, options))
        sys.stdout.flush()
        return DONE
    except SystemExit as leaving:  # --help
        return int(leaving.code or 0)
    except InputError as error:
        return _say(str(error), BAD_INPUT)
    except KeyboardInterrupt as end:
        how, status = ("terminated", TERMINATED) if isinstance(end, Terminated) else ("interrupted", INTERRUPTED)
        return _say(f"{how}; {options.how_to_resume or 'run the same command again'}", status)
    except BrokenPipeError:
        # What is left in the buffer would raise again while Python leaves.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return PIPE_CLOSED
    except OSError as error:
        return _say(_failed(f"{error.filename or options.command}: {error.strerror or error}", options), FAILED)
    except MemoryError:
        return _say(_failed(f"{options.command}: not enough memory", options), FAILED)


def _run(run: Callable[[Options], None], options: Options) -> None:
    """Run a command; report a dataset, which may come from anywhere, as bad input if its content makes no sense."""
    try:
        run(options)
    except InputError:
        raise
    except _MISFITS as error:
        file = str(getattr(options, "file", ""))
        if not file.endswith(_DATASETS):
            raise
        LOG.info("%s", "".join(traceback.format_exception(error)))
        about = f"{type(error).__name__}: {printable(error, 200)}"
        raise InputError(f"{file}: its content does not fit together ({about}); --verbose says where") from error


def _commands() -> dict[str, Command]:
    """Return the package's commands, and those of analyses that installed packages offer."""
    others = {
        entry.name: AnalysisCommand(entry.name, f"analysis of the package {entry.dist.name if entry.dist else '?'}")
        for entry in entry_points(group="vibrojax.analyses")
        if entry.name not in _COMMANDS
    }
    return _COMMANDS | others


def _parser(words: Collection[str]) -> ArgumentParser:
    """Return the parser for a command line of these words; only a command among them gets its arguments."""
    parser = _Parser(
        prog="vibrojax",
        description="Simulate a self-exciting percussive-rotary drill: maps over parameters, single points, pictures.",
        epilog=f"words used in the output:\n{glossary()}",
        allow_abbrev=False,
        formatter_class=RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="store_true", help="print the version")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND")
    for name, command in _commands().items():
        summary = str(command.__doc__).splitlines()[0].rstrip(".")
        subparser = subparsers.add_parser(name, help=summary, description=summary, allow_abbrev=False)
        if name not in words:
            continue
        command.arguments(subparser)
        loudness = subparser.add_mutually_exclusive_group()
        loudness.add_argument("--quiet", action="store_true", help="print only errors, warnings and the result")
        loudness.add_argument(
            "--verbose", action="store_true", help="say on stderr what was chosen, and how long each part took"
        )
    return parser


@contextmanager
def _verbosely(options: Options) -> Iterator[None]:
    """Show on stderr what the package logs, if that is asked for, and how long the command took."""
    if not options.verbose:
        yield
        return
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("vibrojax: %(message)s"))
    level = LOG.level
    LOG.addHandler(handler)
    LOG.setLevel(logging.INFO)
    try:
        with timed("all together"):
            yield
    finally:
        LOG.removeHandler(handler)
        LOG.setLevel(level)


def _terminate(*_: object) -> None:
    asked_to_end.append(Terminated())
    raise asked_to_end[-1]


def _interrupt(*_: object) -> None:
    asked_to_end.append(KeyboardInterrupt())
    raise asked_to_end[-1]


def _failed(problem: str, options: Options) -> str:
    """What went wrong on this computer, and how to go on where anything is kept."""
    return f"{problem}; {options.how_to_resume}" if options.how_to_resume else problem


def _warn(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Show a warning as all that the command says: on one line of stderr."""
    print("vibrojax: warning:", printable(message, _LONGEST_LINE), file=sys.stderr)


def _say(line: str, status: int) -> int:
    """Say on stderr, on one line, why the command ended with `status`."""
    end_lines()
    sys.stdout.flush()
    print("vibrojax:", printable(line, _LONGEST_LINE), file=sys.stderr)
    return status
