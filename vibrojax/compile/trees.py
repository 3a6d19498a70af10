"""Pytrees without jax, whose import takes longer than small sweeps whose kernels are cached.

Containers are those of programs: tuples, named tuples, lists, dicts and None. jax takes apart all other objects that
are no numbers or numpy arrays. Leaves have the same order as in jax: those of a dict in the order of sorted keys.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from vibrojax.lazy import jax

_NUMBERS = (np.ndarray, np.generic, bool, int, float, complex, str)
"""Types that are leaves in jax, too."""


class Structure(NamedTuple):
    """A pytree without its leaves.

    - `kind`: class of the container, jax's structure of an object that jax took apart, or None for a leaf.
    - `keys`: sorted keys of a dict; `parts`: structures of the items.
    """

    kind: Any = None
    keys: tuple[Any, ...] = ()
    parts: tuple["Structure", ...] = ()


_LEAF = Structure()


def flatten(tree: Any) -> tuple[list[Any], Structure]:
    """Return the leaves of a pytree, and its structure, which is hashable."""
    leaves: list[Any] = []
    return leaves, _structure(tree, leaves)


def _structure(x: Any, leaves: list[Any]) -> Structure:
    """Return the structure of a pytree and append its leaves."""
    if x is None:
        return Structure(type(x))
    if type(x) is dict:
        keys = tuple(sorted(x))
        return Structure(dict, keys, tuple(_structure(x[key], leaves) for key in keys))
    if type(x) in (tuple, list) or (isinstance(x, tuple) and hasattr(x, "_fields")):
        return Structure(type(x), (), tuple(_structure(item, leaves) for item in x))
    if not isinstance(x, _NUMBERS):
        parts, structure = jax.tree.flatten(x)
        if not jax.tree_util.treedef_is_leaf(structure):
            leaves.extend(parts)
            return Structure(structure)
    leaves.append(x)
    return _LEAF


def unflatten(structure: Structure, leaves: Iterator[Any] | list[Any]) -> Any:
    """Return the pytree with this structure and these leaves."""
    kind, rest = structure.kind, iter(leaves)
    if kind is None:
        return next(rest)
    if kind is type(None):
        return None
    if not isinstance(kind, type):
        return jax.tree.unflatten(kind, [next(rest) for _ in range(kind.num_leaves)])
    items = [unflatten(part, rest) for part in structure.parts]
    if kind is dict:
        return dict(zip(structure.keys, items, strict=True))
    return kind(*items) if hasattr(kind, "_fields") else kind(items)


def map_leaves(function: Callable[..., Any], tree: Any, *others: Any) -> Any:
    """Return the pytree of the results of `function`, called with each leaf and those of `others` at its place."""
    leaves, structure = flatten(tree)
    columns = [flatten(other)[0] for other in others]
    return unflatten(structure, [function(*x) for x in zip(leaves, *columns, strict=True)])
