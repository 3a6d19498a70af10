"""Multipliers of the constraints that hold a motion on surfaces: one linear system for all that hold at once."""

import itertools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from vibrojax.lazy import jnp
from vibrojax.systems.numbers import array_of

Rates = dict[str, Any]
"""Time derivatives of the states by name."""


class Constraint(NamedTuple):
    """A constraint that may hold the motion on the surface of an event.

    - `held`: 1 where it holds, else 0; `along`: the direction in which it acts, by name of the states.
    - `drift`: change of what it keeps at zero, without any multiplier; `gain`: its change per own multiplier.
    """

    held: Any
    along: Rates
    drift: Any
    gain: Any


def solved(
    constraints: Mapping[int, Constraint], coupled: frozenset[tuple[int, int]], effect: Callable[[int, int], Any]
) -> tuple[dict[int, Any], dict[int, Any]]:
    """Return the multipliers of constraints, zero where they do not hold, and their drifts due to all others.

    **Arguments:** `coupled`: pairs of constraints of which the second changes what the first keeps at zero;
    `effect(first, second)`: that change per multiplier.
    """
    multipliers: dict[int, Any] = {}
    drifts = {index: own.drift for index, own in constraints.items()}
    groups = _groups(constraints, coupled)
    for group in groups:
        effects = {(i, j): effect(i, j) for i in group for j in group if i != j and (i, j) in coupled}
        rows = {
            i: {j: constraints[i].held * constraints[j].held * effects[i, j] for j in group if (i, j) in effects}
            for i in group
        }
        for i in group:
            rows[i][i] = constraints[i].gain
        right = {i: -constraints[i].held * constraints[i].drift for i in group}
        for place, k in enumerate(group):  # Gauss
            rows[k][k] = _unless_zero(rows[k][k], constraints[k].held)
            for i in group[place + 1 :]:
                if k in rows[i]:
                    factor = rows[i].pop(k) / rows[k][k]
                    right[i] = right[i] - factor * right[k]
                    for j, x in rows[k].items():
                        if j != k:
                            rows[i][j] = rows[i][j] - factor * x if j in rows[i] else -factor * x
        for k in reversed(group):
            rest = right[k]
            for j, x in rows[k].items():
                if j != k:
                    rest = rest - x * multipliers[j]
            multipliers[k] = rest / rows[k][k]
        for (i, j), x in effects.items():
            drifts[i] = drifts[i] + x * multipliers[j]
    return multipliers, drifts


def _groups(constraints: Mapping[int, Constraint], coupled: frozenset[tuple[int, int]]) -> list[list[int]]:
    """Return the constraints in groups, such that those of different groups are not coupled."""
    groups: list[list[int]] = []
    for index in constraints:
        joined = [group for group in groups if any((i, index) in coupled or (index, i) in coupled for i in group)]
        groups = [group for group in groups if group not in joined]
        groups.append([*itertools.chain(*joined), index])
    return groups


def _unless_zero(gain: Any, held: Any) -> Any:
    """Return a divisor that is 1 at the start of the step where the gain is zero or the constraint does not hold."""
    value = array_of(gain)
    return gain + jnp.where((held == 0) | (value == 0), 1.0 - value, 0.0)
