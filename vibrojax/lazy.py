"""Large libraries, imported when they are first used.

Importing jax takes longer than showing a dataset or listing scenes. The modules of this package therefore import `jax`,
`jnp` and `lax` from here, so that importing any of them does not import jax, and likewise pandas, matplotlib and parts
of SciPy. They use these libraries within functions only: not in decorators, default values or tables. Annotations that
name them are strings.

A sweep whose kernels are cached never uses jax. A thread that sets the precision before it uses jax leaves the settings
in `pending`, and makes them when it first reads an attribute of `jax`, `jnp` or `lax`.
"""

import threading
from collections.abc import Callable
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

__all__ = ["colors", "jax", "jnp", "lax", "linalg", "optimize", "pd", "pending", "qmc", "ticker"]


class _OnFirstUse:
    """A module that is imported when one of its attributes is first read."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._module: ModuleType | None = None

    def __getattr__(self, attribute: str) -> Any:
        if self._module is None:
            import_module(self._name.partition(".")[0])  # importing both at once in two threads ends in a deadlock
            self._module = import_module(self._name)
        return getattr(self._module, attribute)


class _Pending(threading.local):
    """Settings of jax that a thread has not made yet: its `precision`, and the function that makes them, or None."""

    precision = ""
    enter: Callable[[], None] | None = None


pending = _Pending()


class _Jax(_OnFirstUse):
    """A module of jax, which is used with the settings of the thread."""

    def __getattr__(self, attribute: str) -> Any:
        if pending.enter is not None:
            enter, pending.enter = pending.enter, None
            enter()
        return super().__getattr__(attribute)


if TYPE_CHECKING:
    import jax
    import jax.numpy as jnp
    import pandas as pd
    from jax import lax
    from matplotlib import colors, ticker
    from scipy import linalg, optimize
    from scipy.stats import qmc
else:
    jax, jnp, lax = map(_Jax, ("jax", "jax.numpy", "jax.lax"))
    pd, colors, ticker = map(_OnFirstUse, ("pandas", "matplotlib.colors", "matplotlib.ticker"))
    linalg, optimize, qmc = map(_OnFirstUse, ("scipy.linalg", "scipy.optimize", "scipy.stats.qmc"))
