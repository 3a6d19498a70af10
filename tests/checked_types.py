"""Type checks of the package in tests: annotations with the shapes and types of arrays (see `conftest.py`)."""

import dataclasses
import functools
import inspect
import threading
import typing
from importlib.machinery import SourceFileLoader
from unittest.mock import patch

import jaxtyping
from beartype import beartype
from jaxtyping import _import_hook

CONTEXT = jaxtyping.jaxtyped("context")

FULLY_CHECKED_CALLS, CALLS_PER_CHECK = 8, 50
"""The first calls of a function are checked, and then one in so many: checks of every call take a third of the time of
the tests, and a wrong annotation is wrong at one of the first calls."""

ONE_THREAD = threading.Lock()


def load_in_threads():
    """Let two threads import modules of the package at once: one at a time reads and compiles, and modules run without
    the lock. CPython before 3.11.9 and 3.12.3 fails if two build syntax trees (python/cpython#106905). And jaxtyping's
    loader replaces a function of importlib while it runs a module, which a second thread would restore too early."""

    def get_code(loader, name):
        cache = functools.partial(_import_hook._optimized_cache_from_source, loader._typechecker.get_hash())
        with ONE_THREAD, patch("importlib._bootstrap_external.cache_from_source", cache):
            return SourceFileLoader.get_code(loader, name)

    _import_hook._JaxtypingLoader.get_code = get_code
    _import_hook._JaxtypingLoader.exec_module = SourceFileLoader.exec_module


def checked(thing=None, *, typechecker=None):
    """Return a function or dataclass that checks all its annotations in one pass at each call. The decorator of
    jaxtyping's import hook, which it replaces, checks arguments twice, and rewrites the checks of nested functions at
    each call of the outer one. Nested functions and generators are not checked."""
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
    # A generator would check its arguments only with its first value, among the dimensions of another call.
    if "<locals>" in thing.__qualname__ or inspect.isgeneratorfunction(thing):
        return thing
    calls = 0

    @functools.cache  # at the first call, because a process calls few of the functions
    def strict():
        try:
            hints = typing.get_type_hints(thing, include_extras=True)
        except NameError:  # an import for type checkers only
            return thing
        return thing if "typing.Self" in str(hints) else beartype(thing)

    @functools.wraps(thing)
    def call(*args, **kwargs):
        nonlocal calls
        calls += 1
        if (calls > FULLY_CHECKED_CALLS and calls % CALLS_PER_CHECK) or jaxtyping.config.jaxtyping_disable:
            return thing(*args, **kwargs)
        with CONTEXT:  # a dimension's name means one number within a call
            return strict()(*args, **kwargs)

    return call
