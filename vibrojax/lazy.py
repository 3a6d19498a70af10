"""Large libraries, imported when they are first used.

Importing jax takes longer than showing a dataset or listing scenes. The modules of this package therefore import `jax`,
`jnp` and `lax` from here, so that importing any of them does not import jax, and likewise pandas, matplotlib and parts
of SciPy. They use these libraries within functions only: not in decorators, default values or tables. Annotations that
name them are strings.
"""

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

__all__ = ["colors", "jax", "jnp", "lax", "linalg", "optimize", "pd", "qmc", "ticker"]


class _OnFirstUse:
    """A module that is imported when one of its attributes is first read."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._module: ModuleType | None = None

    def __getattr__(self, attribute: str) -> Any:
        if self._module is None:
            self._module = import_module(self._name)
        return getattr(self._module, attribute)


if TYPE_CHECKING:
    import jax
    import jax.numpy as jnp
    import pandas as pd
    from jax import lax
    from matplotlib import colors, ticker
    from scipy import linalg, optimize
    from scipy.stats import qmc
else:
    jax, jnp, lax = map(_OnFirstUse, ("jax", "jax.numpy", "jax.lax"))
    pd, colors, ticker = map(_OnFirstUse, ("pandas", "matplotlib.colors", "matplotlib.ticker"))
    linalg, optimize, qmc = map(_OnFirstUse, ("scipy.linalg", "scipy.optimize", "scipy.stats.qmc"))
