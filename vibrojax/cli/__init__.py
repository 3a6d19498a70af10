"""The command `vibrojax`: parses arguments, calls functions and prints results.

Nothing heavy is imported until a command runs, or a study shows its help, so that `--help` responds immediately.
"""

import ctypes
import gc
import logging
import os
import re
import signal
import sys
import traceback
import warnings
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from typing import NoReturn

from vibrojax.cli.arguments import Command, Options, either, flag
from vibrojax.cli.datasets import explore, info, plot, scenes
from vibrojax.cli.logs import fit, rig
from vibrojax.cli.studies import accuracy, curves, orbits, study_command
from vibrojax.cli.sweep import sweep
from vibrojax.errors import InputError, printable, suggestion
from vibrojax.io.files import package_version
from vibrojax.progress import LOG, end_lines, timed
from vibrojax.studies import glossary, offered_analyses
from vibrojax.threads import asked_to_end, in_own_thread, leave

DONE, FAILED, BAD_INPUT, INTERRUPTED, PIPE_CLOSED, TERMINATED = 0, 1, 2, 130, 141, 143

_MALFORMED = (ArithmeticError, AssertionError, AttributeError, LookupError, RecursionError, TypeError, ValueError)
"""Exceptions that a dataset with inconsistent parts causes in code that does not check the dataset."""

_UNKNOWN_COMMAND = re.compile(r"(argument COMMAND: invalid choice: '(.*?)') \(choose from ")
"""Message of argparse on a command that does not exist."""

MAX_STDERR_LINE = 4000
"""Maximum length of a line on stderr [characters]: a line may quote a file."""

_COMMANDS: dict[str, Command | str] = {
    "sweep": sweep,
    "simulate": "trajectory",
    "orbits": orbits,
    "follow": "family",
    "curves": curves,
    **{kind: kind for kind in ("borders", "attractors", "push", "tolerance", "design", "study")},
    "calibrate": "calibration",
    "plot": plot,
    "explore": explore,
    "info": info,
    "fit": fit,
    "rig": rig,
    "accuracy": accuracy,
    "scenes": scenes,
}
"""Commands by name: a command, or the kind of the analysis from whose class it follows."""


class Terminated(KeyboardInterrupt):
    """A request to end (SIGTERM), from a shutdown or a batch system; the process then ends as after Ctrl-C."""


class _Parser(ArgumentParser):
    """A parser that reports wrong arguments as bad input: one line on stderr, exit status 2."""

    def error(self, message: str) -> NoReturn:
        command = self.prog.partition(" ")[2]
        if match := _UNKNOWN_COMMAND.match(message):
            message = f"{match[1]}; {suggestion(match[2], _names())}"
        raise InputError(f"{command}{': ' * bool(command)}{message}; see {self.prog} --help")


COLLECTED_AFTER = 500_000
"""Number of new objects after which Python looks for unused cycles: more than the libraries and a picture have. One
search among 300,000 objects takes 0.2 s; with Python's default, 700 or 2,000, they take 7 % of a first map."""


M_ARENA_MAX = -8
"""Option of glibc's `mallopt`. With one arena for all threads instead of one each, which keep what they have freed, a
sweep of a million lanes takes 0.39 to 0.52 instead of 0.59 GB."""


def command() -> None:
    """Run the command of this process, and exit with its status."""
    # The parent process may have set a signal to be ignored; keep that setting.
    if signal.getsignal(signal.SIGTERM) == signal.SIG_DFL:
        signal.signal(signal.SIGTERM, lambda *_: _end(Terminated()))
    if signal.getsignal(signal.SIGINT) == signal.default_int_handler:
        signal.signal(signal.SIGINT, lambda *_: _end(KeyboardInterrupt()))
    warnings.showwarning = lambda message, *_, **__: _write(f"warning: {message}")
    gc.set_threshold(COLLECTED_AFTER, *gc.get_threshold()[1:])
    with suppress(AttributeError, OSError, TypeError):  # without glibc
        ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)
    status = main(do=in_own_thread)
    for number in (signal.SIGINT, signal.SIGTERM):  # the work is done; Python's clean-up must not be interrupted
        signal.signal(number, signal.SIG_IGN)
    # Do not wait for threads that still compute lanes, or that never finish reading a file. Python would abort the
    # process where such a thread returns from compiled code while the interpreter is being finalised (0.3 s).
    leave()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(status)


def main(argv: Sequence[str] | None = None, do: Callable[[Callable[[], None]], object] = lambda work: work()) -> int:
    """Run the command.

    **Arguments:**

    - `argv`: the command-line arguments; None: `sys.argv`.
    - `do`: function that calls the work, in this thread or another.

    **Returns:** the exit status: 0 done, 1 a failure of the computer (such as a full disk), 2 bad input, 130
    interrupted, 141 the reader of the output closed it, 143 terminated.
    """
    options = Options()
    try:
        words = sys.argv[1:] if argv is None else argv
        _, unknown = _parser(words).parse_known_args(words, options)
        if unknown:
            before, after = (f"{options.command}: ", f" {options.command}") if options.command else ("", "")
            raise InputError(f"{before}unrecognized arguments: {' '.join(unknown)}; see vibrojax{after} --help")
        if options.version:
            print(f"vibrojax {package_version()}")
        elif options.command is None:
            raise InputError(f"no command; choose from {', '.join(_names())}, or see vibrojax --help")
        else:
            if getattr(options, "out", None) == "":
                raise InputError("-o: the name is empty; give the name of a file, or leave out -o")
            command = _command_of(options.command)
            assert command is not None  # the parser knows it
            run = command.run
            with _verbosely() if options.verbose else nullcontext():
                do(lambda: _run(run, options))
        sys.stdout.flush()
        return DONE
    except SystemExit as leaving:  # --help
        return int(leaving.code or 0)
    except InputError as error:
        return _say(str(error), BAD_INPUT)
    except KeyboardInterrupt as end:
        event, status = ("terminated", TERMINATED) if isinstance(end, Terminated) else ("interrupted", INTERRUPTED)
        return _say(f"{event}; {options.how_to_resume or 'run the same command again'}", status)
    except BrokenPipeError:
        # Flushing the rest of the buffer would raise again while Python exits.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return PIPE_CLOSED
    except (OSError, MemoryError) as error:
        problem = f"{options.command}: not enough memory"
        if isinstance(error, OSError):
            problem = f"{error.filename or options.command}: {error.strerror or error}"
        return _say("; ".join(filter(None, (problem, options.how_to_resume))), FAILED)


def _run(run: Callable[[Options], None], options: Options) -> None:
    """Run a command; report an inconsistent dataset as bad input, since a dataset may come from any source.

    An error in the code of a registered analysis is reported as that of its package.
    """
    try:
        run(options)
    except InputError:
        raise
    except _MALFORMED as error:
        file = str(getattr(options, "file", ""))
        packages = {entry.module.partition(".")[0] for entry in offered_analyses().values()} - {"vibrojax"}
        modules = [frame.f_globals.get("__name__", "") for frame, _ in traceback.walk_tb(error.__traceback__)]
        own = next((name for name in modules if name.partition(".")[0] in packages), None)
        if not own and not file.endswith((".nc", ".zarr")):
            raise
        LOG.info("%s", "".join(traceback.format_exception(error)))
        about = f"{type(error).__name__}: {printable(error, 200)}"
        if own:
            raise InputError(f"{options.command}: the code of {own} fails ({about}); --verbose says where") from error
        raise InputError(f"{file}: its content does not fit together ({about}); --verbose says where") from error


def _command_of(name: str) -> Command | None:
    """Return a command of this package, or of an analysis that an installed package registers."""
    known = _COMMANDS.get(name)
    if known is None and (entry := offered_analyses().get(name)) is not None:
        return study_command(name, f"analysis of the package {entry.dist.name if entry.dist else '?'}")
    return study_command(known) if isinstance(known, str) else known


def _names() -> list[str]:
    return [*dict.fromkeys((*_COMMANDS, *offered_analyses()))]


def _parser(words: Sequence[str]) -> ArgumentParser:
    """Return the parser of the command in `words`, or of all commands if there is none."""
    parser = _Parser(
        prog="vibrojax",
        description="Simulate a self-exciting percussive-rotary drill: maps over parameters, single points, pictures.",
        epilog=f"words used in the output:\n{glossary()}",
        allow_abbrev=False,
        formatter_class=RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="store_true", help="print the version")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND")
    asked = next((word for word in words if not word.startswith("-")), "")
    known = _command_of(asked) if asked else None
    for name in [asked] if known else _names():
        command = known or _command_of(name)
        assert command is not None
        subparser = subparsers.add_parser(name, help=command.summary, description=command.summary, allow_abbrev=False)
        if known:
            loudness = either(
                flag("--quiet", "print only errors, warnings and the result"),
                flag("--verbose", "report automatic choices and run times on stderr"),
            )
            for add_arguments in (*command.arguments, loudness):
                add_arguments(subparser)
    return parser


@contextmanager
def _verbosely() -> Iterator[None]:
    """Show the package's log and the duration of the command on stderr."""
    handler, level = logging.StreamHandler(), LOG.level
    handler.setFormatter(logging.Formatter("vibrojax: %(message)s"))
    LOG.addHandler(handler)
    LOG.setLevel(logging.INFO)
    try:
        with timed("all together"):
            yield
    finally:
        LOG.removeHandler(handler)
        LOG.setLevel(level)


def _end(request: BaseException) -> NoReturn:
    """Raise a request to end, both in this thread and in the thread that waits for the work."""
    asked_to_end.append(request)
    raise request


def _say(line: str, status: int) -> int:
    """Print on stderr why the command ended with `status`; return `status`."""
    end_lines()
    sys.stdout.flush()
    _write(line)
    return status


def _write(line: object) -> None:
    """Write on one line of stderr, at once: `print` writes its end separately, and other threads write as well."""
    sys.stderr.write(f"vibrojax: {printable(line, MAX_STDERR_LINE)}\n")
