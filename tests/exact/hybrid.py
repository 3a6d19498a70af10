"""Event-driven integration of hybrid systems that are described as data. It shares no code with the package under test.

Between events, a motion follows one mode. DOP853 integrates the mode with the tolerance 1e-12; events are roots of
functions on its dense output. At each event, one function determines all sides, slides, sticks and rests from the
state: it tries all combinations for the surfaces on which the state lies, and keeps those that are consistent. An
integration ends at the first doubtful point, where an error of about 1e-9 would change the sequence of events.

In a mode, the rates are f = F0 + sum s_i F_i + sum phi_j e_j + sum lambda_k e_k. Here s_i is the side of a switch,
phi_j the acceleration by a friction, and lambda_k that by a stop. These numbers are known if the motion is not held on
the surface of the event. On the surface, they satisfy -1 < s < 1, |phi| <= mu_s N/m and lambda > 0, and follow from
the condition that the motion stays there. If several surfaces coincide, the motion stays as long as some numbers do.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import brentq, linprog, minimize_scalar

from exact.described import Described, Rub, Stop, Surface, compiled, derivative, rate_of, times

ON = 1e-11
"""Largest value of a surface's function on the surface: coincident surfaces differ by rounding errors only."""

TOUCH, NOISE = 2e-15, 5e-14
"""Rounding errors of a gap, which is closed up to them, and of other functions. The last bounces are 1e-13 high."""

SLOW = 5e-7
"""Speed up to which a bounce ends in rest. The remaining bounces last about as long, and are as high as its square."""

CHATTER = 1e-5
"""Speed of impacts up to which other events may follow at once: those between bounces that accumulate."""

MARGINAL, GRAZING, CLOSE = 1e-7, 1e-9, 1e-7
"""A point is doubtful with a smaller distance from another mode, depth at a surface, or time [s] to another event."""

CASCADE, MOST_EVENTS = 40, 1_500
TOLERANCE = {"rtol": 3e-13, "atol": 1e-14}
INNER, EARLY = np.linspace(0.0, 1.0, 9), 0.5 ** np.arange(40.0, 3.0, -1.0)


class Doubtful(Exception):
    """A point after which the motion depends on rounding errors or on conventions."""


@dataclass
class Motion:
    """A motion: states at the given times (NaN after the doubtful point), and its events. `events`: tuples of time,
    name, kind and speed, with NaN for events without one. `doubt`: time and reason."""

    times: np.ndarray
    states: np.ndarray
    events: list[tuple[float, str, str, float]] = field(default_factory=list)
    doubt: tuple[float, str] = (np.inf, "")


class Hybrid:
    """A described system with numbers for its parameters. A mode has one number per event: 0 while the motion is held
    on its surface, else the side, which is 1 for stops."""

    def __init__(self, system: Described, p: Mapping[str, float]):
        self.system, self.events, self.n = system, tuple(system.events), len(system.states)
        self.near = [TOUCH if isinstance(event, Stop) else ON for event in self.events]
        self.noise = np.array([TOUCH if isinstance(event, Stop) else NOISE for event in self.events])
        p = {"omega": 1.0} | dict(p)
        sided = lambda state, side: (x for x in system.field[state] if _side(x, system.switches) == side)
        plain = lambda terms, side: tuple((x, " ".join(n for n in s.split() if n != side)) for x, s in terms)
        sides = ("", *system.switches)
        self.parts = compiled(system, p, [[plain(sided(x, side), side) for x in system.states] for side in sides])
        variables = ("t", *system.states)
        surfaces = [getattr(e, {Stop: "gap", Surface: "function", Rub: "relative"}[type(e)]) for e in self.events]
        # The rate of a gap is a function of time and states: no event changes the rates of positions.
        held = [
            rate_of(system, g) if isinstance(e, Stop) and e.velocity else g if not isinstance(e, Stop) else ()
            for e, g in zip(self.events, surfaces, strict=True)
        ]
        self.values = compiled(system, p, [surfaces, held])
        self.slopes = compiled(system, p, [[derivative(e, x) for x in variables] for e in surfaces + held])
        rubs = [e for e in self.events if isinstance(e, Rub)]
        loads = [times(((1.0 / p[e.mass], mu),), e.normal) for e in rubs for mu in (e.kinetic, e.static)]
        self.loads = compiled(system, p, [loads])
        stops = [(i, e) for i, e in enumerate(self.events) if isinstance(e, Stop)]
        reset = lambda e: compiled(system, p, [[e.reset.get(x, ((1.0, x),)) for x in system.states]])
        self.resets = {i: reset(e) for i, e in stops if e.velocity is None}
        self.restitution = {i: p[e.restitution] for i, e in stops if e.velocity is not None}

    def motion(self, mode: Sequence[int], t: float, y: np.ndarray):
        """Return the rates, and the numbers, slacks and stabilities of held events by index."""
        F = [np.array(row) for row in self.parts(t, y)]
        loads = self.loads(t, y)[0]
        f, columns, bounds, held = F[0], [], [], []
        switch, rub = 0, 0
        slopes = None
        for i, event in enumerate(self.events):
            if isinstance(event, Surface):
                switch += 1
                if mode[i]:
                    f = f + mode[i] * F[switch]
                    continue
                column, bound = F[switch] * (np.abs(F[switch]).max() > 1e-10), (-1.0, 1.0)
            elif isinstance(event, Rub):
                kinetic, static = loads[2 * rub : 2 * rub + 2]
                rub += 1
                column, bound = self._unit(event.acts_on), (-static, static)
                if mode[i]:
                    f = f - mode[i] * kinetic * column
                    continue
            else:
                if mode[i]:
                    continue
                slopes = self.slopes(t, y) if slopes is None else slopes
                column = self._unit(event.velocity)
                column, bound = column * np.sign(column @ slopes[len(self.events) + i][1:]), (0.0, np.inf)
            held.append(i), columns.append(column), bounds.append(bound)
        if not held:
            return f, {}, {}, {}
        slopes = self.slopes(t, y) if slopes is None else slopes
        rows = np.array([slopes[len(self.events) + i] for i in held])
        B = np.array(columns).T
        z, slack = _multipliers(rows[:, 1:] @ B, -(rows[:, 0] + rows[:, 1:] @ f), bounds, B)
        f = f + B @ z
        numbers, slacks = dict(zip(held, z, strict=True)), dict(zip(held, slack, strict=True))
        stable = {
            i: -float(rows[k, 1:] @ B[:, k]) if isinstance(self.events[i], Surface) and B[:, k].any() else np.inf
            for k, i in enumerate(held)
        }
        return f, numbers, slacks, stable

    def _unit(self, name: str) -> np.ndarray:
        return np.eye(self.n)[self.system.states.index(name)]

    def guards(self, mode: Sequence[int], t: float, y: np.ndarray) -> np.ndarray:
        """Return a number per event that is positive while the mode lasts."""
        values = self.values(t, y)[0]
        slacks = {} if all(mode) else self.motion(mode, t, y)[2]
        return np.array([s * x if s else slacks[i] for i, (s, x) in enumerate(zip(mode, values, strict=True))])

    def determine(self, t: float, y: np.ndarray, forced: Mapping[int, int]) -> tuple[int, ...]:
        """Return the mode in which a motion continues; `forced`: the side to which a held motion departs, by event."""
        values, closing = self.values(t, y)
        options = []
        for i, event in enumerate(self.events):
            if i in forced:
                options.append((forced[i],))
            elif abs(values[i]) > self.near[i] or i in self.resets or (isinstance(event, Stop) and closing[i] > SLOW):
                options.append((1,) if isinstance(event, Stop) or values[i] > 0 else (-1,))
            else:
                options.append((0, 1) if isinstance(event, Stop) else (0, 1, -1))
        tested = [i for i, option in enumerate(options) if len(option) > 1]
        found = []
        for mode in itertools.product(*options):
            f, _, slacks, stable = self.motion(mode, t, y)
            slopes = self.slopes(t, y) if tested else []
            conditions = [np.inf]
            for i in tested:
                row = slopes[len(self.events) + i] if tested else []
                conditions += [slacks[i], stable[i]] if mode[i] == 0 else [mode[i] * (row[0] + np.dot(row[1:], f))]
            if min(conditions) > 0:
                stuck = sum(isinstance(self.events[i], Rub) and mode[i] == 0 for i in tested)
                found.append((stuck, min(conditions), mode))
        found = [entry for entry in found if entry[0] == max(found)[0]]
        if not found:
            raise Doubtful("tangent: no mode is consistent")
        if len(found) > 1:
            raise Doubtful("unstable: several modes are consistent")
        if found[0][1] < MARGINAL:
            raise Doubtful("marginal: another mode is almost consistent")
        return found[0][2]

    def closing(self, t: float, y: np.ndarray, mode: Sequence[int] | None) -> list[float]:
        """Return the rate of each gap; for resets, it is that in a mode, or with the sides of the state."""
        values, rates = self.values(t, y)
        if self.resets:
            sides = [1 if isinstance(e, Stop) or x >= 0 else -1 for e, x in zip(self.events, values, strict=True)]
            f, slopes = self.motion(mode or sides, t, y)[0], self.slopes(t, y)
            for i in self.resets:
                rates[i] = slopes[i][0] + float(np.dot(slopes[i][1:], f))
        return rates

    def settle(
        self, t: float, y: np.ndarray, mode: Sequence[int] | None, forced: Mapping[int, int], log: list
    ) -> tuple[np.ndarray, tuple[int, ...]]:
        """Return state and mode after all jumps at a time; `log` receives the impacts."""
        y = np.array(y, float)
        for count in range(CASCADE):
            values, closing = self.values(t, y)[0], self.closing(t, y, mode if count == 0 else None)
            stops = [i for i, event in enumerate(self.events) if isinstance(event, Stop) and values[i] <= TOUCH]
            if any(values[i] < -1e-9 for i in stops):
                raise Doubtful("beyond a stop")
            if any(i in self.resets and abs(closing[i]) <= SLOW for i in stops):
                raise Doubtful("tangent at a reset, or accumulating resets")
            struck = [i for i in stops if closing[i] < -SLOW]
            if len(struck) > 1:
                raise Doubtful("two impacts at once")
            if not struck:
                break
            i = struck[0]
            log.append((t, self.events[i].name, "impact", -closing[i]))
            if i in self.resets:
                y = np.array(self.resets[i](t, y)[0])
            else:
                y = self._shift(t, y, i, -(1 + self.restitution[i]) * closing[i])
        else:
            raise Doubtful("cascade of jumps")
        for i in stops:
            if i not in self.resets and abs(closing[i]) <= SLOW:
                y = self._shift(t, y, i, -closing[i])
        return y, self.determine(t, y, forced)

    def _shift(self, t: float, y: np.ndarray, i: int, change: float) -> np.ndarray:
        """Return the state after a change of the rate of a gap by its velocity."""
        unit = self._unit(self.events[i].velocity)
        return y + unit * (change / (unit @ self.slopes(t, y)[len(self.events) + i][1:]))

    def project(self, t: float, y: np.ndarray, which: Sequence[tuple[int, bool]]) -> np.ndarray:
        """Return the state moved onto surfaces; pairs of an event and whether the motion is held there."""
        rows = sorted({k for i, held in which for k in ((i, len(self.events) + i) if held else (i,))})
        for _ in range(2):
            slopes = np.array([self.slopes(t, y)[k][1:] for k in rows])
            values = np.concatenate(self.values(t, y))[rows]
            y = y - np.linalg.lstsq(slopes, values, rcond=1e-10)[0]
        return y

    def run(self, start: Sequence[float], times: np.ndarray) -> Motion:
        """Integrate from a start at t = 0, and return the states at `times`, which increase."""
        result = Motion(times, np.full((len(times), self.n), np.nan))
        t, y, mode = 0.0, np.array(start, float), None
        begun, last, filled = (), (-np.inf, -1, np.inf), 0
        forced: dict[int, int] = {}
        try:
            while True:
                count = len(result.events)
                y, new = self.settle(t, y, mode, forced, result.events)
                result.events += _changes(self.events, t, begun, mode, new, result.events[count:])
                mode = new
                if t >= times[-1]:
                    break
                filled, t, y, hit = self._segment(t, y, mode, times, filled, result.states)
                if hit is None:
                    break
                i, z = hit
                speed = result.events[-1][3] if result.events and result.events[-1][2] == "impact" else np.inf
                if t - last[0] < CLOSE and last[1] != i and not min(speed, last[2]) < CHATTER:
                    raise Doubtful("two events almost at once")
                last = t, i, -self.closing(t, y, mode)[i] if isinstance(self.events[i], Stop) and mode[i] else np.inf
                held = [(k, True) for k, side in enumerate(mode) if side == 0]
                y, begun, forced = self.project(t, y, [(i, mode[i] == 0), *held]), (i,), z
                if len(result.events) > MOST_EVENTS:
                    raise Doubtful("too many events")
        except Doubtful as doubt:
            result.doubt = float(t), str(doubt)
        except DoubtfulAt as doubt:
            result.doubt = doubt.args
            result.states[times > doubt.args[0]] = np.nan
        return result

    def _segment(self, t0, y0, mode, times, filled, states):
        """Integrate one mode. Return the number of filled samples, and time, state and event at the end. The time x
        counts from the begin of the mode, so that short flights between bounces are resolved."""

        def rhs(x, y):
            return self.motion(mode, t0 + x, y)[0]

        def fill(dense, end):
            nonlocal filled
            while filled < len(times) and times[filled] <= t0 + end:
                states[filled], filled = dense(times[filled] - t0), filled + 1

        solver = DOP853(rhs, 0.0, y0, max(times[-1] - t0, 1e-9), max_step=0.15, **TOLERANCE)
        g0 = self.guards(mode, t0, y0)
        lifted = np.array([side != 0 and abs(g) <= near for side, g, near in zip(mode, g0, self.near, strict=True)])
        offset, fresh, armed = np.where(lifted, g0, 0.0), True, ~lifted
        while solver.status == "running":
            message = solver.step()
            if solver.status == "failed":
                raise Doubtful(f"integration failed: {message}")
            dense, begin = solver.dense_output(), solver.t_old
            points = begin + (solver.t - begin) * (np.concatenate([[0.0], EARLY, INNER[1:]]) if fresh else INNER)

            def guards(x, dense=dense):
                return self.guards(mode, t0 + x, dense(x)) - offset

            G, end, which, doubt = np.array([guards(x) for x in points]), np.inf, None, np.inf
            for i in range(len(mode)):
                try:
                    crossing, graze = _first_root(lambda x, i=i: guards(x)[i], points, G[:, i], armed[i], self.noise[i])
                except Doubtful as problem:
                    fill(dense, begin)
                    raise DoubtfulAt(t0 + begin, str(problem)) from None
                if crossing is not None and crossing < end:
                    end, which = crossing, i
                doubt = min(doubt, graze)
            armed, fresh = armed | np.greater(G, self.noise).any(axis=0), False
            fill(dense, min(end, doubt, solver.t))
            if doubt < end:
                raise DoubtfulAt(t0 + doubt, "grazing: an extremum next to a surface")
            if which is None:
                continue
            y = dense(end)
            if end > begin:  # the dense output is less accurate than a step that ends at the event
                exact = DOP853(rhs, begin, dense(begin), end, first_step=end - begin, **TOLERANCE)
                while exact.status == "running":
                    exact.step()
                y = exact.y if exact.status == "finished" else y
            d = 1e-4
            before, here, after = (guards(x)[which] for x in (end - d, end, end + d))
            slope, curvature = (after - before) / (2 * d), (after - 2 * here + before) / d**2
            if curvature > 0 and slope**2 < 2 * GRAZING * curvature:
                raise DoubtfulAt(t0 + end, "grazing: a crossing almost along the surface")
            shift = -(self.guards(mode, t0 + end, y)[which] - offset[which]) / slope
            if abs(shift) < 1e-8:
                y, end = y + shift * rhs(end, y), end + shift
            return filled, t0 + end, y, (which, {} if mode[which] else self._released(mode, t0 + end, y, which))
        return filled, t0 + solver.t, solver.y, None

    def _released(self, mode: Sequence[int], t: float, y: np.ndarray, which: int) -> dict[int, int]:
        """Return the sides to which a held motion departs from surfaces: those whose numbers have reached a bound."""
        _, numbers, slacks, stable = self.motion(mode, t, y)
        sides, idle = {}, []
        for i in numbers:
            event, number = self.events[i], numbers[i]
            if isinstance(event, Surface) and stable[i] == np.inf:
                idle.append(i)
            elif i == which or slacks[i] < 1e-8:
                sides[i] = 1 if isinstance(event, Stop) else int(np.sign(-number if isinstance(event, Rub) else number))
        later, d = [sides.get(i, 1 if i in idle else side) for i, side in enumerate(mode)], 1e-5
        for i in idle:  # a switch without effect on the field at this state: its side is that of the motion
            middle = y + 0.5 * d * self.motion(later, t, y)[0]
            values = self.values(t + d, y + d * self.motion(later, t + 0.5 * d, middle)[0])[0]
            if abs(values[i]) > ON:
                sides[i] = int(np.sign(values[i]))
        return sides


class DoubtfulAt(Exception):
    """A doubtful point at a time, with a reason."""


def _side(term: tuple[float, str], switches: Sequence[str]) -> str:
    sides = [name for name in term[1].split() if name in switches]
    assert len(sides) < 2, "the field must be affine in the sides"
    return sides[0] if sides else ""


def _multipliers(A, b, bounds, B):
    """Return numbers with A z = b, and their distances from the bounds. Redundant equations leave a choice; the result
    then has the greatest least distance."""
    if len(b) == 1:
        z = b / A[0] if A[0, 0] else np.full(1, np.inf)
        z = np.where(np.isfinite(z), z, 1e6)
    else:
        U, _, V = np.linalg.svd(A)
        rank = np.linalg.matrix_rank(A, rtol=1e-10)
        z = np.linalg.lstsq(A, b, rcond=1e-10)[0]
        if rank < len(b):
            if np.abs(A @ z - b).max() > 1e-9:
                return z, np.full(len(b), -1.0)
            if np.abs(B @ V[rank:].T).max() > 1e-9:
                raise Doubtful("ambiguous: the numbers of coincident surfaces are not unique")
            return _widest(U[:, :rank].T @ A, U[:, :rank].T @ b, *np.array(bounds).T)
    return z, np.array([min(x - low, high - x) for x, (low, high) in zip(z, bounds, strict=True)])


def _widest(A, b, low, high):
    """Return the numbers with A z = b that are farthest from their bounds, and that distance."""
    finite, n = np.isfinite(high), len(low)
    if len(b) > 1:
        limits = np.vstack([np.c_[-np.eye(n), np.ones(n)], np.c_[np.eye(n), np.ones(n)][finite]])
        equations = np.c_[A, np.zeros(len(b))]
        best = linprog([0.0] * n + [-1.0], limits, [*-low, *high[finite]], equations, b, bounds=[(None,) * 2] * (n + 1))
        return best.x[:-1], np.full(n, best.x[-1])
    a, b = A[0], b[0]
    if not finite.all() and a[~finite][0] < 0:
        a, b = -a, -b
    least, most = np.where(a > 0, low, high), np.where(a > 0, high, low)
    slack = min((b - a @ least) / np.abs(a).sum(), 0.5 * (high - low).min())
    slack = slack if not finite.all() else min(slack, (a @ most - b) / np.abs(a).sum())
    z = least + np.sign(a) * slack
    if not finite.all():
        z[~finite] += (b - a @ z) / a[~finite].sum()
    elif (most - least) @ a - 2 * slack * np.abs(a).sum() > 0:
        z += (b - a @ z) / ((most - np.sign(a) * slack - z) @ a) * (most - np.sign(a) * slack - z)
    return z, np.full(n, slack)


def _first_root(guard, points, g, armed, noise):
    """Return the first time at which a guard falls through zero, or None, and that of a doubtful extremum, or inf."""
    inside = None
    for a in range(1, len(points) - 1):
        # A parabola through three samples shows an extremum between them.
        (x0, x1, x2), (g0, g1, g2) = points[a - 1 : a + 2], g[a - 1 : a + 2]
        first, second = (g1 - g0) / (x1 - x0), (g2 - g1) / (x2 - x1)
        curvature = (second - first) / (x2 - x0)
        if not (curvature > 0 and g0 > 10 * GRAZING and min(g1, g2) > 0):
            continue
        lowest = 0.5 * (x0 + x1) - 0.5 * first / curvature
        value = g0 + (lowest - x0) * first + curvature * (lowest - x0) * (lowest - x1)
        if x0 < lowest < x2 and value < 0.02 * max(g0, g2):
            tolerance = {"xatol": 1e-11 + 1e-6 * (x2 - x0)}
            best = minimize_scalar(guard, bounds=(x0, x2), method="bounded", options=tolerance)
            if x0 + 1e-5 * (x2 - x0) < best.x < x2 - 1e-5 * (x2 - x0) and best.fun < GRAZING:
                inside = (x0, best.x, best.fun)
                break
    below = np.flatnonzero(g < -noise)
    crossing = None
    if below.size:
        above = np.flatnonzero(g[: below[0]] > noise) if not armed else np.arange(below[0])
        if not above.size:
            raise Doubtful("tangent: the motion does not leave a surface")
        low, high = points[above[-1]], points[below[0]]
        crossing = low if g[above[-1]] <= 0 else brentq(guard, low, high, xtol=1e-15, rtol=1e-14)
    if inside and (crossing is None or inside[1] < crossing):
        if inside[2] > -GRAZING:
            return crossing, inside[1]
        return brentq(guard, inside[0], inside[1], xtol=1e-15, rtol=1e-14), np.inf
    return crossing, np.inf


def _changes(events, t, hit, old, new, impacts):
    """Return the entries of events whose mode has changed or that have been hit."""
    entries = []
    for i, event in enumerate(events):
        if old is None or (old[i] == new[i] and not (i in hit and not isinstance(event, Stop))):
            continue
        kinds = {Stop: ("rest", "release"), Surface: ("slide", "switch"), Rub: ("stick", "slip")}[type(event)]
        entries.append((t, event.name, kinds[0] if new[i] == 0 else kinds[1], np.nan))
    return entries
