"""Ends a trial step at the first switching surface or marker that it crosses."""

from functools import reduce
from typing import NamedTuple

import jax.numpy as jnp

from vibrojax.stepping._keep import keep
from vibrojax.stepping.polynomial import first_guess, root, slope, value


class Landing(NamedTuple):
    """Where a trial step ends: in `state` at `tau` if `accepted`, else it is tried again up to `tau`.

    `hits` says which surface or marker it ends on, `falling` for each marker whether it comes down through zero.
    """

    tau: jnp.ndarray
    state: tuple
    accepted: jnp.ndarray
    hits: tuple
    falling: tuple


def land(functions_at, scene, p, mode, polynomials, functions, h, reach, moving) -> Landing:
    """Find the end of a trial step.

    A function that is crossed ends the step there. If another turns out to be crossed before, or one may have been
    touched and left again on the way, the trial is rejected and repeated up to that point: at most a few times, since
    each rejection shortens the step to an earlier candidate.

    **Arguments:**

    - `functions_at`: the surfaces, then the markers that are landed on, at a state.
    - `polynomials`: coefficients in tau of the states.
    - `functions`: coefficients in tau of the surfaces and those markers.
    - `h`: the trial step [s].
    - `reach`: its end in tau, in [0, 1].
    - `moving`: booleans; the other lanes stand still (h = 0).
    """
    n_surfaces = len(scene.surfaces_named)
    resolutions = zip(scene.resolutions(p, mode), scene.slope_resolutions(p, mode, h), strict=True)
    small = [Small(*one) for one, _ in zip(resolutions, functions, strict=False)]
    signs = [1.0] * n_surfaces + [_sign_at_start(*f) for f in list(zip(functions, small, strict=True))[n_surfaces:]]
    functions = [[sign * c for c in f] for sign, f in zip(signs, functions, strict=True)]
    trial = _crossings(functions, n_surfaces, reach, small, moving)

    first = reduce(jnp.minimum, trial.guesses)
    ending = first < jnp.inf
    at_once = ending & (first <= 0)
    chosen = keep(_first_where([guess == first for guess in trial.guesses]))
    tau = _root_of_chosen(functions, chosen, small, jnp.where(ending & ~at_once, first, 0.5), reach)
    tau = keep(jnp.where(ending, jnp.where(at_once, 0.0, tau), reach))

    state = keep(tuple(value(one, tau) for one in polynomials))
    landed = keep([sign * g for sign, g in zip(signs, functions_at(state), strict=True)])
    mine = [one & ending for one in chosen]
    # A root within roundings of the start is where the step starts: to try again would come back here for ever.
    there = at_once | (tau <= jnp.finfo(tau.dtype).eps)
    early = keep(_any(_early(trial, landed, mine, small, ending)))
    missed = keep(moving & ~there & _missed(trial, landed, mine, small, functions, n_surfaces))
    dips = [jnp.where(here, jnp.inf, _dip(f, end, tau)) for f, end, here in zip(functions, landed, mine, strict=True)]
    dip = keep(reduce(jnp.minimum, dips))
    dipped = moving & ~early & (dip < 1)
    repeat = keep(early | missed | dipped)
    # Short of the surface, by a root not found to the last digit or on a branch that is left before: it just goes on.
    short = _any(here & ~there & (g > one.value) for g, here, one in zip(landed, mine, small, strict=True))
    hit = keep(~repeat & ~short)
    not_landed_on = (jnp.zeros_like(moving),) * (n_surfaces + len(scene.markers_named) - len(functions))
    landing = Landing(
        tau=tau * jnp.where(dipped, dip, jnp.where(missed, 0.5, 1.0)),
        state=state,
        accepted=~repeat,
        hits=(*(one & hit for one in mine), *not_landed_on),
        falling=(*(sign > 0 for sign in signs[n_surfaces:]), *not_landed_on),
    )
    return keep(landing)


class Small(NamedTuple):
    """What counts as zero of a function: its value, and its first coefficient in tau."""

    value: jnp.ndarray
    slope: jnp.ndarray


class _Trial(NamedTuple):
    """Of each function: whether it is crossed by the end of the trial step, and where, as a fraction of it."""

    crossed: list
    guesses: list


def _crossings(functions, n_surfaces, reach, resolutions, moving) -> _Trial:
    """Which functions are crossed by the end of the step, by their polynomials."""
    # Their |.| and max keep the branch they start with; the true functions are asked at the landing.
    ends = keep([value(f, reach) for f in functions])
    guesses = [_guess(f, end, reach, small) for f, end, small in zip(functions, ends, resolutions, strict=True)]
    crossed = [moving & (end < 0) for end in ends]
    # A marker that leaves zero at a tangent and ends on the wrong side only had its sign misjudged; within roundings of
    # zero it crosses it all the time.
    for index in range(n_surfaces, len(functions)):
        clear = _zeros_at_start(functions[index], resolutions[index]) < 2
        crossed[index] = crossed[index] & clear & (guesses[index] > 0) & (ends[index] < -resolutions[index].value)
    guesses = keep([jnp.where(over, guess, jnp.inf) for over, guess in zip(crossed, guesses, strict=True)])
    return _Trial(crossed, guesses)


def _root_of_chosen(functions, chosen, resolutions, guess, reach):
    """The root in tau of the function that each lane has chosen."""

    def pick(values):
        picked = values[0]
        for mine, one in zip(chosen[1:], values[1:], strict=True):
            picked = jnp.where(mine, one, picked)
        return picked

    target = keep([pick([f[k] for f in functions]) for k in range(len(functions[0]))])
    zeros = _zeros_at_start(target, Small(*(pick(values) for values in zip(*resolutions, strict=True))))
    # A start tangent to the surface has no use for the parabola through it.
    guess = jnp.where(zeros == 2, 0.7, guess)
    return root(target, zeros, guess * reach, reach)


def _early(trial, landed, mine, resolutions, ending):
    """Where another function than the one that ends the step is crossed before."""
    return [
        ending & ~here & over & (there < -small.value)
        for there, over, here, small in zip(landed, trial.crossed, mine, resolutions, strict=True)
    ]


def _missed(trial, landed, mine, resolutions, functions, n_surfaces):
    """Where a surface is crossed on a branch of |.| or max that its polynomial does not follow, or the root is."""
    beyond = [there < -small.value for there, small in zip(landed, resolutions, strict=True)]
    roots = [here & there for here, there in zip(mine, beyond, strict=True)]
    others = [
        ~over & ~here & there & (f[0] > 0)
        for there, over, here, f in zip(beyond, trial.crossed, mine, functions, strict=True)
    ]
    return _any(roots + others[:n_surfaces])


def _any(masks):
    """Where any of the masks is true."""
    return reduce(jnp.logical_or, masks)


def _sign_at_start(marker, small):
    """The sign with which a marker starts: of its first term that is not rounding where it starts from zero."""
    rate = jnp.where(jnp.abs(marker[1]) <= small.slope, marker[2], marker[1])
    return jnp.where(jnp.where(marker[0] == 0, rate, marker[0]) < 0, -1.0, 1.0)


def _first_where(masks):
    """Masks of which at most the first true one is kept."""
    kept, before = [], jnp.zeros_like(masks[0])
    for mask in masks:
        kept.append(mask & ~before)
        before = before | mask
    return kept


def _zeros_at_start(f, small):
    """How many of the function's zeros lie at the start: 0 off the surface, 1 on it, 2 where it leaves at a tangent."""
    return jnp.where(f[0] <= 0, jnp.where(jnp.abs(f[1]) <= small.slope, 2.0, 1.0), 0.0)


def _guess(f, end, reach, small):
    """Fraction of the step at which a function that ends below zero crosses it; 0 if it leaves the surface at once."""
    zeros = _zeros_at_start(f, small)
    leaves = (f[0] < -small.value) | ((zeros > 0) & (jnp.where(zeros == 2, f[2], f[1]) <= 0))
    tangent = 0.5
    guess = jnp.where(zeros == 2, tangent, first_guess(jnp.maximum(f[0], 0), f[1] * reach, end))
    return jnp.where(leaves, 0.0, guess)


def _dip(f, end, tau):
    """Fraction of the step to `tau` near which a function may have dipped below zero and come back; infinite where not.

    A convex function lies above both of its end tangents: where these meet above zero there is no dip.
    """
    start, rate, end_rate = f[0], f[1] * tau, slope(f, tau) * tau
    falls_then_rises = (start > 0) & (end >= 0) & (rate < 0) & (end_rate > 0)
    curvature = end_rate - rate
    # start + rate * meeting < 0, the tangents meeting at (start - end + end_rate) / curvature.
    suspect = falls_then_rises & (start * curvature + rate * (start - end + end_rate) < 0)
    return jnp.where(suspect, jnp.minimum(-rate / curvature, 0.999), jnp.inf)
