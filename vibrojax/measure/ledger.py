"""Sums over whole returns to the section, and over whole repeats of lanes that repeat."""

import jax.numpy as jnp

from vibrojax.stepping import keep

MOST_CYCLES = 8
"""Repeats are looked for up to this many returns."""


def begin(names, like) -> dict:
    """An empty ledger of the sums called `names`, lanes shaped as `like`."""
    return {
        "sums": {name: jnp.zeros_like(like) for name in names},
        "lost": {name: jnp.zeros_like(like) for name in names if like.dtype == jnp.float32},
        "rows": jnp.zeros((MOST_CYCLES, len(names), *like.shape), like.dtype),
    }


def add(ledger: dict, increments: dict) -> dict:
    """The ledger with a step's increments added.

    In float32 what rounding lost of them is kept for the next (Kahan 1965); float64 has digits enough for 1e8 steps.
    """
    if not ledger["lost"]:
        return ledger | {"sums": {name: total + increments[name] for name, total in ledger["sums"].items()}}
    # Barriers: worked out again in another fusion, a sum may be rounded otherwise, and what it lost would be wrong.
    more = keep({name: increments[name] + lost for name, lost in ledger["lost"].items()})
    sums = keep({name: total + more[name] for name, total in ledger["sums"].items()})
    lost = {name: more[name] - (sums[name] - total) for name, total in ledger["sums"].items()}
    return ledger | {"sums": sums, "lost": lost}


def section(ledger: dict, here, number) -> tuple[dict, dict]:
    """The ledger after a return, and what was summed since the return before.

    Sums start at the first return (`number` 0). The last `MOST_CYCLES` returns keep theirs, newest first, because how
    many returns make a repeat is known only at the end.
    """
    first = here & (number == 0)
    sums, lost = (
        {name: jnp.where(first, 0, total) for name, total in ledger[part].items()} for part in ("sums", "lost")
    )
    now = keep(jnp.stack(list(sums.values())))
    since = dict(zip(sums, now - ledger["rows"][0], strict=True))
    shifted = jnp.concatenate([now[None], ledger["rows"][:-1]])
    return {"sums": sums, "lost": lost, "rows": jnp.where(here[None, None], shifted, ledger["rows"])}, since


def whole(ledger: dict, returns, cycles) -> tuple[dict, jnp.ndarray]:
    """Sums over the most returns that make whole repeats of `cycles` (0: all returns), and their number."""
    intervals = jnp.maximum(returns - 1, 0)
    rest = jnp.where(cycles > 0, intervals % jnp.maximum(cycles, 1), 0)
    picked = ledger["rows"][0]
    for row in range(1, MOST_CYCLES):
        picked = jnp.where((rest == row)[None], ledger["rows"][row], picked)
    return dict(zip(ledger["sums"], picked, strict=True)), intervals - rest
