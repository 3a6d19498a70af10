"""Texts from files and users: made safe to print, to embed and to paste into a shell."""

import json
import re
import shlex
import unicodedata

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
