"""Calls of functions that users wrote: a mistake in them ends in one line that names the function."""

from collections.abc import Callable, Iterable
from typing import Any

from vibrojax.errors import InputError

CANNOT_EXPAND = "uses a function that steps cannot expand; use + - * / ** and vj.elementary, not jnp, np or math"


def asked(what: str, function: Callable[..., Any], *arguments: Any, known: Iterable[str] = ()) -> Any:
    """Return the value of a function; `what` names it in messages, and `known` are the names it may ask for.

    **Raises:** `InputError` in place of the function's own exceptions.
    """
    try:
        return function(*arguments)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{what} {problem_of(error, known)}") from error


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
        return "decides by a value (if, max or min); use vj.elementary.maximum and minimum"
    if "__array_ufunc__" in text or "scalar arrays" in text or "must be real number" in text:
        return CANNOT_EXPAND
    return f"fails with {type(error).__name__}: {text}"
