"""Motions as pieces: each is a polynomial between one step or switch and the next."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from exact.flow import swung
from exact.parameters import Pulses, parameters
from exact.polynomials import GAUSS, WEIGHTS, N, first_fall
from exact.scenes import Phase, Scene

MOST_AT_ONCE = 50
"""Limit of consecutive switches without time between them; more form an endless loop."""


@dataclass
class Piece:
    """A part of a motion in one phase. It lasts from `begin` to `end`, and `c` [N + 1, d] are its coefficients over
    [origin, origin + h]."""

    begin: float
    end: float
    origin: float
    h: float
    c: np.ndarray
    phase: Phase
    given: Callable | None = None

    def x(self, t):
        """Return the variable of the polynomial at time t."""
        return 2 * (t - self.origin) / self.h - 1

    def states(self, t) -> np.ndarray:
        """Return the states [..., d] at times t."""
        x = np.asarray(self.x(t))
        return (chebyshev.chebvander(x, N) @ self.c).reshape(*x.shape, -1)

    def integral(self, function):
        """Return the integral of function(t, states) over the piece, which is exact for polynomials up to degree 47."""
        half = (self.end - self.begin) / 2
        t = self.begin + half * (GAUSS + 1)
        return half * np.tensordot(WEIGHTS, function(t, self.states(t)), axes=(0, 0))

    def between(self, begin, end) -> "Piece | None":
        """Return the part of the piece between two times."""
        begin, end = max(begin, self.begin), min(end, self.end)
        return replace(self, begin=begin, end=end) if begin < end else None


class Event(NamedTuple):
    time: float
    name: str
    state: np.ndarray
    before: Phase
    after: Phase


@dataclass
class Motion:
    """The pieces of a motion from `observed` on (all, if it is 0), and the events among them. `swing` [d] is the
    largest size of each entry so far, but at least its reference size."""

    scene: Scene
    observed: float
    end: float
    swing: np.ndarray
    pieces: list[Piece] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)

    def at(self, times) -> np.ndarray:
        """Return the states [times, entries]."""
        times = np.asarray(times, float)
        ends = np.array([piece.end for piece in self.pieces])
        index = np.minimum(np.searchsorted(ends, times, side="left"), len(ends) - 1)
        states = np.empty((len(times), len(self.scene.entries)))
        for i in np.unique(index):
            states[index == i] = self.pieces[i].states(times[index == i])
        return states

    def column(self, name, times) -> np.ndarray:
        """Return x1, v1, x2, v2, x3, x4 or v3 at the times."""
        states = self.at(times)
        if name == "x3":
            return states @ (self.scene.row["e"] + self.scene.row["x4"])
        return states @ self.scene.row[name]


def initial(scene: Scene, start) -> np.ndarray:
    """Return the initial state. `start` is a name (R5, R13) or a vector [x1, x1', x2, x2'], with rock [..., x3 - x4,
    x3']. Otherwise the rock begins at rest at zero. Without a drill, it is [x3 - x4, x3']."""
    y, values = np.zeros(len(scene.entries)), start
    y[-1] = 1.0
    if isinstance(start, str):
        edge = min(0.0, getattr(scene.p, "delta", 0.0))
        named = {"stuck": (0.0, -scene.p.v), "touching": (0.0, 0.0, edge)} if scene.drill else {}
        values = named.get(start, ())
    y[: len(values)] = values
    return y


def run(name, *, start="drive", settle=0.0, observe, pulses=None, **given) -> Motion:
    """Return a motion of the scene from t = 0 to settle + observe. Pieces before settle are not kept."""
    p = parameters(name, **given)
    if name == "penetration" and pulses is None:
        pulses = Pulses(p.force, p.frequency, p.pulse_width, p.pulse_shape)
    scene = Scene(name, p, pulses)
    motion = Motion(scene, settle, settle + observe, scene.sizes())
    t, y = 0.0, initial(scene, start)
    held, until = pulses.since(t) if pulses else (None, np.inf)
    phase = scene.first(y, held)
    repeats = 0
    while t < motion.end:
        limit = min(until, motion.end, settle if t < settle else np.inf)
        piece, last, event = _advance(scene.mode(phase, held), phase, t, y, motion.swing, limit, held)
        # uses the fraction of the step, since times are rounded to 1e-15 s
        y = chebyshev.chebvander([last], N)[0] @ piece.c
        y[-1] = 1.0
        motion.swing = swung(motion.swing, piece.c)
        repeats = repeats + 1 if piece.end - t < 1e-14 else 0
        if repeats > MOST_AT_ONCE:
            state = dict(zip(scene.entries, y, strict=True))
            raise ArithmeticError(f"{event} and no time passes: t = {t}, {phase}, {state}")
        t = piece.end
        if t > settle:
            motion.pieces.append(piece)
        if event:
            before, phase = phase, scene.after(phase, event, y)
            if t > settle:
                motion.events.append(Event(t, event, y.copy(), before, phase))
        if t >= until:
            held, until = pulses.since(t)
    return motion


def _advance(mode, phase, t, y, swing, limit, held):
    """Return the next piece, up to the first switch, the limit or the end of the step, and the event there."""
    h, c = mode.step(t, y, swing)
    end = min(t + h, limit)
    latest = min(2 * (end - t) / h - 1, 1.0)
    event, size = None, swung(swing, c)
    for name, row in zip(mode.names, mode.surfaces, strict=True):
        x = first_fall(c @ row, latest, np.abs(row) @ size)
        if x is not None and (event is None or x < latest):
            latest, event = x, name
    if event:
        end = t + h * (1 + latest) / 2
    return Piece(t, end, t, h, c, phase, held), latest, event
