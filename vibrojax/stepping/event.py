"""Event location: a step ends on the first guard or marker that its trial step crosses."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, NamedTuple

from vibrojax.lazy import jax, jnp
from vibrojax.physics.arrays import Array, Flags, Lanes, keep
from vibrojax.scenes.scene import Scene
from vibrojax.stepping.polynomial import Coefficients, first_guess, root, slope, value

TANGENT_GUESS = 0.5
"""First guess of a crossing, as a fraction of the step, if the step starts at a tangency to the guard."""

TANGENT_START = 0.7
"""Initial value of Newton's iteration for a crossing after a tangency, where a parabola gives no usable value."""


class Small(NamedTuple):
    """Magnitudes up to which a function's `value`, and its first coefficient in tau (`slope`), count as zero."""

    value: Array
    slope: Array


@dataclass(frozen=True)
class Event:
    """The functions whose zeros may end a step in one mode: guards of the scene, and markers if `marked` is true.

    A stepper that `smooths` dry friction never reaches the guard of friction.
    """

    scene: Scene[Any]
    constants: Any
    mode: tuple[Array, ...]
    marked: bool
    smooths: bool = False

    def functions(self, state: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the values of the guards and markers at a state, which consists of arrays or Taylor series."""
        guards = self.scene.guard_values(self.constants, self.mode, state, self.smooths)
        return (*guards, *(self.scene.marker_values(state) if self.marked else ()))

    def resolutions(self, state: tuple[Array, ...], h: Lanes) -> list[Small]:
        """Return, for each function, the magnitudes that count as zero in a step of `h` [s] from `state`."""
        values = self.scene.resolutions(self.constants, self.mode, state, self.marked)
        slopes = self.scene.slope_resolutions(self.constants, self.mode, state, h, self.marked)
        return [Small(*pair) for pair in zip(values, slopes, strict=True)]


class Trial(NamedTuple):
    """A trial step in the scaled time tau = time/h.

    - `polynomials`: coefficients of the states in tau.
    - `functions`: coefficients of the guards in tau, and of the markers if steps end on markers.
    - `h`: length of the step [s]; `reach`: end of the valid part of the step in tau, from 0 to 1.
    - `moving`: mask of the lanes that step; the other lanes do not change (h = 0).
    """

    polynomials: tuple[list[Array], ...]
    functions: list[list[Array]]
    h: Lanes
    reach: Lanes
    moving: Flags


class Landing(NamedTuple):
    """The end of a trial step.

    - `tau`, `state`, `accepted`: if accepted, the step ends in `state` at `tau`. Otherwise it is repeated with `tau` as
      its limit.
    - `hits`: for each guard and marker, by name, a mask of the lanes in which the step ends on it.
    - `falling`: for each marker, a mask of the lanes in which it crosses zero downwards.
    """

    tau: Lanes
    state: tuple[Array, ...]
    accepted: Flags
    hits: Mapping[str, Flags]
    falling: Mapping[str, Flags]


def locate(event: Event, trial: Trial) -> Landing:
    """Find where a trial step ends: at the first zero crossing of a guard or marker function.

    The trial is rejected if another function crosses zero earlier, or may cross zero twice within the step. The step is
    then repeated with the doubtful time as its limit. Few repetitions are needed, because each is shorter.
    """
    moving, reach = trial.moving, trial.reach
    if not trial.functions:
        state = keep(tuple(value(series, reach) for series in trial.polynomials))
        return Landing(reach, state, jnp.ones_like(moving), _by_name(event.scene.event_names, [], moving), {})
    n_guards = len(event.scene.guard_names)
    small = event.resolutions(tuple(series[0] for series in trial.polynomials), trial.h)
    signs: list[Any] = [1.0] * n_guards
    signs += [_sign_at_start(f, tiny) for f, tiny in zip(trial.functions[n_guards:], small[n_guards:], strict=True)]
    functions: list[Coefficients] = [[sign * c for c in f] for sign, f in zip(signs, trial.functions, strict=True)]
    crossed, guesses = _crossings(functions, n_guards, reach, small, moving, event.scene.ends_at_once)

    first = reduce(jnp.minimum, guesses)
    ending = first < jnp.inf
    at_once = ending & (first <= 0)
    chosen = keep(_first_true([guess == first for guess in guesses]))
    # A surface that is reached at the start, together with that of the last event, is reached at a time of its own by
    # the motions nearby. A function that an event makes negative ends the step at the time of that event.
    meets = [(f[0] >= -tiny.value) & (f[1] < -tiny.slope) for f, tiny in zip(functions, small, strict=True)]
    jumped = at_once & ~_any([here & met for here, met in zip(chosen, meets, strict=True)])
    tau = _root_of_chosen(functions, chosen, small, jnp.where(ending & ~jumped, first, 0.5), reach)
    tau = keep(jnp.where(ending, jnp.where(jumped, 0.0, tau), reach))

    state = keep(tuple(value(series, tau) for series in trial.polynomials))
    landed = keep([sign * g for sign, g in zip(signs, event.functions(state), strict=True)])
    mine = [mask & ending for mask in chosen]
    # A root within rounding error of the start counts as the start; otherwise repetitions would return to it for ever.
    at_start = at_once | (tau <= jnp.finfo(tau.dtype).eps)
    earlier, roots, others = [], [], []
    for f, end, over, here, tiny in zip(functions, landed, crossed, mine, small, strict=True):
        beyond = end < -tiny.value
        # A function other than the one that ends the step crosses zero earlier.
        earlier.append(ending & ~here & over & beyond)
        # The root, or the crossing of a guard, is on a branch of |.| or max that the polynomial does not describe.
        roots.append(here & beyond)
        others.append(~over & ~here & beyond & (f[0] > 0))
    early = keep(_any(earlier))
    missed = keep(moving & ~at_start & _any(roots + others[:n_guards]))
    dips = []
    for f, end, here, tiny in zip(functions, landed, mine, small, strict=True):
        dip = _dip_in_halves(f, end, tau, tiny) if event.scene.ends_at_once else _dip(f, end, tau)
        dips.append(jnp.where(here, jnp.inf, dip))
    dip = keep(reduce(jnp.minimum, dips))
    dipped = moving & ~early & (dip < 1)
    repeat = keep(early | missed | dipped)
    # If the root is inexact, or on a branch that the motion left earlier, the step ends before the guard is reached.
    # The next step then continues in the same mode.
    short = _any([here & ~at_start & (g > tiny.value) for g, here, tiny in zip(landed, mine, small, strict=True)])
    hit = keep(~repeat & ~short)
    return keep(
        Landing(
            tau=tau * jnp.where(dipped, dip, jnp.where(missed, 0.5, 1.0)),
            state=state,
            accepted=~repeat,
            hits=_by_name(event.scene.event_names, [mask & hit for mask in mine], moving),
            falling=_by_name(event.scene.marker_names, [sign > 0 for sign in signs[n_guards:]], moving),
        )
    )


def _by_name(names: tuple[str, ...], flags: list[Flags], like: Flags) -> dict[str, Flags]:
    """Return the masks by name; names without a mask (markers if steps do not end on them) get False."""
    return dict(zip(names, [*flags, *[jnp.zeros_like(like)] * (len(names) - len(flags))], strict=True))


def _crossings(
    functions: list[Coefficients], n_guards: int, reach: Array, small: list[Small], moving: Array, at_once: bool
) -> tuple[list[Array], list[Array]]:
    """Return, for each function, a mask of the lanes in which it is negative at the end of the step, and a guess.

    The guess is the crossing as a fraction of the step, infinite without a crossing. The polynomials describe only the
    branch of |.| and max at the start of the step; the caller evaluates the true functions at the located end.
    `at_once`: True if a guard that is negative at the start, or zero and falling, ends the step there, whatever its
    value at the end.
    """
    ends = keep([value(f, reach) for f in functions])
    guesses = [_guess(f, end, reach, tiny) for f, end, tiny in zip(functions, ends, small, strict=True)]
    crossed: list[Array] = [moving & (end < 0) for end in ends]
    if at_once:
        for index in range(n_guards):
            f, tiny = functions[index], small[index]
            below = (f[0] < -tiny.value) | ((f[0] <= 0) & (f[1] < -tiny.slope))
            crossed[index] = crossed[index] | (moving & below)
    # If a marker starts at a tangency and ends on the wrong side, only its sign was misjudged: there is no crossing.
    # Crossings within rounding error of zero do not count, because they would occur again and again.
    for index in range(n_guards, len(functions)):
        clear = _zeros_at_start(functions[index], small[index]) < 2
        crossed[index] = crossed[index] & clear & (guesses[index] > 0) & (ends[index] < -small[index].value)
    return crossed, keep([jnp.where(over, guess, jnp.inf) for over, guess in zip(crossed, guesses, strict=True)])


def _root_of_chosen(
    functions: list[Coefficients], chosen: list[Array], small: list[Small], guess: Array, reach: Array
) -> "jax.Array":
    """Return, for each lane, the root in tau of the chosen function."""

    def pick(values: Sequence[Array]) -> Array:
        picked = values[0]
        for mine, other in zip(chosen[1:], values[1:], strict=True):
            picked = jnp.where(mine, other, picked)
        return picked

    target = keep([pick([f[k] for f in functions]) for k in range(len(functions[0]))])
    zeros = _zeros_at_start(target, Small(*(pick(values) for values in zip(*small, strict=True))))
    guess = jnp.where(zeros == 2, TANGENT_START, guess)
    return root(target, zeros, guess * reach, reach)


def _any(masks: list[Array]) -> Array:
    return reduce(jnp.logical_or, masks)


def _first_true(masks: list[Array]) -> list[Array]:
    """Return the masks such that, in each lane, only the first True mask remains True."""
    firsts: list[Array] = []
    before = jnp.zeros_like(masks[0])
    for mask in masks:
        firsts.append(mask & ~before)
        before = before | mask
    return firsts


def _sign_at_start(marker: Coefficients, small: Small) -> "jax.Array":
    """Return a marker's sign at the start of the step; at zero, that of the first coefficient above rounding error."""
    rate = jnp.where(jnp.abs(marker[1]) <= small.slope, marker[2], marker[1])
    return jnp.where(jnp.where(marker[0] == 0, rate, marker[0]) < 0, -1.0, 1.0)


def _zeros_at_start(f: Coefficients, small: Small) -> "jax.Array":
    """Return the multiplicity of the function's zero at the start of the step: 0 if not zero, 2 at a tangency."""
    return jnp.where(f[0] <= 0, jnp.where(jnp.abs(f[1]) <= small.slope, 2.0, 1.0), 0.0)


def _guess(f: Coefficients, end: Array, reach: Array, small: Small) -> "jax.Array":
    """Return a guess of the fraction of the step at which a function with a negative `end` value crosses zero.

    The result is 0 if the function is negative from the start.
    """
    zeros = _zeros_at_start(f, small)
    leaves = (f[0] < -small.value) | ((zeros > 0) & (jnp.where(zeros == 2, f[2], f[1]) <= 0))
    guess = jnp.where(zeros == 2, TANGENT_GUESS, first_guess(jnp.maximum(f[0], 0), f[1] * reach, end))
    return jnp.where(leaves, 0.0, guess)


def _dip(f: Coefficients, end: Array, tau: Array) -> "jax.Array":
    """Return the fraction of the step to `tau` near which a function may have dipped below zero, else infinity."""
    return _dip_between(f[0], f[1] * tau, end, slope(f, tau) * tau)


def _dip_in_halves(f: Coefficients, end: Array, tau: Array, small: Small) -> "jax.Array":
    """Return the same for functions that may turn several times in a step, such as those of a user's system."""
    half = 0.5 * tau
    middle, rate = value(f, half), slope(f, half) * half
    first = _dip_between(f[0], f[1] * half, middle, rate)
    second = _dip_between(middle, rate, end, slope(f, tau) * half)
    below = jnp.where((f[0] > small.value) & (middle < -small.value), 0.5, jnp.inf)
    both = jnp.where(f[0] > small.value, jnp.minimum(0.5 * first, 0.5 + 0.5 * second), jnp.inf)
    return jnp.minimum(both, below)


def _dip_between(start: Array, rate: Array, end: Array, end_rate: Array) -> "jax.Array":
    """Return the fraction of an interval near which a function may have dipped below zero, else infinity.

    A convex function is above the tangents at both ends. If these tangents meet above zero, there is no dip.
    """
    falls_then_rises = (start > 0) & (end >= 0) & (rate < 0) & (end_rate > 0)
    curvature = end_rate - rate
    # start + rate * meeting < 0, with the tangents' meeting at (start - end + end_rate) / curvature.
    suspect = falls_then_rises & (start * curvature + rate * (start - end + end_rate) < 0)
    return jnp.where(suspect, jnp.minimum(-rate / curvature, 0.999), jnp.inf)
