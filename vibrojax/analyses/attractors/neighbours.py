"""Which motions of neighbouring points are one attractor: orbits followed from point to point, statistics compared."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.analyses.attractors.grouping import IRREGULAR_FACTOR, SAME, Motions
from vibrojax.measures.labels import EQUILIBRIUM
from vibrojax.models.scenes import Scene
from vibrojax.periodic.newton import ACCEPTED, orbits
from vibrojax.periodic.return_map import Mapped
from vibrojax.periodic.segments import Segments

FIRST, LEAST = 1 / 4, 1 / 256
"""First and least step on the way from a point to the next, over the whole way."""

ASIDE = 0.05
"""Distance over the scales from where an orbit is expected, beyond which it is taken for another one."""

PerPoint = Float[np.ndarray, " points"]
States = Float[np.ndarray, "edges cycles states"]


class Link(NamedTuple):
    """Two motions that are one attractor, by number, the lower first; and how far apart they are."""

    one: int
    other: int
    distance: float


def links(
    scene: Scene[Any], parameters: Mapping[str, PerPoint], shape: tuple[int, ...], motions: Motions
) -> list[Link]:
    """The motions of neighbouring points of a grid that are one attractor; whichever way it is gone along.

    Orbits are followed by Newton's method to the neighbour's parameters, as stable ones; a doubled orbit that is
    followed to before its doubling comes to that which it doubled from. Where an orbit leads to is one of those there,
    or none. Equilibria are one; irregular motions are if their statistics are near each other.

    **Arguments:** `parameters` of the points by name, in row-major order over `shape`, the grid's.
    """
    at: dict[int, list[int]] = {}
    for number, cell in enumerate(motions.cell):
        at.setdefault(cell, []).append(number)
    found: dict[tuple[int, int], float] = {}
    ways: dict[int, list[tuple[int, int]]] = {}
    for here, there in _neighbours(shape):
        for one in at.get(here, ()):
            others = at.get(there, ())
            if motions.cycles[one]:
                if any(motions.cycles[other] for other in others):
                    ways.setdefault(motions.cycles[one], []).append((one, there))
                continue
            for other in others:
                distance = _of_others(motions, one, other)
                if distance is not None:
                    found[min(one, other), max(one, other)] = distance
    for some in ways.values():
        _follow(scene, parameters, some, at, motions, found)
    return [Link(one, other, distance) for (one, other), distance in found.items()]


def _neighbours(shape: tuple[int, ...]) -> list[tuple[int, int]]:
    """All pairs of points that are neighbours along an axis, both ways."""
    numbers = np.arange(int(np.prod(shape, dtype=int))).reshape(shape)
    pairs: list[tuple[int, int]] = []
    for axis in range(len(shape)):
        along = np.moveaxis(numbers, axis, 0)
        ends = along[:-1].ravel().tolist(), along[1:].ravel().tolist()
        pairs += [*zip(*ends, strict=True), *zip(*ends[::-1], strict=True)]
    return pairs


def _of_others(motions: Motions, one: int, other: int) -> float | None:
    """How far apart two motions are that are no orbits; None where they are not one."""
    if motions.regime[one] == EQUILIBRIUM and motions.regime[other] == EQUILIBRIUM:
        return 0.0
    a, b = motions.statistics[one], motions.statistics[other]
    if a is None or b is None:
        return None
    distance = float(np.abs(a - b).max())
    return distance if distance <= np.log(IRREGULAR_FACTOR) else None


def _follow(
    scene: Scene[Any],
    parameters: Mapping[str, PerPoint],
    ways: list[tuple[int, int]],
    at: Mapping[int, list[int]],
    motions: Motions,
    found: dict[tuple[int, int], float],
) -> None:
    """Follow orbits, each to a neighbouring point, and enter those there that they come to."""
    ones = [one for one, _ in ways]
    here, there = np.array([motions.cell[one] for one in ones]), np.array([cell for _, cell in ways])
    states = np.stack([np.asarray(motions.states[one]) for one in ones])
    scales = np.stack([np.asarray(motions.scales[one]) for one in ones])
    begin, end = ({name: x[some] for name, x in parameters.items()} for some in (here, there))
    reached, to = followed(scene, begin, end, states, scales, motions.most_steps)
    for k in np.flatnonzero(reached).tolist():
        for other in at[int(there[k])]:
            orbit = motions.states[other]
            if orbit is None:
                continue
            apart = np.abs(to[k, 0] - orbit) / motions.scales[other]
            if apart.max(axis=1).min() < SAME:
                one = ones[k]
                distance = _apart(states[k], orbit, (scales[k] + np.asarray(motions.scales[other])) / 2)
                found[min(one, other), max(one, other)] = distance


def _apart(one: np.ndarray, other: np.ndarray, scales: np.ndarray) -> float:
    """Distance of two orbits over the scales: between the nearest of their states."""
    return float((np.abs(one[:, None] - other[None]) / scales).max(axis=2).min())


def followed(
    scene: Scene[Any],
    begin: Mapping[str, Float[np.ndarray, " edges"]],
    end: Mapping[str, Float[np.ndarray, " edges"]],
    states: States,
    scales: Float[np.ndarray, "edges states"],
    most_steps: float,
) -> tuple[Bool[np.ndarray, " edges"], States]:
    """Follow orbits from the parameters `begin` to `end`: which arrive as stable ones, and their states then."""
    go = Segments(scene, most=most_steps)
    states, slope = states.copy(), np.zeros_like(states)
    done, step = np.zeros(len(states)), np.full(len(states), FIRST)
    active = np.arange(len(states))
    while len(active):
        way = np.minimum(step[active], 1 - done[active])
        share = done[active] + way
        given = {name: (1 - share) * begin[name][active] + share * end[name][active] for name in begin}

        def returns(lanes: Int[np.ndarray, " some"], x: np.ndarray, given: dict[str, np.ndarray] = given) -> Mapped:
            return go({name: value[lanes] for name, value in given.items()}, x)

        ahead = states[active] + slope[active] * way[:, None, None]
        with np.errstate(all="ignore"):
            orbit = orbits(ahead, scales[active], np.full(len(active), ASIDE), returns)
            good = (orbit.residual <= ACCEPTED) & (orbit.moved <= ASIDE)
        good[good] = np.abs(np.linalg.eigvals(orbit.product[good])).max(axis=1) < 1
        on, back = active[good], active[~good]
        slope[on] = (orbit.states[good] - states[on]) / way[good, None, None]
        states[on], done[on] = orbit.states[good], share[good]
        step[on], step[back] = 2 * way[good], way[~good] / 2
        active = active[(done[active] < 1) & (step[active] >= LEAST)]
    return done >= 1, states
