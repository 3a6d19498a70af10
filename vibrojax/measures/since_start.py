"""Scales of repeats, and rest, of scenes that judge a motion by its swings and magnitudes since t = 0.

In a system with free equations, a state may stand still or decay while others oscillate. Relative to its own swing, its
rounding errors would make the motion irregular. A section with `typical` therefore bounds the scales from below.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from vibrojax.lazy import jnp
from vibrojax.measures.motion import positions, section_of, widened
from vibrojax.measures.repeats import REPEATS_WITHIN, Range
from vibrojax.scenes.declared import Section
from vibrojax.scenes.scene import ROUNDINGS, SLOPE_ROUNDINGS, Scene
from vibrojax.stepping import Lane

LEAST_SWING, LEAST_MAGNITUDE = 1e-3, 1e-9
"""Least scale of a state, as a fraction of its half range since t = 0, and of its greatest magnitude since t = 0."""

REST_SWING = 1e-6
"""Greatest swing of a state at rest, as a fraction of its greatest magnitude since t = 0."""

NOISE_ROUNDINGS = ROUNDINGS * SLOPE_ROUNDINGS
"""Magnitude up to which a state may consist of rounding errors, in machine epsilons of its typical magnitude."""

STANDING_SCALE = 1e-3
"""Least scale of distances from a limit or an orbit, as a fraction of the state itself: rounding is far below."""


def begin(scene: Scene[Any], lane: Lane) -> tuple[Range, ...]:
    """Return the ranges of the oscillating positions at t = 0; empty if scales do not depend on them."""
    return tuple((x, x) for x in positions(scene, lane)) if section_of(scene).typical is not None else ()


def extended(scene: Scene[Any], ranges: tuple[Range, ...], lane: Lane) -> tuple[Range, ...]:
    """Return the ranges after including the positions of the lane."""
    return tuple(widened(swung, x) for swung, x in zip(ranges, positions(scene, lane), strict=True)) if ranges else ()


def repeat_halves(
    scene: Scene[Any], c: Any, halves: Sequence[Any], ranges: tuple[Range, ...], xp: Any = jnp
) -> tuple[Any, ...]:
    """Return `halves`, half the swings of the positions, at least as large as the bounds from `ranges`.

    A state that never exceeds the rounding errors of a motion, such as one that slides from the beginning on a surface
    through zero, has its typical magnitude as its scale. This exception needs `c`, the scene's constants.
    """
    bounded = []
    for half, (low, high), (size, typical) in zip(
        halves, ranges, _magnitudes(scene, c, ranges, xp), strict=bool(ranges)
    ):
        eps = float(xp.finfo(half.dtype).eps)
        # The second bound on the magnitude allows for rounding errors in float32.
        least = max(LEAST_MAGNITUDE, ROUNDINGS * eps / REPEATS_WITHIN)
        scale = xp.maximum(half, xp.maximum(LEAST_SWING / 2 * (high - low), least * size))
        scale = xp.where(size <= NOISE_ROUNDINGS * eps * typical, typical, scale)
        bounded.append(xp.where(scale > 0, scale, 1.0).astype(half.dtype))
    return tuple(bounded) if ranges else tuple(halves)


def features(
    scene: Scene[Any], c: Any, measured: Mapping[str, Any], ranges: tuple[Range, ...], xp: Any = jnp
) -> dict[str, Any]:
    """Return scales, `at_rest` and `trend` of lanes from other features; empty without `ranges` since t = 0.

    A trend of a swing that is negligible since t = 0 does not count: it may decay for ever.
    """
    if not ranges:
        return {}
    section = section_of(scene)
    halves = [measured[swing.amplitude] for swing in section.swings]
    scales = repeat_halves(scene, c, halves, ranges, xp)
    rests = [
        (2 * half <= REST_SWING * size) | (size <= NOISE_ROUNDINGS * float(xp.finfo(half.dtype).eps) * typical)
        for half, (size, typical) in zip(halves, _magnitudes(scene, c, ranges, xp), strict=True)
    ]
    return dict(zip(scale_names(section), scales, strict=True)) | {
        "at_rest": xp.stack(rests).all(axis=0).astype(halves[0].dtype),
        "trend": xp.where(halves[0] > REPEATS_WITHIN * scales[0], measured["trend"], 0.0),
    }


def _magnitudes(scene: Scene[Any], c: Any, ranges: tuple[Range, ...], xp: Any) -> list[tuple[Any, Any]]:
    """Return greatest and typical magnitude of each position in `ranges`; the latter is 0 without constants `c`."""
    section = section_of(scene)
    typical = section.typical(c) if section.typical is not None and c is not None else {}
    magnitudes = []
    for swing, (low, high) in zip(section.swings, ranges, strict=bool(ranges)):
        offset = scene.states[scene.place(swing.position)].offset
        size = xp.maximum(xp.abs(low + offset), xp.abs(high + offset))
        magnitudes.append((size, typical.get(swing.position, 0.0 * size)))
    return magnitudes


def scale_names(section: Section | None) -> list[str]:
    """Return the names of the features that store the scales of the positions; empty if these are the amplitudes."""
    return [] if section is None or section.typical is None else [f"{swing.position}_scale" for swing in section.swings]


def half_names(section: Section) -> list[str]:
    """Return the names of the features that `stored_scales` takes as `halves`."""
    return scale_names(section) or [swing.amplitude for swing in section.swings]


def stored_scales(section: Section, halves: Sequence[Any], period: Any, states: Sequence[Any]) -> list[Any]:
    """Return the scales of the compared states from stored features, for distances from limits and orbits.

    `states`: values of the compared states at the section. If a state may stand still, they bound its scale from below.
    """
    scales = section.scales(halves, period)
    if section.typical is None:
        return scales
    return [np.maximum(scale, STANDING_SCALE * np.abs(state)) for scale, state in zip(scales, states, strict=True)]
