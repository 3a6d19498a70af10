"""Loops together with the derivatives of their carries along several directions.

`jax.vmap` of `jax.jvp` of `jax.lax.while_loop` has the same result. But jax then traces the loop's body six times, to
find the parts of the carry that have a derivative. Here the caller names these parts, and the body is traced once.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeVar

from vibrojax.lazy import jax, jnp
from vibrojax.physics.arrays import Array, Flags

X = TypeVar("X")
Y = TypeVar("Y")
Tangents = list[Array | None]
"""Derivatives of the leaves of a pytree, each with a leading axis of directions; None for a leaf without any."""


class Loop(NamedTuple):
    """A `while` loop, as a function of `x`.

    - `begin(x)`: return (constants of the loop, first carry). `advance(constants, carry)`: return the next carry.
    - `continues(carry)`: return True while the loop continues.
    - `varies(carry)`: return the parts of the carry that have a derivative.
    """

    begin: Callable[[Any], tuple[Any, Any]]
    advance: Callable[[Any, Any], Any]
    continues: Callable[[Any], Flags]
    varies: Callable[[Any], Any]

    def run(self, x: Any) -> Any:
        """Return the last carry."""
        constants, first = self.begin(x)
        return jax.lax.while_loop(self.continues, partial(self.advance, constants), first)

    def with_tangents(self, directions: Any) -> "Loop":
        """Return the loop whose carry is (carry, its derivatives with respect to `x`).

        The derivatives have a leading axis of directions, and None in place of leaves that have none. The new loop can
        be differentiated in the same way, for second derivatives.

        `directions`: like `x`, with a leading axis, and None in place of leaves that do not vary.
        """

        def begin(x: Any) -> tuple[Any, Any]:
            changes = _leaves_like(x, directions)
            count = next(len(change) for change in changes if change is not None)
            (constants, first), began = _derivatives(self.begin, [x], changes)
            number = len(jax.tree.leaves(constants))
            leaves, tree = jax.tree.flatten(first)
            named = set(jax.tree.leaves(self.varies(jax.tree.unflatten(tree, range(len(leaves))))))  # indices of leaves
            moved: Tangents = [
                (jnp.zeros((count, *leaf.shape), leaf.dtype) if own is None else own) if index in named else None
                for index, (leaf, own) in enumerate(zip(leaves, began[number:], strict=True))
            ]
            return (constants, began[:number]), (first, jax.tree.unflatten(tree, moved))

        def advance(given: Any, both: Any) -> Any:
            (constants, of_constants), (carry, tangents) = given, both
            moved = _leaves_like(carry, tangents)
            after, changed = _derivatives(self.advance, [constants, carry], [*of_constants, *moved])
            for index, before in enumerate(moved):
                if before is None:
                    assert changed[index] is None, "a part of the carry has a derivative that `varies` does not name"
                elif changed[index] is None:
                    changed[index] = jnp.zeros_like(before)
            return after, jax.tree.unflatten(jax.tree.structure(carry), changed)

        return Loop(begin, advance, lambda both: self.continues(both[0]), lambda both: (self.varies(both[0]), both[1]))


def with_derivatives(tree: X) -> X:
    """Return a pytree, all of whose real leaves have derivatives once it is differentiated, if only of 0.

    `jax.jvp` of a loop traces the loop's body again for each part of the carry that turns out to have a derivative. A
    first carry in which these parts have derivatives saves that.
    """
    leaves, structure = jax.tree.flatten(tree)
    identity: Any = jax.custom_jvp(lambda reals: reals)
    identity.defjvp(lambda primals, tangents: (*primals, *tangents))  # zeros are arrays here
    real = iter(identity([leaf for leaf in leaves if _is_real(leaf)]))
    return jax.tree.unflatten(structure, [next(real) if _is_real(leaf) else leaf for leaf in leaves])


def _derivatives(function: Callable[..., Y], inputs: Sequence[Any], moved: Tangents) -> tuple[Y, Tangents]:
    """Return the function's result, and the derivatives of its leaves if the leaves of the inputs move by `moved`."""
    leaves, tree = jax.tree.flatten(inputs)
    active = [index for index, own in enumerate(moved) if own is not None]
    zero: list[bool] = []
    results: list[Any] = []
    outcome = tree

    @jax.custom_jvp
    def recorded(values: list[Array]) -> list[Array]:
        return values

    @partial(recorded.defjvp, symbolic_zeros=True)
    def record_zeros(primals: Any, tangents: Any) -> tuple[list[Array], list[Array]]:
        (values,), (slopes,) = primals, tangents
        zero[:] = [isinstance(slope, jax.custom_derivatives.SymbolicZero) for slope in slopes]
        pairs = zip(values, slopes, zero, strict=True)
        return values, [jnp.zeros_like(value) if none else slope for value, slope, none in pairs]

    def of_active(varied: list[Array]) -> tuple[list[Array], list[Array]]:
        nonlocal outcome
        whole = list(leaves)
        for index, leaf in zip(active, varied, strict=True):
            whole[index] = leaf
        results[:], outcome = jax.tree.flatten(function(*jax.tree.unflatten(tree, whole)))
        zero[:] = [True] * sum(map(_is_real, results))
        discrete: list[Array] = [leaf for leaf in results if isinstance(leaf, jax.Array) and not _is_real(leaf)]
        return recorded([leaf for leaf in results if _is_real(leaf)]), discrete

    def along(tangents: list[Array]) -> Any:
        return jax.jvp(of_active, ([leaves[index] for index in active],), (tangents,), has_aux=True)

    tangents = [own for own in moved if own is not None]
    if len(tangents[0]) == 1:  # without `vmap`, jax traces in three quarters of the time
        reals, slopes, discretes = along([x[0] for x in tangents])
        slopes = [x[None] for x in slopes]
    else:
        reals, slopes, discretes = jax.vmap(along, out_axes=(None, 0, None))(tangents)
    derivatives = iter([None if none else slope for slope, none in zip(slopes, zero, strict=True)])
    changed = [next(derivatives) if _is_real(leaf) else None for leaf in results]
    real, discrete = iter(reals), iter(discretes)
    values = [
        next(real) if _is_real(leaf) else next(discrete) if isinstance(leaf, jax.Array) else leaf for leaf in results
    ]
    return jax.tree.unflatten(outcome, values), changed


def _leaves_like(tree: Any, tangents: Any) -> Tangents:
    """Return the leaves of a pytree of derivatives, None included, in the order of the leaves of `tree`."""
    structure: Any = jax.tree.structure(tree)
    leaves: Tangents = structure.flatten_up_to(tangents)
    return leaves


def _is_real(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jnp.floating)
