"""Kernels made once, by whichever thread wants one first."""

import threading
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.compile.kernels import native
from vibrojax.compile.kernels.kernel import Kernel


class _Key(NamedTuple):
    function: Callable[..., Any]
    static: tuple[Hashable, ...]
    types: tuple[Hashable, ...]


kernels: dict[_Key, Kernel] = {}
"""All that were made in this process."""

_making: dict[_Key, threading.Lock] = {}
_lock = threading.Lock()


def run(function: Callable[..., Any], static: tuple[Hashable, ...], *arguments: Any, registers: int = 1) -> Any:
    """Return `function(*static, *arguments)` by the kernel for such arguments; see `made`."""
    return made(function, static, *arguments, registers=registers)(*arguments)


def made(function: Callable[..., Any], static: tuple[Hashable, ...], *arguments: Any, registers: int = 1) -> Kernel:
    """Return the kernel of `function(*static, *arguments)` for such arguments, which is made if there is none yet.

    **Arguments:** `registers`: see `Kernel`.

    **Raises:** `Untranslatable` if the function does what no kernel can do.
    """
    leaves, tree = jax.tree.flatten(arguments)
    types = (jnp.result_type(float), native.vector_bytes(), tree, *map(_type, leaves))
    key = _Key(function, static, types)
    with _lock:
        making = _making.setdefault(key, threading.Lock())
    with making:
        if key not in kernels:
            kernels[key] = Kernel(lambda *given: function(*static, *given), *arguments, registers=registers)
    return kernels[key]


def _type(x: Any) -> Hashable:
    dtype = x.dtype if hasattr(x, "dtype") else np.result_type(x)
    return dtype, np.shape(x)[:-1], np.ndim(x)
