"""Stable single impacts followed from points of a map to their neighbours, and where they are lost on the way."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.analyses.continuation.arcs import Arcs, drawn_together
from vibrojax.analyses.continuation.corners import around
from vibrojax.analyses.continuation.indicators import KINDS, multipliers, spectral_radius
from vibrojax.analyses.continuation.locate import by_events
from vibrojax.analyses.continuation.problem import At, Flags, Index, PerLane, Problem, joined_at, tangent
from vibrojax.analyses.continuation.walk import ENDED, STALLED, Begin, Trail, walk
from vibrojax.models.scenes import Scene

EDGE = 1 / 3
"""Length of an edge, over the scales."""

LONGEST = 0.5
"""Step over the scales: most edges are one."""

MOST_CORNERS = 4
"""Corners that are turned on one edge."""

States = Float[np.ndarray, "edges states"]
Some = Int[np.ndarray, " some"]


class Edges(NamedTuple):
    """Edges of a map along one parameter: other `parameters` by name, values at the `begin` and at the `end`; and the
    orbits there, their `states` over their `scales`."""

    parameters: Mapping[str, PerLane]
    begin: PerLane
    end: PerLane
    states: States
    scales: States

    def of(self, some: Index) -> "Edges":
        """Some of the edges."""
        parameters = {name: x[some] for name, x in self.parameters.items()}
        return Edges(parameters, self.begin[some], self.end[some], self.states[some], self.scales[some])


class Followed(NamedTuple):
    """What became of the orbits: whether they `reached` the end as stable single impacts, and their `states` there; the
    `kind` (a flag) and the `value` of the parameter where they did not."""

    reached: Bool[np.ndarray, " edges"]
    states: States
    kind: Int[np.ndarray, " edges"]
    value: PerLane


def followed(scene: Scene[Any], along: str, edges: Edges, most_steps: float) -> Followed:
    """Follow the orbits along their edges."""
    first, last = np.minimum(edges.begin, edges.end), np.maximum(edges.begin, edges.end)
    problem = Problem(scene, along, edges.parameters, edges.scales, (last - first) / EDGE, first, last, most_steps)
    lanes = np.arange(len(edges.begin))
    u = problem.unknowns(lanes, edges.states[:, None], edges.begin)
    towards = np.zeros_like(u)
    towards[:, -1] = np.sign(edges.end - edges.begin)
    found = Followed(
        np.zeros(len(lanes), bool),
        edges.states.copy(),
        np.full(len(lanes), KINDS.index("end")),
        edges.begin.copy(),
    )
    with np.errstate(all="ignore"):
        ahead = tangent(problem.at(lanes, u).matrix, towards)
        step = np.full(len(lanes), LONGEST)
        for _ in range(MOST_CORNERS + 1):
            none = np.full_like(u, np.nan)
            trail = walk(problem, Begin(lanes, u, ahead, step, none, none), LONGEST, lambda _, at, __: ~right(at))
            ends = np.searchsorted(trail.lane, np.arange(len(lanes) + 1))
            end = ends[1:] - 1
            there = right(trail.at.of(end))
            arrived = there & (trail.status == ENDED)
            found.reached[lanes[arrived]] = True
            found.states[lanes[arrived]] = problem.states(lanes, trail.at.u[end])[arrived, 0]
            lost = np.flatnonzero(~there)
            _enter_lost(problem, lanes, trail, end, lost, found)
            stalled = np.flatnonzero(there & (trail.status == STALLED))
            if not len(stalled):
                break
            lanes, u, ahead = _beyond_corners(problem, lanes, trail, ends, stalled, found)
            step = np.full(len(lanes), 1e-3)
            if not len(lanes):
                break
    return found


def right(at: At) -> Flags:
    """Whether orbits are stable single impacts."""
    return np.isfinite(at.residual) & (spectral_radius(at.product) < 1) & (at.impacts == 1)


def _enter_lost(problem: Problem, lanes: Index, trail: Trail, end: Index, lost: Some, found: Followed) -> None:
    """Enter where orbits cease to be stable single impacts, between their last two points."""
    place = end[lost] - 1
    lost, place = lost[place >= 0], place[place >= 0]
    same = trail.lane[place] == trail.lane[place + 1]
    lost, place = lost[same], place[same]
    if not len(lost):
        return
    ends = trail.at.of(place), trail.tangent[place], trail.at.of(place + 1), trail.tangent[place + 1]
    arcs = Arcs(lanes[lost], place, *ends)
    fine, _ = drawn_together(problem, arcs, lambda _, at, __: np.where(right(at), 1.0, -1.0), np.ones(len(lost), bool))
    found.kind[lanes[lost]] = _kinds(problem, fine)
    found.value[lanes[lost]] = problem.value(fine.family, fine.near.u)


def _kinds(problem: Problem, arcs: Arcs) -> Int[np.ndarray, " arcs"]:
    """By what orbits are lost between the near ends and the far ones."""
    values = multipliers(arcs.near.product)
    real = np.abs(values.imag) < 1e-6
    to_one = np.where(real, np.abs(values - 1), np.inf).min(axis=1)
    to_minus = np.where(real, np.abs(values + 1), np.inf).min(axis=1)
    to_circle = np.where(real, np.inf, np.abs(np.abs(values) - 1)).min(axis=1)
    names = ("fold", "period-doubling", "torus")
    kinds = np.array([KINDS.index(name) for name in names])[np.argmin([to_one, to_minus, to_circle], axis=0)]
    same = (arcs.near.signature == arcs.far.signature).all(axis=1)
    for k in np.flatnonzero(~same):
        kinds[k] = by_events(problem, arcs.of(np.array([k])))[0].kind[0]
    return kinds


def _beyond_corners(
    problem: Problem, lanes: Index, trail: Trail, ends: Int[np.ndarray, " ends"], stalled: Some, found: Followed
) -> tuple[Int[np.ndarray, " on"], Float[np.ndarray, "on unknowns"], Float[np.ndarray, "on unknowns"]]:
    """The lanes that go on as stable single impacts where they found no next point ahead; enter the others."""
    last = trail.at.of(ends[stalled + 1] - 1)
    before = []
    for k in stalled:
        own = trail.at.u[ends[k] : ends[k + 1]]
        away = np.flatnonzero(np.abs(own - own[-1]).max(axis=1) > 1e-7)
        before.append(trail.at.of([ends[k] + (away[-1] if len(away) else 0)]))
    near, ahead = joined_at(before), trail.tangent[ends[stalled + 1] - 1]
    family = lanes[stalled]
    turned = around(problem, family, last, ahead, near)
    on = turned.found & right(turned.at)
    off = np.flatnonzero(~on)
    if len(off):
        arcs = Arcs(family, ends[stalled], near, ahead, turned.at, ahead).of(off)
        found.kind[family[off]] = np.where(
            (arcs.near.signature == arcs.far.signature).all(axis=1), KINDS.index("end"), _kinds(problem, arcs)
        )
        found.value[family[off]] = problem.value(family, last.u)[off]
    return family[on], turned.at.u[on], turned.tangent[on]
