"""Sums over complete return intervals, and over complete periods of periodic lanes."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

from vibrojax.lazy import jax, jnp
from vibrojax.measures.gauge import Sums
from vibrojax.physics.arrays import Array, Flags, Lanes, keep

MOST_CYCLES = 8
"""Greatest number of return intervals in a period that can be found."""


class Ledger(NamedTuple):
    """The sums of an observation.

    - `sums`: sums since the first section crossing, by name; `lost`: rounding errors of the sums, in float32 only.
    - `rows`: all sums at the last `MOST_CYCLES` section crossings, newest first, (8, names, lanes).
    """

    sums: Sums
    lost: Sums
    rows: Array


def begin(names: Iterable[str], like: Lanes) -> Ledger:
    """Return a ledger in which the sums `names` are zero; each sum has the shape and dtype of `like`."""
    names = list(names)
    sums: Sums = {name: jnp.zeros_like(like) for name in names}
    lost: Sums = {name: jnp.zeros_like(like) for name in names if like.dtype == jnp.float32}
    return Ledger(sums, lost, jnp.zeros((MOST_CYCLES, len(names), *like.shape), like.dtype))


def add(ledger: Ledger, increments: Sums) -> Ledger:
    """Return the ledger with a step's increments added.

    In float32, the rounding errors of the sums are added at the next step (Kahan 1965). The digits of float64 suffice
    for 1e8 steps.
    """
    if not ledger.lost:
        return ledger._replace(sums={name: total + increments[name] for name, total in ledger.sums.items()})
    # The barriers are needed because XLA may recompute a sum in another fusion. The recomputed sum could then have a
    # different rounding error from the one that is kept.
    more = keep({name: increments[name] + lost for name, lost in ledger.lost.items()})
    sums = keep({name: total + more[name] for name, total in ledger.sums.items()})
    lost = {name: more[name] - (sums[name] - total) for name, total in ledger.sums.items()}
    return ledger._replace(sums=sums, lost=lost)


def section(
    ledger: Ledger, here: Flags, number: Lanes, close: Callable[[Sums], Sums] | None = None
) -> tuple[Ledger, Sums]:
    """Return the ledger after a section crossing of the lanes `here`, and the sums since the previous crossing.

    The sums start at the first crossing (`number` 0). The sums at the last `MOST_CYCLES` crossings are stored, because
    the number of return intervals per period is known only at the end of the observation. `close` maps the sums of the
    return interval that ends to their replacements.
    """
    first = here & (number == 0)
    sums, lost = (_without(ledger.sums, first), _without(ledger.lost, first))
    before: Sums = dict(zip(sums, ledger.rows[0], strict=True))
    since = keep({name: total - before[name] for name, total in sums.items()})
    closed = close(since) if close is not None else {}
    sums |= {name: jnp.where(here, before[name] + x, sums[name]) for name, x in closed.items()}
    lost |= _without({name: lost[name] for name in closed if name in lost}, here)
    now = keep(jnp.stack(list(sums.values())))
    shifted = jnp.concatenate([now[None], ledger.rows[:-1]])
    return Ledger(sums, lost, jnp.where(here[None, None], shifted, ledger.rows)), since


def _without(sums: Sums, here: Flags) -> Sums:
    """Return the sums, set to zero in the lanes `here`."""
    return {name: jnp.where(here, 0, total) for name, total in sums.items()}


def whole(ledger: Ledger, returns: Lanes, cycles: Lanes) -> "tuple[Sums, jax.Array]":
    """Return the sums over the greatest number of return intervals that form complete periods, and that number.

    `returns`: number of section crossings; `cycles`: return intervals per period; 0 means that all intervals are used.
    """
    intervals = jnp.maximum(returns - 1, 0)
    rest = jnp.where(cycles > 0, intervals % jnp.maximum(cycles, 1), 0)
    picked = ledger.rows[0]
    for row in range(1, MOST_CYCLES):
        picked = jnp.where((rest == row)[None], ledger.rows[row], picked)
    return dict(zip(ledger.sums, picked, strict=True)), intervals - rest
