"""Sums over whole returns to the section, and over whole repeats of lanes that repeat."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from vibrojax.measures.gauge import Sums
from vibrojax.models.arrays import Array, Flags, Lanes, keep

MOST_CYCLES = 8
"""Greatest number of returns of a repeat."""


class Ledger(NamedTuple):
    """The sums of an observation.

    - `sums`: by name, since the first return; `lost`: their rounding errors, in float32 only.
    - `rows`: all sums at the last `MOST_CYCLES` returns, newest first, (8, names, lanes).
    """

    sums: Sums
    lost: Sums
    rows: Array


def begin(names: Iterable[str], like: Lanes) -> Ledger:
    """Return an empty ledger of the sums `names`, with lanes shaped like `like`."""
    names = list(names)
    sums: Sums = {name: jnp.zeros_like(like) for name in names}
    lost: Sums = {name: jnp.zeros_like(like) for name in names if like.dtype == jnp.float32}
    return Ledger(sums, lost, jnp.zeros((MOST_CYCLES, len(names), *like.shape), like.dtype))


def add(ledger: Ledger, increments: Sums) -> Ledger:
    """Return the ledger with a step's increments added.

    In float32 their rounding errors are added at the next step (Kahan 1965); float64 has digits enough for 1e8 steps.
    """
    if not ledger.lost:
        return ledger._replace(sums={name: total + increments[name] for name, total in ledger.sums.items()})
    # Barriers: recomputed in another fusion, a sum may round differently from the one whose error is kept.
    more = keep({name: increments[name] + lost for name, lost in ledger.lost.items()})
    sums = keep({name: total + more[name] for name, total in ledger.sums.items()})
    lost = {name: more[name] - (sums[name] - total) for name, total in ledger.sums.items()}
    return ledger._replace(sums=sums, lost=lost)


def section(
    ledger: Ledger, here: Flags, number: Lanes, close: Callable[[Sums], Sums] | None = None
) -> tuple[Ledger, Sums]:
    """Return the ledger after a return, and the sums since the return before.

    Sums start at the first return (`number` 0). The last `MOST_CYCLES` returns keep theirs, newest first, because the
    end of the observation decides how many returns make a repeat. `close` maps the sums of the return that ends to
    their replacements.
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
    """Return the sums, zero where `here`."""
    return {name: jnp.where(here, 0, total) for name, total in sums.items()}


def whole(ledger: Ledger, returns: Lanes, cycles: Lanes) -> tuple[Sums, jax.Array]:
    """Return the sums over the most returns that make whole repeats of `cycles` (0: all), and their number."""
    intervals = jnp.maximum(returns - 1, 0)
    rest = jnp.where(cycles > 0, intervals % jnp.maximum(cycles, 1), 0)
    picked = ledger.rows[0]
    for row in range(1, MOST_CYCLES):
        picked = jnp.where((rest == row)[None], ledger.rows[row], picked)
    return dict(zip(ledger.sums, picked, strict=True)), intervals - rest
