"""One-line errors for bad input; text from files and users made safe to print, embed and paste."""

import json
import re
import shlex
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import SequenceMatcher

_LONGEST_VALUE = 60
"""Characters of a value that an error quotes."""

_SIMILARITY = 0.5
"""Least similarity of a suggestion to the word that it replaces; `difflib` calls 0.6 a close match."""

_HIDDEN = ("Cc", "Cf", "Cs", "Zl", "Zp")
"""Unicode categories of characters that control a terminal or the direction of text, and of lone surrogates."""

_REPLACEMENT = "\ufffd"
_PLAIN_VALUE = re.compile(r"[A-Za-z0-9 _().,/%+:-]*")


class InputError(ValueError):
    """Invalid input from a user; the command prints its single line without a traceback.

    **Example:**

    >>> vj.read_sweep({"scene": "vibro-impact", "grid": {"gama": [0.6, 0.8]}})
    Traceback (most recent call last):
    vibrojax.errors.InputError: sweep: grid.gama: scene "vibro-impact" has no such parameter; did you mean "gamma"?
    """


@dataclass(frozen=True)
class Place:
    """A location in the input: `file` as the user knows it, and the dotted `key` in it."""

    file: str
    key: str = ""

    def at(self, key: str) -> "Place":
        """Return the place of `key` in the table at this place."""
        return Place(self.file, f"{self.key}.{key}" if self.key else key)

    def item(self, index: int) -> "Place":
        """Return the place of an item of the list at this place."""
        return Place(self.file, f"{self.key}[{index}]")

    def error(self, problem: str) -> InputError:
        """Return the error `FILE: KEY: problem`, on one line for any content of the parts."""
        parts = (part for part in (self.file, self.key, problem) if part)
        return InputError(" ".join(": ".join(parts).split()))


def shown(value: object) -> str:
    """Return `value` as a sweep file writes it, shortened to fit on a line."""
    if isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, str):
        text = json.dumps(value[: 4 * _LONGEST_VALUE], ensure_ascii=False)
    elif isinstance(value, dict):
        text = "a table"
    elif isinstance(value, (list, tuple)):
        text = "[" + ", ".join(shown(item) for item in value[:_LONGEST_VALUE]) + "]"
    elif isinstance(value, int) and abs(value) >= 10**18:  # str() refuses over 4300 digits
        text = f"a whole number of {value.bit_length() * 30103 // 100000 + 1} digits or so"
    else:
        text = str(value)
    text = text if len(text) <= _LONGEST_VALUE else text[: _LONGEST_VALUE - 3] + "..."
    return escape_json(text)


def nearest(word: str, words: Iterable[str]) -> str | None:
    """Return the most similar one of `words`, None if none is similar."""

    def similarity(candidate: str) -> float:
        first, second = (text.lower().replace("_", "-") for text in (word, candidate))
        # c1 is as far from c2 as from k1; the first letter decides.
        return SequenceMatcher(None, first, second).ratio() + 0.1 * (first[:1] == second[:1])

    best = max(words, key=similarity, default=None)
    return best if best is not None and similarity(best) >= _SIMILARITY else None


def suggestion(word: str, words: Iterable[str]) -> str:
    """Return `did you mean "beta"?`, or the list of all choices if none is similar."""
    words = tuple(words)
    best = nearest(word, words)
    if best is not None:
        return f"did you mean {shown(best)}?"
    return f"choose from {', '.join(words)}" if words else "nothing is allowed here"


def printable(text: object, longest: int | None = None, keep_spaces: bool = False) -> str:
    """Return a text on one line without control and direction characters, shortened to `longest` characters.

    Runs of spaces become one, unless `keep_spaces`.
    """
    line = str(text)
    if longest is not None:
        line = line[: 4 * longest]  # a text of megabytes is cut before it is searched
    line = "".join(_REPLACEMENT if _is_hidden(char) and not char.isspace() else char for char in line)
    line = re.sub(r"\s", " ", line) if keep_spaces else " ".join(line.split())
    return line if longest is None or len(line) <= longest else f"{line[: longest - 1].rstrip()}…"


def escape_json(text: str) -> str:
    """Return JSON with control and direction characters as escapes: the same content, safe on a terminal."""
    return "".join(json.dumps(char)[1:-1] if char != "\n" and _is_hidden(char) else char for char in text)


def shell_assignment(name: str, value: str) -> str:
    """Return `name=value` as one word of a shell, for any value."""
    return f'{name}="{value}"' if _PLAIN_VALUE.fullmatch(value) else shlex.quote(f"{name}={value}")


def _is_hidden(character: str) -> bool:
    return not " " <= character <= "~" and unicodedata.category(character) in _HIDDEN
