"""Errors of one line for bad input, and text from files and users made safe to print, embed and paste."""

import json
import re
import shlex
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import SequenceMatcher

_LONGEST_VALUE = 60
_ALIKE = 0.5


class InputError(ValueError):
    """Bad input from a user; its text is one line, shown without a traceback.

    **Example:**

    >>> vj.read_sweep({"scene": "vibro-impact", "grid": {"gama": [0.6, 0.8]}})
    Traceback (most recent call last):
    vibrojax.errors.InputError: sweep: grid.gama: scene "vibro-impact" has no such parameter; did you mean "gamma"?
    """


@dataclass(frozen=True)
class Place:
    """Where in the input something stands: `file` as the user knows it, and the dotted `key` in it."""

    file: str
    key: str = ""

    def at(self, key: str) -> "Place":
        """The place `key` below this one."""
        return Place(self.file, f"{self.key}.{key}" if self.key else key)

    def item(self, index: int) -> "Place":
        """The place of a list's item."""
        return Place(self.file, f"{self.key}[{index}]")

    def error(self, problem: str) -> InputError:
        """An error `FILE: KEY: problem`, on one line whatever the parts contain."""
        parts = (part for part in (self.file, self.key, problem) if part)
        return InputError(" ".join(": ".join(parts).split()))


def shown(value: object) -> str:
    """`value` as it stands in a sweep file, shortened to fit on a line."""
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
    """The one of `words` most like `word`, None where none is alike."""

    def likeness(candidate: str) -> float:
        wanted, offered = word.lower().replace("_", "-"), candidate.lower().replace("_", "-")
        # c1 is as far from c2 as from k1; the first letter decides.
        return SequenceMatcher(None, wanted, offered).ratio() + 0.1 * (wanted[:1] == offered[:1])

    best = max(words, key=likeness, default=None)
    return best if best is not None and likeness(best) >= _ALIKE else None


def suggestion(word: str, words: Iterable[str]) -> str:
    """`did you mean "beta"?`, or all there is to choose from."""
    words = tuple(words)
    best = nearest(word, words)
    if best is not None:
        return f"did you mean {shown(best)}?"
    return f"choose from {', '.join(words)}" if words else "nothing is allowed here"


_HIDDEN = ("Cc", "Cf", "Cs", "Zl", "Zp")
"""Unicode categories of characters that steer a terminal or the direction of text, and of lone surrogates."""

_REPLACEMENT = "\ufffd"
_PLAIN_VALUE = re.compile(r"[A-Za-z0-9 _().,/%+:-]*")


def printable(text: object, longest: int | None = None, keep_spaces: bool = False) -> str:
    """Return a text on one line without control and direction characters, shortened to `longest` characters.

    Runs of spaces become one, unless `keep_spaces`.
    """
    words = str(text)
    if longest is not None:
        words = words[: 4 * longest]  # a text of megabytes is cut before it is looked at
    words = "".join(_REPLACEMENT if _is_hidden(one) and not one.isspace() else one for one in words)
    words = re.sub(r"\s", " ", words) if keep_spaces else " ".join(words.split())
    return words if longest is None or len(words) <= longest else f"{words[: longest - 1].rstrip()}…"


def escape_json(text: str) -> str:
    """Return JSON with control and direction characters as escapes, so that it says the same and steers no terminal."""
    return "".join(json.dumps(one)[1:-1] if one != "\n" and _is_hidden(one) else one for one in text)


def shell_assignment(name: str, value: str) -> str:
    """Return `name=value` as one word of a shell, whatever the value holds."""
    return f'{name}="{value}"' if _PLAIN_VALUE.fullmatch(value) else shlex.quote(f"{name}={value}")


def _is_hidden(character: str) -> bool:
    return not " " <= character <= "~" and unicodedata.category(character) in _HIDDEN
