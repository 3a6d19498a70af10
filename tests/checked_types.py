"""The type checker that the tests' import hook applies to the package (see `conftest.py`)."""

from beartype import beartype


def checked(function):
    """Return the function with its annotations checked at each call.

    Nested functions are not checked: they are made anew at each call, and to write the code of their checks takes a
    millisecond each time: a sixth of the processor time of the tests of borders and of single motions.
    """
    return function if "<locals>" in getattr(function, "__qualname__", "") else beartype(function)
