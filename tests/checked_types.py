"""The type checks of the package in tests: annotations, with shapes and types of arrays (see `conftest.py`)."""

import dataclasses
import functools
import inspect
import typing

import jaxtyping
from beartype import beartype

CONTEXT = jaxtyping.jaxtyped("context")


def checked(thing=None, *, typechecker=None):
    """Return a function or dataclass with its annotations checked at each call, all of them in one pass.

    This takes the place of the decorator of jaxtyping's import hook, which checks arguments twice to say more of an
    error, and which writes the checks of nested functions anew at each call of the outer one. Nested functions and
    generators are not checked.
    """
    if thing is None:
        return checked
    if inspect.isclass(thing):
        if dataclasses.is_dataclass(thing) and "__init__" in vars(thing):
            thing.__init__ = checked(thing.__init__)
        return thing
    for kind in (classmethod, staticmethod):
        if isinstance(thing, kind):
            return kind(checked(thing.__func__))
    if isinstance(thing, property):
        return property(*(part and checked(part) for part in (thing.fget, thing.fset, thing.fdel)))
    # A generator's arguments are checked where its first value is taken, among the dimensions of another call.
    if "<locals>" in thing.__qualname__ or inspect.isgeneratorfunction(thing):
        return thing
    strict = None  # until the first call: of most functions, a process calls few

    @functools.wraps(thing)
    def call(*args, **kwargs):
        nonlocal strict
        if jaxtyping.config.jaxtyping_disable:
            return thing(*args, **kwargs)
        if strict is None:
            strict = beartype(thing) if annotations_are_known(thing) else thing
        with CONTEXT:  # a name of a dimension means one number in a call
            return strict(*args, **kwargs)

    return call


def annotations_are_known(function):
    """Return whether all annotations can be evaluated; those of modules that only type checkers import cannot."""
    try:
        typing.get_type_hints(function, include_extras=True)
    except NameError:
        return False
    return True
