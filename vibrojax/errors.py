"""One-line errors for invalid input and for functions of users, and strings that are safe to print, embed and paste."""

import json
import re
import shlex
import traceback
import unicodedata
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from difflib import SequenceMatcher
from typing import Any, SupportsInt

_LONGEST_VALUE = 60
"""Greatest number of characters of a value that an error message quotes."""

_LONGEST_KEY = 80
"""Greatest number of characters of a key, which may be the name of a column in a file from others."""

_HIDDEN = ("Cc", "Cf", "Cs", "Zl", "Zp")
"""Unicode categories of control characters, of characters that set the text direction, and of lone surrogates."""

_PLAIN_VALUE = re.compile(r"[A-Za-z0-9 _().,/%+:-]*")

NOT_KNOWN_YET = "uses a function of np on a value that is not known yet; use vj.elementary"

CANNOT_EXPAND = "uses a function that steps cannot expand; use + - * / ** and vj.elementary, not jnp, np or math"


class InputError(ValueError):
    """Invalid input from a user; the command line prints the one-line message without a traceback.

    **Example:**

    >>> vj.read_sweep({"scene": "vibro-impact", "grid": {"gama": [0.6, 0.8]}})
    Traceback (most recent call last):
    vibrojax.errors.InputError: sweep: grid.gama: scene "vibro-impact" has no such parameter; did you mean "gamma"?
    """


@dataclass(frozen=True)
class Place:
    """A location in the input: `file` as the user specified it, and the dotted `key` in that file."""

    file: str
    key: str = ""

    def at(self, key: str) -> "Place":
        """Return the location of `key` in the table at this location."""
        return Place(self.file, f"{self.key}.{key}" if self.key else key)

    def item(self, index: int) -> "Place":
        """Return the location of an item in the list at this location."""
        return Place(self.file, f"{self.key}[{index}]")

    def error(self, problem: str) -> InputError:
        """Return the error `FILE: KEY: problem`, on one line even if the parts contain line breaks."""
        key = self.key if len(self.key) <= _LONGEST_KEY else f"{self.key[: _LONGEST_KEY - 3]}..."
        parts = (part for part in (self.file, key, problem) if part)
        return InputError(" ".join(": ".join(parts).split()))


def shown(value: object) -> str:
    """Return `value` in the notation of sweep files, shortened to fit on a line."""
    if isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, str):
        text = json.dumps(value[: 4 * _LONGEST_VALUE], ensure_ascii=False)
    elif isinstance(value, dict):
        text = "a table"
    elif isinstance(value, (list, tuple)):
        text = "[" + ", ".join(shown(item) for item in value[:_LONGEST_VALUE]) + "]"
    elif isinstance(value, int) and abs(value) >= 10**18:  # str() raises an error beyond 4300 digits
        text = f"a whole number of {value.bit_length() * 30103 // 100000 + 1} digits or so"
    else:
        text = str(value)
        text = f"a {type(value).__name__}" if "\n" in text else text  # a table, or an array of several dimensions
    if len(text) > _LONGEST_VALUE:
        end = '..."' if isinstance(value, str) else "..."
        text = text[: _LONGEST_VALUE - len(end)] + end
    return escape_json(text)


def nearest(word: str, words: Iterable[str]) -> str | None:
    """Return the word of `words` that is most similar to `word`, or None if no word is similar."""

    def similarity(candidate: str) -> float:
        first, second = (text.lower().replace("_", "-") for text in (word, candidate))
        # "c1" is as similar to "c2" as to "k1"; an equal first letter is therefore preferred.
        return SequenceMatcher(None, first, second).ratio() + 0.1 * (first[:1] == second[:1])

    best = max(words, key=similarity, default=None)
    # The default of `difflib` for close matches is 0.6.
    return best if best is not None and similarity(best) >= 0.5 else None


def suggestion(word: str, words: Iterable[str]) -> str:
    """Return a hint such as `did you mean "beta"?`, or the list of all choices if none is similar."""
    words = tuple(words)
    best = nearest(word, words)
    if best is not None:
        return f"did you mean {shown(best)}?"
    return f"choose from {', '.join(words)}" if words else "nothing is allowed here"


def counted(number: SupportsInt, singular: str, plural: str = "") -> str:
    """Return a number with the noun that it counts: "1 lane", "2 lanes"; either form may end in a verb."""
    return f"{number} {singular if number == 1 else plural or singular + 's'}"


def first_line(error: BaseException) -> str:
    """Return the first line of an error's message, or the name of its class if it has none."""
    return (str(error).splitlines() or [type(error).__name__])[0]


def printable(text: object, longest: int | None = None, keep_spaces: bool = False) -> str:
    """Return a string on one line, shortened to `longest` characters.

    Control and text direction characters are replaced. Multiple spaces become one space unless `keep_spaces` is True.
    """
    line = str(text)
    if longest is not None:
        line = line[: 4 * longest]  # a very long string is cut before the characters are checked
    line = "".join("\ufffd" if _is_hidden(char) and not char.isspace() else char for char in line)
    line = re.sub(r"\s", " ", line) if keep_spaces else " ".join(line.split())
    return line if longest is None or len(line) <= longest else f"{line[: longest - 1].rstrip()}…"


def escape_json(text: str) -> str:
    """Return JSON in which control and text direction characters are escaped, so that it is safe on a terminal."""
    return "".join(json.dumps(char)[1:-1] if char != "\n" and _is_hidden(char) else char for char in text)


def shell_assignment(name: str, value: str) -> str:
    """Return `name=value` quoted as a single shell word, for any value."""
    return f'{name}="{value}"' if _PLAIN_VALUE.fullmatch(value) else shlex.quote(f"{name}={value}")


def _is_hidden(character: str) -> bool:
    return not " " <= character <= "~" and unicodedata.category(character) in _HIDDEN


def asked(
    what: str, function: Callable[..., Any], *arguments: Any, known: Iterable[str] = (), written: str = ""
) -> Any:
    """Return the value of a function; `what` names it in messages, and `known` are the names it may ask for.

    `written`: the arguments of the function as a user writes them.

    **Raises:** `InputError` in place of the function's own exceptions.
    """
    try:
        return function(*arguments)
    except InputError:
        raise
    except Exception as error:
        problem = problem_of(error, known)
        if written and isinstance(error, TypeError) and "positional argument" in problem and _called_by_us(error):
            problem = f"takes other arguments; write {what.rpartition(' ')[2]}({written})"
        raise InputError(f"{what} {problem}") from error


def _called_by_us(error: Exception) -> bool:
    """Return whether an exception comes from a call that the package made, not one within a function of a user."""
    *_, (frame, _) = traceback.walk_tb(error.__traceback__)
    return str(frame.f_globals.get("__name__", "")).startswith("vibrojax.")


def number_of(what: str, value: Any) -> Any:
    """Return a number, an array or a series; raise `InputError` for anything else."""
    if isinstance(value, int | float) or hasattr(value, "dtype") or hasattr(value, "value"):
        return value
    raise InputError(f"{what} gave {type(value).__name__}; it must give a number")


def problem_of(error: Exception, known: Iterable[str] = ()) -> str:
    """Return what the exception of a user's function says, as the end of a sentence."""
    text = " ".join(str(error).split("\n")[0].split())
    if isinstance(error, KeyError):
        return f"asks for {error.args[0]!r}; there is {', '.join(known) or 'no such name'}"
    if "truth value" in text or "not supported between instances of" in text or "boolean conversion" in text:
        return "decides by a value (if, max, min or where); use vj.elementary.maximum and minimum, or a vj.Switch"
    if "boolean" in text and "operator" in text:
        return "calculates with a comparison; put a vj.Switch on it, and calculate with its side, which is 1 or -1"
    module: Any = getattr(error, "obj", None)
    if isinstance(error, AttributeError) and getattr(module, "__name__", "").endswith(".elementary"):
        return f"asks for {error.name}; vj.elementary has {', '.join(module.__all__)}"
    if "__array__()" in text:
        return NOT_KNOWN_YET
    if any(part in text for part in ("__array_ufunc__", "scalar", "must be real number", "Series'")):
        return CANNOT_EXPAND
    return f"fails with {type(error).__name__}: {text}"
