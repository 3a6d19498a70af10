"""The one line with which a call or a command is refused."""

from collections.abc import Callable
from typing import Any

import pytest

from vibrojax.cli import main
from vibrojax.errors import InputError


def refusal(call: Callable[..., object], *arguments: Any, **named: Any) -> str:
    """Return the line in which a call refuses its arguments."""
    with pytest.raises(InputError) as caught:
        call(*arguments, **named)
    line = str(caught.value)
    assert line and "\n" not in line
    return line


def command_refusal(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """Return the only line that a refused command prints, without its name."""
    capsys.readouterr()
    assert main([*map(str, words)]) == 2
    out, line = capsys.readouterr()
    assert out == "" and line.count("\n") == 1
    return line.removeprefix("vibrojax: ").rstrip("\n")
