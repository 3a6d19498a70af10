"""Gauges of the motion: amplitudes, their trend, phase lag, fractions of time sticking and in reverse, drive power."""

from dataclasses import dataclass
from math import factorial, pi
from typing import Any, NamedTuple

from vibrojax.lazy import jax, jnp
from vibrojax.measures.gauge import Gauge, Moment, Return, Sums, Whole
from vibrojax.physics.arrays import Array, Lanes, keep
from vibrojax.scenes.capabilities import HasFriction
from vibrojax.scenes.declared import Section
from vibrojax.scenes.scene import Scene
from vibrojax.stepping import Lane, Step
from vibrojax.stepping.polynomial import extremes, integral, value
from vibrojax.stepping.series import known

EIGHTHS = 8
"""Number of equal parts of the observation over which a trend must hold."""

TREND_CHANGE = 0.01
"""Relative change of the amplitude over the observation above which the change counts as a trend."""


class Swung(NamedTuple):
    """Extremes of the section's oscillating positions (`Section.swings`), such as x1 and x2, during the observation.

    - `ranges`: least and greatest value of each position.
    - `greatest` (8, lanes): greatest amplitude of the first position in each eighth of the observation.
    """

    ranges: tuple[tuple[Lanes, Lanes], ...]
    greatest: Array


@dataclass(frozen=True)
class Swings(Gauge[Scene[Any]]):
    """Amplitudes [m] of the section's oscillating positions (`Section.swings`), and trend.

    trend is 1 if the amplitude of the first position grows steadily, -1 if it decays steadily, else 0.
    """

    checked = True

    def begin(self, scene: Scene[Any], c: Any, lane: Lane) -> Swung:
        places = positions(scene, lane)
        none = jnp.full((EIGHTHS, *places[0].shape), jnp.nan, places[0].dtype)
        return Swung(tuple((x, x) for x in places), none)

    def step(self, scene: Scene[Any], c: Any, carry: Swung, moment: Moment) -> Swung:
        ranges, step = [], moment.step
        for swing, swung, x in zip(section_of(scene).swings, carry.ranges, positions(scene, moment.lane), strict=True):
            low, high = widened(swung, x)
            if swing.velocity is None:  # no marker ends steps at the turning points
                polynomial = step.polynomials[scene.place(swing.position)]
                least, greatest = extremes(polynomial, step.tau)
                low, high = jnp.minimum(low, least), jnp.maximum(high, greatest)
            ranges.append((low, high))
        return carry._replace(ranges=tuple(ranges))

    def section(self, scene: Scene[Any], c: Any, carry: Swung, crossing: Return) -> Swung:
        eighth = jnp.clip(jnp.floor(crossing.share * EIGHTHS), 0, EIGHTHS - 1)
        index = jnp.arange(EIGHTHS, dtype=eighth.dtype).reshape(-1, *[1] * crossing.here.ndim)
        mine = crossing.here[None] & (crossing.number[None] > 0) & (eighth[None] == index)
        greatest = jnp.where(mine, jnp.fmax(carry.greatest, crossing.amplitudes[0][None]), carry.greatest)
        return carry._replace(greatest=greatest)

    def read(self, scene: Scene[Any], c: Any, carry: Swung, whole: Whole) -> dict[str, Lanes]:
        swings = zip(section_of(scene).swings, carry.ranges, strict=True)
        amplitudes = {swing.amplitude: (highest - lowest) / 2 for swing, (lowest, highest) in swings}
        return amplitudes | {"trend": _trend(carry.greatest)}


def section_of(scene: Scene[Any]) -> Section:
    """Return the scene's section, which every scene with gauges has."""
    assert scene.section is not None
    return scene.section


def positions(scene: Scene[Any], lane: Lane) -> list[Lanes]:
    """Return the values of the section's oscillating positions, such as x1 and x2."""
    return [lane.state[scene.place(swing.position)] for swing in section_of(scene).swings]


def widened(extremes: tuple[Lanes, Lanes], x: Lanes) -> "tuple[jax.Array, jax.Array]":
    """Return the least and greatest value after including `x`."""
    lowest, highest = extremes
    return jnp.minimum(lowest, x), jnp.maximum(highest, x)


def _trend(greatest: Array) -> "jax.Array":
    """Return 1 if the amplitudes of the eighths increase strictly, -1 if they decrease strictly, else 0.

    The change from the first to the last eighth must exceed 1 %.
    """
    change = jnp.diff(greatest, axis=0)  # NaN if an eighth has no section crossing; there is then no trend
    first, last = greatest[0], greatest[-1]
    grows = jnp.all(change > 0, axis=0) & (last > (1 + TREND_CHANGE) * first)
    decays = jnp.all(change < 0, axis=0) & (last < (1 - TREND_CHANGE) * first)
    return jnp.where(grows, 1.0, jnp.where(decays, -1.0, 0.0))


@dataclass(frozen=True)
class Faults(Gauge[Scene[Any]]):
    """fault: why the motion cannot go on, an index into the scene's `fault_reasons`."""

    checked = True

    def begin(self, scene: Scene[Any], c: Any, lane: Lane) -> Lanes:
        return scene.fault(lane.mode)

    def step(self, scene: Scene[Any], c: Any, carry: Lanes, moment: Moment) -> Lanes:
        return scene.fault(moment.lane.mode)

    def read(self, scene: Scene[Any], c: Any, carry: Lanes, whole: Whole) -> dict[str, Lanes]:
        return {"fault": carry}


@dataclass(frozen=True)
class Shares(Gauge[HasFriction[Any]]):
    """stick_fraction, reverse_fraction, stick_slip_index [1], drive_power [W], and with a striker striker_turns [1].

    stick_slip_index is half the range of the bit's sliding velocity in the observation over the drive speed, which is
    the mean sliding velocity of a periodic motion. drive_power is the mean of F v. striker_turns is the number of
    maxima of the striker's position per return interval. The striker's position is the second of the section's
    oscillating positions.
    """

    summed = ("stick", "reverse", "turns", "friction")
    needs = (HasFriction,)

    def increments(self, scene: HasFriction[Any], c: Any, moment: Moment) -> Sums:
        step = moment.step
        slip = step.mode[scene.mode_place("slip")]
        turns: Lanes = jnp.zeros_like(step.dt)
        if (striker := _striker(scene)) is not None:
            turn = scene.marker_of(striker)
            turns = (step.hits[turn] & step.falling[turn]).astype(step.dt.dtype)
        return {
            "stick": jnp.where(slip == 0, step.dt, 0),
            "reverse": jnp.where(slip < 0, step.dt, 0),
            "turns": turns,
            "friction": _friction_impulse(scene, c, step),
        }

    def begin(self, scene: HasFriction[Any], c: Any, lane: Lane) -> tuple[Lanes, Lanes]:
        velocity = lane.state[scene.place(scene.bit_velocity)]
        return velocity, velocity

    def step(self, scene: HasFriction[Any], c: Any, carry: tuple[Lanes, Lanes], moment: Moment) -> tuple[Lanes, Lanes]:
        low, high = extremes(moment.step.polynomials[scene.place(scene.bit_velocity)], moment.step.tau)
        return jnp.minimum(carry[0], low), jnp.maximum(carry[1], high)

    def read(self, scene: HasFriction[Any], c: Any, carry: tuple[Lanes, Lanes], whole: Whole) -> dict[str, Lanes]:
        drive, (low, high) = scene.bit(c).drive_speed, carry
        turns = {"striker_turns": whole.sums["turns"] / whole.returns} if _striker(scene) is not None else {}
        return {
            "stick_fraction": whole.sums["stick"] / whole.time,
            "reverse_fraction": whole.sums["reverse"] / whole.time,
            "stick_slip_index": jnp.where(drive > 0, (high - low) / (2 * jnp.where(drive > 0, drive, 1)), jnp.nan),
            "drive_power": whole.sums["friction"] / whole.time * drive,
            **turns,
        }


def _striker(scene: HasFriction[Any]) -> str | None:
    """Return the name of the striker's velocity, or None if the section has only one oscillating position."""
    swings = section_of(scene).swings
    return swings[1].velocity if len(swings) > 1 else None


def _friction_impulse(scene: HasFriction[Any], c: Any, step: Step) -> Lanes:
    """Return the integral of F over the step [N s], while sliding and while sticking.

    It is the impulse of the net spring force minus the bit's change of momentum.
    """
    pull = scene.pull(c, tuple(known(polynomial) for polynomial in step.polynomials))
    spring = step.h * integral([pull[k] for k in range(len(step.polynomials[0]))], step.tau)
    velocity = scene.place(scene.bit_velocity)
    return spring - scene.bit(c).mass * (step.after[velocity] - step.before[velocity])


GAUSS_NODE = 0.15**0.5
"""Distance of the outer nodes of three-point Gauss quadrature from the middle of a step, as a fraction of the step."""


@dataclass(frozen=True)
class Harmonics(Gauge[Scene[Any]]):
    """phase_lag [rad] in (-pi, pi]: lag of the striker's position (x2) behind the bit's position (x1).

    The frequency of the harmonics is the frequency of the section crossings. The Fourier integrals of a position minus
    its mean use three-point Gauss quadrature on the steps' polynomials. Steps before the frequency is known are left
    out. If a period has several return intervals, the frequency follows from their mean duration.
    """

    summed = ("known", "cos0", "sin0", "mean1", "cos1", "sin1", "mean2", "cos2", "sin2")

    def increments(self, scene: Scene[Any], c: Any, moment: Moment) -> Sums:
        step = moment.step
        dt = jnp.where(moment.frequency > 0, step.dt, 0)
        turned = moment.frequency * step.dt
        cos, sin = keep(cos_sin(moment.phase - turned / 2))
        cos_off, sin_off = keep(cos_sin(turned * GAUSS_NODE))
        outer, inner = dt * (5 / 18), dt * (4 / 9)
        waves = keep(
            [
                (outer, outer * (cos * cos_off + sin * sin_off), outer * (sin * cos_off - cos * sin_off)),
                (inner, inner * cos, inner * sin),
                (outer, outer * (cos * cos_off - sin * sin_off), outer * (sin * cos_off + cos * sin_off)),
            ]
        )
        known, cos, sin = (sum(wave) for wave in zip(*waves, strict=True))
        sums = {"known": known, "cos0": cos, "sin0": sin}
        assert scene.section is not None
        for name, swing in zip(("1", "2"), scene.section.swings, strict=False):
            x = step.polynomials[scene.place(swing.position)]
            values = keep([value(x, step.tau * (0.5 + node)) for node in (-GAUSS_NODE, 0.0, GAUSS_NODE)])
            for kind, weight in zip(("mean", "cos", "sin"), zip(*waves, strict=True), strict=True):
                sums[kind + name] = sum(k * y for k, y in zip(weight, values, strict=True))
        return sums

    def read(self, scene: Scene[Any], c: Any, carry: Any, whole: Whole) -> dict[str, Lanes]:
        sums = whole.sums

        def integral(kind: str, name: str) -> Lanes:
            return sums[kind + name] - sums["mean" + name] / sums["known"] * sums[kind + "0"]

        cos1, sin1, cos2, sin2 = (integral(kind, name) for name in "12" for kind in ("cos", "sin"))
        # The striker's lag is arg(X2* X1) with X = cos - i sin.
        across = sin2 * cos1 - cos2 * sin1
        along = cos2 * cos1 + sin2 * sin1
        lag = jnp.arctan2(across, along)
        return {"phase_lag": jnp.where((across == 0) & (along == 0), jnp.nan, lag)}


_COS = [(-1.0) ** k / factorial(2 * k) for k in range(9)]
_SIN = [(-1.0) ** k / factorial(2 * k + 1) for k in range(9)]
# pi/2 as a sum of two numbers. The first has so few digits that its product with any number of quarters used here is
# exact.
_QUARTER = 1.5707963109016418
_REST = 1.5893254773528196e-08


def cos_sin(angle: Lanes) -> "tuple[jax.Array, jax.Array]":
    """Return (cos, sin) of `angle` [rad] of any shape, accurate to a few rounding errors of the angle.

    On a CPU, the library functions would be called for one lane at a time. Instead, Taylor polynomials are evaluated
    for angles up to pi/4 and rotated by multiples of pi/2.
    """
    quarters = jnp.round(angle * (2 / pi))
    rest = (angle - quarters * _QUARTER) - quarters * _REST
    square = rest * rest
    cos, sin = value(_COS, square), rest * value(_SIN, square)
    odd = quarters - 2 * jnp.floor(quarters / 2) > 0.5
    cos, sin = jnp.where(odd, sin, cos), jnp.where(odd, cos, sin)
    quarter = quarters - 4 * jnp.floor(quarters / 4)
    return jnp.where((quarter > 0.5) & (quarter < 2.5), -cos, cos), jnp.where(quarter > 1.5, -sin, sin)
