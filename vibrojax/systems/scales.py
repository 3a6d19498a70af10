"""Scales of a system: its fastest rates, typical magnitudes and rounding errors, from which steps follow."""

import functools
import operator
from collections.abc import Mapping
from typing import Any
from weakref import WeakKeyDictionary

from vibrojax.lazy import jnp
from vibrojax.physics.arrays import Array
from vibrojax.scenes.declared import Values
from vibrojax.scenes.scene import ROUNDINGS, SLOPE_ROUNDINGS
from vibrojax.systems.equations import SECTION, TIME, SystemEquations
from vibrojax.systems.events import Impact, Switch
from vibrojax.systems.flow import SystemConstants
from vibrojax.systems.numbers import Magnitude, Rounded, slopes_along
from vibrojax.systems.transitions import LIFT_ROUNDINGS, free_modes, is_stop

DEFECT_TOLERANCES = 100.0
"""Greatest defect of the series at the end of a step, in tolerances: how far its slope is from the field there. Where
series converge it is below ten. It is large where the field bends more sharply than the start of the step shows."""

AT_REST = 16.0
"""Speed of a bounce up to which the motion comes to rest on the stop, in square roots of the machine epsilon times the
typical rate of the gap in a motion from rest. In a much faster motion, half of its own typical rate counts.
The height of a bounce is of second order in its speed: below, it is lost in rounding."""

GOLDEN = 0.618033988749895
"""Multiples of it are far from one another, modulo 1."""

BEYOND_RETURN = 1.5
"""Longest step in units of the time until a surface's parabola returns to zero: beyond it, the function is negative."""

_ROUNDINGS: "WeakKeyDictionary[SystemScales, tuple[Values, Any]]" = WeakKeyDictionary()
"""Arguments and result of the last call of `SystemScales._rounded` for each system."""


class SystemScales(SystemEquations):
    """The equations of a system, with the bounds and scales that a scene needs."""

    def constants(self, p: Mapping[str, Any]) -> SystemConstants:
        like = sum(0.0 * jnp.asarray(x) for x in p.values())
        values = {name: jnp.asarray(x) for name, x in p.items()}
        period = self._period(values) if callable(self._period) else self._period
        period = None if period is None else period + like
        zero = dict.fromkeys(self._own, like) | {name: like + x for name, x in self._discrete.items()}
        none = (like,) * len(self.events)
        typical = zero | dict.fromkeys(self.redundant, like)
        c = SystemConstants(values, period, typical, (), none + (like,) * len(self._flow.kinks), none, none)
        return c._replace(rates=self._flow.fastest(c, free_modes(self._flow, c, like, zero, like), like, zero))

    def scaled(self, c: SystemConstants, state: Values) -> SystemConstants:
        """Return the constants with rates and scales of a motion that begins at `state`."""
        t, y = self._known(state)
        like = 0.0 * state[0]
        # A lane and its orbit begin in different states, and must come to rest after the same bounce.
        rest = {name: x if name in self._discrete else like for name, x in y.items()}
        _, _, from_rest, _ = self._magnitudes(c, like, rest)
        c = c._replace(rates=self._flow.fastest(c, free_modes(self._flow, c, t, y, like), t, y))
        typical, surfaces, closing, holds = self._magnitudes(c, t + like, {name: x + like for name, x in y.items()})
        eps = jnp.finfo(like.dtype).eps
        return c._replace(
            typical=typical,
            lifts=tuple(LIFT_ROUNDINGS * eps * size for size in surfaces),
            slow=tuple(
                AT_REST * eps**0.5 * jnp.fmax(usual, 0.5 * own) for usual, own in zip(from_rest, closing, strict=True)
            ),
            holds=tuple(holds),
        )

    def _magnitudes(self, c: SystemConstants, t: Any, y: dict[str, Any]) -> tuple[dict[str, Any], Any, Any, Any]:
        """Return magnitudes in a motion from `y`: states, surfaces, closing rates of stops, and `Motion.margins`."""
        like = 0.0 * t
        speed, typical = jnp.stack(c.rates).min(axis=0), {name: jnp.abs(x) for name, x in y.items()}
        mode = free_modes(self._flow, c, t, y, like)
        time = 0.0 if c.period is None else c.period
        for _ in range(2):
            known = {name: Magnitude(y[name], size) for name, size in typical.items()}
            sizes = self._flow.at(c, mode, Magnitude(t, time + like), known).rates
            typical = {name: jnp.maximum(size, _size(sizes[name]) / speed) for name, size in typical.items()}
        known = {name: Magnitude(y[name], size) for name, size in typical.items()}
        clock = Magnitude(t, time + like)
        motion = self._flow.at(c, mode, clock, known)
        surfaces, holds = ([_size(x) + like for x in part] for part in (motion.surfaces, motion.margins))
        closing = [
            _size(self._flow.closing(c, mode, index, clock, known)) + like if isinstance(event, Impact) else like
            for index, event in enumerate(self.events)
        ]
        if self._section_function is not None:
            typical[SECTION] = _size(self._section_value(c, known)) + like
        return typical, surfaces, closing, holds

    def rate(self, c: SystemConstants, mode: Values) -> Any:
        where = [mode[index] for index, event in enumerate(self.events) if isinstance(event, Switch)]
        if not where or len(c.rates) == 1:
            return c.rates[0]
        rate = 0.0 * c.rates[0]
        for signs, own in zip(self._flow.combinations(), c.rates, strict=True):
            # On a surface (mode 0) the field is a combination of both sides.
            fits = jnp.stack([side * sign >= 0 for side, sign in zip(where, signs, strict=True)]).all(axis=0)
            rate = jnp.maximum(rate, jnp.where(fits, own, 0.0))
        return rate

    def rate_along(self, c: SystemConstants, mode: Values, state: Values) -> Any:
        # A field with kinks, such as a stiff contact, may change much faster than where the motion begins.
        if self._flow.rate is not None or (self._flow.structure.linear and not self._flow.kinks):
            return self.rate(c, mode)
        return self._flow.quickest(c, mode, *self._known(state))

    def defect_scales(
        self, c: SystemConstants, mode: Values, state: Values, polynomials: tuple[list[Array], ...]
    ) -> list[Any]:
        sizes, (_, _, changes) = self._step_sizes(c, mode, state, polynomials), self._rounded(c, mode, state)
        # A state that stays at zero, because a surface holds the motion, changes by the rounding errors of the others.
        return [DEFECT_TOLERANCES * jnp.maximum(size, change) for size, change in zip(sizes, changes, strict=True)]

    def _step_sizes(
        self, c: SystemConstants, mode: Values, state: Values, polynomials: tuple[list[Array], ...]
    ) -> list[Any]:
        """Return the magnitudes of the user's states in a step; a state at zero has that of its change."""
        sizes, _, _ = self._rounded(c, mode, state)
        # From rest, the last of n states in a chain begins to move with the n-th derivative.
        orders = range(2, min(len(self._own) + 1, len(polynomials[0]) // 2) + 1)
        own = zip(sizes, polynomials[: len(self._own)], strict=False)
        return [jnp.maximum(size, sum(jnp.abs(series[k]) for k in orders)) for size, series in own]

    def speed_scale(self, c: SystemConstants) -> Any:
        """Return the typical magnitude of the section's state."""
        return c.typical[self._section_state] if self._period is None else c.period

    def _rounded(self, c: SystemConstants, mode: Values, state: Values) -> tuple[list[Any], list[Any], list[Any]]:
        """Return bounds on the rounding errors of states, guards, and changes of the user's states, in epsilons."""
        arguments = (c, *mode, *state)
        known = _ROUNDINGS.get(self)
        if known is not None and len(known[0]) == len(arguments) and all(map(operator.is_, known[0], arguments)):
            return known[1]  # a step asks for the same bounds three times
        speed, names = self.rate(c, mode), self.state_names
        # A state that passes through zero has the errors of its values nearby.
        near = [jnp.abs(x) + jnp.abs(rate) / speed for x, rate in zip(state, self.field(c, mode, state), strict=True)]
        rounded = lambda sizes: tuple(Rounded(x, size) for x, size in zip(state, sizes, strict=True))  # noqa: E731
        motion = self._motion(c, mode, rounded(near))
        sizes = [size + _size(motion.rates.get(name, 0.0)) / speed for name, size in zip(names, near, strict=True)]
        if self._period is not None:
            sizes[names.index(TIME)] = jnp.zeros_like(state[0]) + c.period
        again = self._motion(c, mode, rounded(sizes))
        motion = motion._replace(surfaces=again.surfaces)
        guards = [_size(self._guard_value(c, index, mode, motion)) for index in range(len(motion.surfaces))]
        changes = [_size(again.rates[name]) / speed for name in self._own]
        bounds = sizes, guards + ([] if self._period is None else [jnp.zeros_like(state[0]) + c.period]), changes
        _ROUNDINGS[self] = arguments, bounds
        return bounds

    def resolutions(self, c: SystemConstants, mode: Values, state: Values, marked: bool = True) -> Values:
        sizes, guards, _ = self._rounded(c, mode, state)
        noise = ROUNDINGS * jnp.finfo(sizes[0].dtype).eps
        markers = [sizes[self.place(marker.velocity)] for marker in self.markers if marked]
        return tuple(noise * size for size in (*guards, *markers))

    def typical_guard_values(self, c: SystemConstants, mode: Values, state: Values) -> Values:
        # They are the same in all steps of a motion: what depends on where steps begin would have no derivative.
        sizes = [lift / (LIFT_ROUNDINGS * jnp.finfo(lift.dtype).eps) for lift in c.lifts]
        for index, event in enumerate(self.events):
            sizes[index] = jnp.where(mode[index] == (1 if is_stop(event) else 0), c.holds[index], sizes[index])
        return (*sizes, *(() if self._period is None else (c.period,)))

    def slope_resolutions(self, c: SystemConstants, mode: Values, state: Values, h: Any, marked: bool = True) -> Values:
        return tuple(SLOPE_ROUNDINGS * small for small in self.resolutions(c, mode, state, marked))

    def error_terms(
        self, c: SystemConstants, mode: Values, state: Values, polynomials: tuple[list[Array], ...]
    ) -> tuple[list[list[Array]], Any]:
        sizes = self._step_sizes(c, mode, state, polynomials)
        speed, one = self.rate(c, mode), jnp.ones_like(state[0])
        # Where the field bends sharply, as a friction law that falls steeply, an error of the states counts for more.
        sharp = jnp.maximum(self.rate_along(c, mode, state) / speed, 1.0)
        tiny = jnp.finfo(one.dtype).tiny / jnp.finfo(one.dtype).eps
        rates = self.field(c, mode, state)
        terms, none = [], jnp.zeros((), one.dtype)
        for index, name in enumerate(self._own):
            inverse = sharp / (sizes[index] + tiny)
            higher = [none, none] if name in self._integrated else [x * inverse for x in polynomials[index][1:]]
            # The rate of change comes first: a motion is at rest if it is slow, not if the step is short.
            terms.append([rates[index] * (inverse / speed), *higher])
        return terms, one

    def small_changes(self, c: SystemConstants, state: Values) -> Values:
        # Equal parts get unequal changes, so that no way in which they move against each other is left out.
        factors = (1.0 + GOLDEN * k % 1.0 for k in range(len(self._own)))
        return tuple(
            x * jnp.where(c.typical[name] > 0, c.typical[name], 1.0) for name, x in zip(self._own, factors, strict=True)
        )

    def changed_field(self, c: SystemConstants, mode: Values, state: Values, changes: Values) -> Values:
        t, y = self._known(state)
        along = [*changes, *(0.0 * state[0] for _ in self._discrete)]
        return tuple(slopes_along(lambda t, y: [*self._flow.at(c, mode, t, y).rates.values()], t, y, along, 0.0))[
            : len(self._own)
        ]

    def validity(
        self, c: SystemConstants, mode: Values, polynomials: tuple[list[Array], ...], functions: list[list[Array]]
    ) -> Any:
        """Return the fraction of a step after which a surface may have been reached and left again.

        After a slow bounce, a motion returns to the surface much faster than the field changes. The step then ends soon
        after the zero of the parabola through value, rate and curvature of the surface's function.
        """
        shares = []
        for value, rate, curvature, *_ in functions[: len(self.events)]:
            falls = curvature < 0
            below = jnp.where(falls, curvature, -1.0)
            root = (-rate - jnp.sqrt(jnp.maximum(rate * rate - 4 * below * value, 0.0))) / (2 * below)
            shares.append(jnp.where(falls & (root > jnp.finfo(root.dtype).eps), BEYOND_RETURN * root, 1.0))
        return functools.reduce(jnp.minimum, shares) if shares else None


def _size(x: Any) -> Any:
    return x.size if isinstance(x, Rounded) else jnp.abs(x)
