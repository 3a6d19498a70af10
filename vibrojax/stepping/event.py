"""The event that ends a step: the first guard or marker that the trial step crosses."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from vibrojax.models.arrays import Array, Flags, Lanes, keep
from vibrojax.models.scenes.scene import Scene
from vibrojax.stepping.polynomial import Coefficients, first_guess, root, slope, value


@dataclass(frozen=True)
class Event:
    """What a step in one mode may end on: the scene's guards, and its markers if they are `marked`.

    Where a stepper `smooths`, a guard that is a spread-out switch is never reached.
    """

    scene: Scene[Any]
    constants: Any
    mode: tuple[Array, ...]
    marked: bool
    smooths: bool = False

    @property
    def markers(self) -> tuple[str, ...]:
        """Names of the markers that are landed on."""
        return self.scene.marker_names if self.marked else ()

    def functions(self, state: tuple[Any, ...]) -> tuple[Any, ...]:
        """The guards' functions and the markers' velocities at a state, of arrays or series."""
        guards = self.scene.guard_values(self.constants, self.mode, state, self.smooths)
        return (*guards, *(self.scene.marker_values(state) if self.marked else ()))

    def resolutions(self, h: Lanes) -> "list[Small]":
        """What counts as zero of each function."""
        values = self.scene.resolutions(self.constants, self.mode, self.marked)
        slopes = self.scene.slope_resolutions(self.constants, self.mode, h, self.marked)
        return [Small(*one) for one in zip(values, slopes, strict=True)]


class Trial(NamedTuple):
    """A trial step, in tau = time/h.

    - `polynomials`: coefficients in tau of the states; `functions`: of the guards, and of the markers landed on.
    - `h`: its length [s]; `reach`: its end in tau, in [0, 1].
    - `moving`: the other lanes stand still (h = 0).
    """

    polynomials: tuple[list[Array], ...]
    functions: list[list[Array]]
    h: Lanes
    reach: Lanes
    moving: Flags


class Landing(NamedTuple):
    """Where a trial step ends: in `state` at `tau` if `accepted`, else it is tried again up to `tau`.

    `hits` says by name which guard or marker it ends on, `falling` for each marker whether it comes down through zero.
    """

    tau: Lanes
    state: tuple[Array, ...]
    accepted: Flags
    hits: Mapping[str, Flags]
    falling: Mapping[str, Flags]


def locate(event: Event, trial: Trial) -> Landing:
    """Find the end of a trial step.

    A function that is crossed ends the step there. If another turns out to be crossed before, or one may have been
    touched and left again on the way, the trial is rejected and repeated up to that point: at most a few times, since
    each rejection shortens the step to an earlier candidate.
    """
    moving, reach = trial.moving, trial.reach
    if not trial.functions:
        state = keep(tuple(value(one, reach) for one in trial.polynomials))
        return Landing(reach, state, jnp.ones_like(moving), _by_name(event.scene.event_names, [], moving), {})
    n_guards = len(event.scene.guard_names)
    small = event.resolutions(trial.h)
    signs: list[Any] = [1.0] * n_guards
    signs += [_sign_at_start(f, one) for f, one in zip(trial.functions[n_guards:], small[n_guards:], strict=True)]
    functions: list[Coefficients] = [[sign * c for c in f] for sign, f in zip(signs, trial.functions, strict=True)]
    ends = _crossings(functions, n_guards, reach, small, moving)

    first = reduce(jnp.minimum, ends.guesses)
    ending = first < jnp.inf
    at_once = ending & (first <= 0)
    chosen = keep(_first_where([guess == first for guess in ends.guesses]))
    tau = _root_of_chosen(functions, chosen, small, jnp.where(ending & ~at_once, first, 0.5), reach)
    tau = keep(jnp.where(ending, jnp.where(at_once, 0.0, tau), reach))

    state = keep(tuple(value(one, tau) for one in trial.polynomials))
    landed = keep([sign * g for sign, g in zip(signs, event.functions(state), strict=True)])
    mine = [one & ending for one in chosen]
    # A root within roundings of the start is where the step starts: to try again would come back here for ever.
    there = at_once | (tau <= jnp.finfo(tau.dtype).eps)
    early = keep(_any(_early(ends, landed, mine, small, ending)))
    missed = keep(moving & ~there & _missed(ends, landed, mine, small, functions, n_guards))
    dips = [jnp.where(here, jnp.inf, _dip(f, end, tau)) for f, end, here in zip(functions, landed, mine, strict=True)]
    dip = keep(reduce(jnp.minimum, dips))
    dipped = moving & ~early & (dip < 1)
    repeat = keep(early | missed | dipped)
    # Short of the guard, by a root not found to the last digit or on a branch that is left before: it just goes on.
    short = _any(here & ~there & (g > one.value) for g, here, one in zip(landed, mine, small, strict=True))
    hit = keep(~repeat & ~short)
    return keep(
        Landing(
            tau=tau * jnp.where(dipped, dip, jnp.where(missed, 0.5, 1.0)),
            state=state,
            accepted=~repeat,
            hits=_by_name(event.scene.event_names, [one & hit for one in mine], moving),
            falling=_by_name(event.scene.marker_names, [sign > 0 for sign in signs[n_guards:]], moving),
        )
    )


def _by_name(names: tuple[str, ...], flags: list[Flags], like: Flags) -> dict[str, Flags]:
    """The flags by name, false for the markers that steps do not end on."""
    return dict(zip(names, [*flags, *[jnp.zeros_like(like)] * (len(names) - len(flags))], strict=True))


class Small(NamedTuple):
    """What counts as zero of a function: its value, and its first coefficient in tau."""

    value: Array
    slope: Array


class _Ends(NamedTuple):
    """Of each function: whether it is crossed by the end of the trial step, and where, as a fraction of it."""

    crossed: list[Array]
    guesses: list[Array]


def _crossings(
    functions: list[Coefficients], n_guards: int, reach: Array, resolutions: list[Small], moving: Array
) -> _Ends:
    """Which functions are crossed by the end of the step, by their polynomials."""
    # Their |.| and max keep the branch they start with; the true functions are asked at the landing.
    ends = keep([value(f, reach) for f in functions])
    guesses = [_guess(f, end, reach, small) for f, end, small in zip(functions, ends, resolutions, strict=True)]
    crossed: list[Array] = [moving & (end < 0) for end in ends]
    # A marker that leaves zero at a tangent and ends on the wrong side only had its sign misjudged; within roundings of
    # zero it crosses it all the time.
    for index in range(n_guards, len(functions)):
        clear = _zeros_at_start(functions[index], resolutions[index]) < 2
        crossed[index] = crossed[index] & clear & (guesses[index] > 0) & (ends[index] < -resolutions[index].value)
    found = [jnp.where(over, guess, jnp.inf) for over, guess in zip(crossed, guesses, strict=True)]
    return _Ends(crossed, keep(list[Array](found)))


def _root_of_chosen(
    functions: list[Coefficients], chosen: list[Array], resolutions: list[Small], guess: Array, reach: Array
) -> jax.Array:
    """The root in tau of the function that each lane has chosen."""

    def pick(values: Sequence[Array]) -> Array:
        picked = values[0]
        for mine, one in zip(chosen[1:], values[1:], strict=True):
            picked = jnp.where(mine, one, picked)
        return picked

    target = keep([pick([f[k] for f in functions]) for k in range(len(functions[0]))])
    zeros = _zeros_at_start(target, Small(*(pick(values) for values in zip(*resolutions, strict=True))))
    # A start tangent to the guard has no use for the parabola through it.
    guess = jnp.where(zeros == 2, 0.7, guess)
    return root(target, zeros, guess * reach, reach)


def _early(ends: _Ends, landed: list[Array], mine: list[Array], resolutions: list[Small], ending: Array) -> list[Array]:
    """Where another function than the one that ends the step is crossed before."""
    return [
        ending & ~here & over & (there < -small.value)
        for there, over, here, small in zip(landed, ends.crossed, mine, resolutions, strict=True)
    ]


def _missed(
    ends: _Ends,
    landed: list[Array],
    mine: list[Array],
    resolutions: list[Small],
    functions: list[Coefficients],
    n_guards: int,
) -> Array:
    """Where a guard is crossed on a branch of |.| or max that its polynomial does not follow, or the root is."""
    beyond = [there < -small.value for there, small in zip(landed, resolutions, strict=True)]
    roots = [here & there for here, there in zip(mine, beyond, strict=True)]
    others = [
        ~over & ~here & there & (f[0] > 0)
        for there, over, here, f in zip(beyond, ends.crossed, mine, functions, strict=True)
    ]
    return _any(roots + others[:n_guards])


def _any(masks: Iterable[Array]) -> Array:
    """Where any of the masks is true."""
    return reduce(jnp.logical_or, masks)


def _sign_at_start(marker: Coefficients, small: Small) -> jax.Array:
    """The sign with which a marker starts: of its first term that is not rounding where it starts from zero."""
    rate = jnp.where(jnp.abs(marker[1]) <= small.slope, marker[2], marker[1])
    return jnp.where(jnp.where(marker[0] == 0, rate, marker[0]) < 0, -1.0, 1.0)


def _first_where(masks: list[Array]) -> list[Array]:
    """Masks of which at most the first true one is kept."""
    kept: list[Array] = []
    before = jnp.zeros_like(masks[0])
    for mask in masks:
        kept.append(mask & ~before)
        before = before | mask
    return kept


def _zeros_at_start(f: Coefficients, small: Small) -> jax.Array:
    """How many of the function's zeros lie at the start: 0 off the guard, 1 on it, 2 where it leaves at a tangent."""
    return jnp.where(f[0] <= 0, jnp.where(jnp.abs(f[1]) <= small.slope, 2.0, 1.0), 0.0)


def _guess(f: Coefficients, end: Array, reach: Array, small: Small) -> jax.Array:
    """Fraction of the step at which a function that ends below zero crosses it; 0 if it leaves the guard at once."""
    zeros = _zeros_at_start(f, small)
    leaves = (f[0] < -small.value) | ((zeros > 0) & (jnp.where(zeros == 2, f[2], f[1]) <= 0))
    tangent = 0.5
    guess = jnp.where(zeros == 2, tangent, first_guess(jnp.maximum(f[0], 0), f[1] * reach, end))
    return jnp.where(leaves, 0.0, guess)


def _dip(f: Coefficients, end: Array, tau: Array) -> jax.Array:
    """Fraction of the step to `tau` near which a function may have dipped below zero and come back; infinite where not.

    A convex function lies above both of its end tangents: where these meet above zero there is no dip.
    """
    start, rate, end_rate = f[0], f[1] * tau, slope(f, tau) * tau
    falls_then_rises = (start > 0) & (end >= 0) & (rate < 0) & (end_rate > 0)
    curvature = end_rate - rate
    # start + rate * meeting < 0, the tangents meeting at (start - end + end_rate) / curvature.
    suspect = falls_then_rises & (start * curvature + rate * (start - end + end_rate) < 0)
    return jnp.where(suspect, jnp.minimum(-rate / curvature, 0.999), jnp.inf)
