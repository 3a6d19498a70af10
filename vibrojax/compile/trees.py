"""Pytrees of kernels, taken apart without importing jax.

Containers are tuples, named tuples, lists, dicts and None. Numbers and numpy arrays are leaves. Any other object is
left to jax. Leaves have the same order as in jax: those of a dict in the order of its sorted keys.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from vibrojax.lazy import jax

_LEAF_TYPES = (np.ndarray, np.generic, int, float, complex, str)
"""Types that are leaves for jax as well."""


class Structure(NamedTuple):
    """Structure of a pytree, hashable.

    - `kind`: class of the container, None for a leaf, or jax's own structure of an object that was left to jax.
    - `keys`: sorted keys of a dict; `parts`: structures of the items.
    """

    kind: Any = None
    keys: tuple[Any, ...] = ()
    parts: tuple["Structure", ...] = ()


_LEAF = Structure()


def flatten(tree: Any) -> tuple[list[Any], Structure]:
    """Return the leaves of a pytree, and its structure."""
    leaves: list[Any] = []
    return leaves, _structure(tree, leaves)


def _structure(x: Any, leaves: list[Any]) -> Structure:
    if x is None:
        return Structure(type(x))
    if type(x) is dict:
        keys = tuple(sorted(x))
        return Structure(dict, keys, tuple(_structure(x[key], leaves) for key in keys))
    if type(x) in (tuple, list) or (isinstance(x, tuple) and hasattr(x, "_fields")):
        return Structure(type(x), (), tuple(_structure(item, leaves) for item in x))
    if not isinstance(x, _LEAF_TYPES):
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
