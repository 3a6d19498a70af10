"""Gauges of the striker's impacts on the bit, of the contact force and of the hole; recorder of a prescribed force.

Means over the hole are over return intervals for a drill, and over pulse periods for a prescribed force.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from vibrojax.lazy import jnp
from vibrojax.measures import ledger
from vibrojax.measures.gauge import Gauge, Moment, Return, Sums, Whole
from vibrojax.measures.ledger import Ledger
from vibrojax.measures.recorder import Features, Records
from vibrojax.measures.repeats import GROWTH, ROCK_STATES, TIME, in_order, put_row, rock_scale, state_name
from vibrojax.physics.arrays import Array, Flags, Lanes, keep
from vibrojax.scenes.capabilities import Driven, HasContact, HasFriction, HasImpacts, HasRock
from vibrojax.scenes.scene import Scene
from vibrojax.stepping import Lane, Step
from vibrojax.stepping.polynomial import extremes, highest, integral, value
from vibrojax.stepping.series import known

Pair = tuple[Lanes, Lanes]
"""The slowest and the fastest impact velocity [m/s]."""


class Extremes(NamedTuple):
    """Extreme impact velocities, and the greatest contact force.

    - `since`: velocities since the last section crossing; `whole`: velocities in the complete return intervals.
    - `peak` [N]: greatest contact force.
    """

    since: Pair
    whole: Pair
    peak: Lanes


@dataclass(frozen=True)
class Impacts(Gauge[HasImpacts[Any]]):
    """impacts, impact_velocity(_min, _max), impact_phase.

    For a contact with a force, impact_energy, peak_impact_force and mean_impact_force in addition; for a sliding bit,
    bit_velocity_at_impact. Without `peak`, peak_impact_force is left out.
    """

    peak: bool = True

    summed = ("impacts", "velocity", "velocity_squared", "bit_velocity", "lag", "force")
    needs = (HasImpacts,)

    def for_check(self) -> "Impacts":
        return replace(self, peak=False)

    def increments(self, scene: HasImpacts[Any], c: Any, moment: Moment) -> Sums:
        step = moment.step
        begins, velocity = _begins(scene, c, step)
        sliding = force = jnp.zeros_like(step.after[0])
        if isinstance(scene, HasContact):
            force = step.h * integral(_force(scene, c, step), step.tau)
        if isinstance(scene, HasFriction):  # u = x1' + v [m/s]
            sliding = step.after[scene.place(scene.bit_velocity)] + scene.bit(c).drive_speed
        return {
            "impacts": begins.astype(step.dt.dtype),
            "velocity": jnp.where(begins, velocity, 0),
            "velocity_squared": jnp.where(begins, velocity * velocity, 0),
            "bit_velocity": jnp.where(begins, sliding, 0),
            "lag": jnp.where(begins, moment.since, 0),
            "force": force,
        }

    def close(self, sums: Sums, interval: Lanes) -> Sums:
        """Return the sum of the impact lags as fractions of the return interval in which the impacts occur."""
        return {"lag": sums["lag"] / interval}

    def begin(self, scene: HasImpacts[Any], c: Any, lane: Lane) -> Extremes:
        like = jnp.zeros_like(lane.state[0])
        none = (jnp.full_like(like, jnp.inf), jnp.full_like(like, -jnp.inf))
        peak = scene.contact_force(c, lane.mode, lane.state) if isinstance(scene, HasContact) else like
        return Extremes(none, none, peak)

    def step(self, scene: HasImpacts[Any], c: Any, carry: Extremes, moment: Moment) -> Extremes:
        step = moment.step
        begins, velocity = _begins(scene, c, step)
        since = _updated(carry.since, begins, velocity, velocity)
        if self.peak and isinstance(scene, HasContact):
            carry = carry._replace(peak=jnp.maximum(carry.peak, highest(_force(scene, c, step), step.tau)))
        return carry._replace(since=since)

    def section(self, scene: HasImpacts[Any], c: Any, carry: Extremes, crossing: Return) -> Extremes:
        slowest, fastest = carry.since
        whole = _updated(carry.whole, crossing.here & (crossing.number > 0), slowest, fastest)
        since = (jnp.where(crossing.here, jnp.inf, slowest), jnp.where(crossing.here, -jnp.inf, fastest))
        return Extremes(since, whole, carry.peak)

    def read(self, scene: HasImpacts[Any], c: Any, carry: Extremes, whole: Whole) -> dict[str, Lanes]:
        sums, count = whole.sums, whole.sums["impacts"]
        per_return = count / whole.returns
        slowest, fastest = carry.whole
        sliding = {"bit_velocity_at_impact": sums["bit_velocity"] / count} if isinstance(scene, HasFriction) else {}
        forces = {}
        if isinstance(scene, HasContact):
            forces = {
                "impact_energy": scene.striker_mass(c) / 2 * sums["velocity_squared"] / count,
                "mean_impact_force": sums["force"] / whole.time,
                **({"peak_impact_force": carry.peak} if self.peak else {}),
            }
        return sliding | {
            "impacts": jnp.where(whole.cycles > 0, jnp.round(per_return * whole.cycles), per_return),
            "impact_velocity": sums["velocity"] / count,
            "impact_velocity_min": jnp.where(count > 0, slowest, jnp.nan),
            "impact_velocity_max": jnp.where(count > 0, fastest, jnp.nan),
            "impact_phase": 2 * jnp.pi * sums["lag"] / count,
            **forces,
        }


def _begins(scene: HasImpacts[Any], c: Any, step: Step) -> tuple[Flags, Lanes]:
    """Return a mask of the lanes in which an impact begins at the end of the step, and the impact velocity [m/s]."""
    begins = keep(scene.impact_begins(c, step.mode, step.after, step.hits))
    return begins, scene.impact_rate(c, step.mode, step.after)


def _updated(extremes: Pair, where: Flags, slowest: Lanes, fastest: Lanes) -> Pair:
    low, high = extremes
    return jnp.where(where, jnp.minimum(low, slowest), low), jnp.where(where, jnp.maximum(high, fastest), high)


def _force(scene: HasContact[Any], c: Any, step: Step) -> list[Lanes]:
    """Return the coefficients in tau of the contact force J [N] over the step."""
    force = scene.contact_force(c, step.mode, tuple(known(polynomial) for polynomial in step.polynomials))
    return keep([force[k] for k in range(len(step.polynomials[0]))])


@dataclass(frozen=True)
class Hole(Gauge[HasRock[Any]]):
    """rate_of_penetration [m/s], slip_per_impact [m], mean_force [N], relief [1], deepest_gap [m].

    The gauge needs a scene with rock and contact. mean_force is the mean contact force P; relief is P divided by the
    yield force. deepest_gap is the least compression of the rock since the observation began, at most 0: -d means that
    the bit was at the distance d above the rock. The gauge uses the sums of the gauge in
    [vibrojax.measures.impacts][], which must also be present.
    """

    summed = ("growth",)
    needs = (HasRock, HasContact)
    checked = True

    def increments(self, scene: HasRock[Any], c: Any, moment: Moment) -> Sums:
        return {"growth": _growth(scene, moment.step)}

    def begin(self, scene: HasRock[Any], c: Any, lane: Lane) -> Pair:
        compression = lane.state[scene.place("compression")]
        return jnp.minimum(compression, 0), compression

    def step(self, scene: HasRock[Any], c: Any, carry: Pair, moment: Moment) -> Pair:
        low, high = extremes(moment.step.polynomials[scene.place("compression")], moment.step.tau)
        return jnp.minimum(carry[0], low), jnp.maximum(carry[1], high)

    def read(self, scene: HasRock[Any], c: Any, carry: Pair, whole: Whole) -> Sums:
        rates = _rates(scene, c, whole.sums, whole.time, whole.sums["impacts"], carry[0])
        return rates | _scales(scene, c, ROCK_STATES) | {"load": _load(scene, c, carry[1])}


class Pulses(NamedTuple):
    """The carry of the pulse recorder.

    - `waiting`: mask of the lanes at the beginning of a pulse; `number`: number of pulses that have begun so far.
    - `ledger`: the sums; `deepest` [m]: least compression of the rock so far, at most 0; -d at a distance d above it.
    - `tightest` [m]: greatest compression so far.
    - `last`: time, states, and growth of the hole since the previous pulse, at the beginning of the last pulses; a ring
      buffer (pulses, features, lanes).
    """

    waiting: Flags
    number: Lanes
    ledger: Ledger
    deepest: Lanes
    tightest: Lanes
    last: Array


@dataclass(frozen=True)
class PulseRecorder(Records):
    """rate_of_penetration [m/s], slip_per_impact [m], mean_force [N], relief [1], deepest_gap [m], pulses, yields.

    Means are over complete pulse periods, and NaN if there are none. Under a swept sine, means are over the whole
    observation. Nothing is recorded before the observation. Further features, from which the error is estimated: the
    states at the beginning of the last `keep` pulses with their scales, and `load`, the greatest force of the rock over
    its yield force.
    """

    keep: int

    def begin(self, scene: Scene[Any], c: Any, lane: Lane, settled: tuple[()]) -> Pulses:
        compression = lane.state[scene.place("compression")]
        # The first pulse begins at t = 0, without an event.
        first = (lane.clock.high == 0) & _driven(scene).has_pulses
        sums = ledger.begin(("time", "growth", "force", "yields"), compression)
        rows = self.keep if _driven(scene).has_pulses else 0
        last = jnp.full((rows, len(_kept(scene)), *compression.shape), jnp.nan, compression.dtype)
        return Pulses(first, jnp.zeros_like(compression), sums, jnp.minimum(compression, 0), compression, last)

    def step(self, scene: Scene[Any], c: Any, carry: Pulses, lane: Lane, step: Step) -> Pulses:
        states = tuple(known(polynomial) for polynomial in step.polynomials)
        force = _driven(scene).applied_force(c, step.mode, states).arrays(len(step.polynomials[0]) - 1, step.dt)
        yields = step.hits["yield"] & (step.mode[scene.mode_place("rock")] == 0)
        increments = {
            "time": step.dt,
            "growth": _growth(scene, step),
            "force": step.h * integral(force, step.tau),
            "yields": yields.astype(step.dt.dtype),
        }
        return carry._replace(
            waiting=carry.waiting | _driven(scene).pulse_begins(c, step.mode, step.hits),
            ledger=ledger.add(carry.ledger, increments),
            deepest=jnp.minimum(carry.deepest, lane.state[scene.place("compression")]),
            tightest=jnp.maximum(carry.tightest, lane.state[scene.place("compression")]),
        )

    def waiting(self, carry: Pulses) -> Flags:
        return carry.waiting

    def take_returns(self, scene: Scene[Any], c: Any, carry: Pulses, lane: Lane, share: Lanes) -> Pulses:
        here, number = carry.waiting, carry.number
        totals, since = ledger.section(carry.ledger, here, number)
        last = carry.last
        if len(last):
            states = [lane.state[scene.place(name)] for name in scene.return_states]
            growth = jnp.where(number > 0, since["growth"], jnp.nan)
            last = put_row(last, here, number, [lane.clock.high, *states, growth])
        number = jnp.where(here, number + 1, number)
        return carry._replace(waiting=jnp.zeros_like(here), number=number, ledger=totals, last=last)

    def read(self, scene: Scene[Any], c: Any, carry: Pulses) -> Features:
        number = carry.number
        whole, pulses = ledger.whole(carry.ledger, number, jnp.zeros_like(number))
        # An incomplete pulse period at either end would bias the means. Without pulses the whole observation is used.
        alone = jnp.zeros_like(number, bool) if _driven(scene).has_pulses else number == 0
        sums = {name: jnp.where(alone, carry.ledger.sums[name], whole[name]) for name in whole}
        last: Features = {}
        if len(carry.last):  # from which the error is estimated
            last = in_order(carry.last, _kept(scene)) | _scales(_driven(scene), c, scene.return_states)
            last |= {"load": _load(_driven(scene), c, carry.tightest)}
            del last[TIME]
        return {
            **last,
            **_rates(_driven(scene), c, sums, sums["time"], pulses, carry.deepest),
            "pulses": pulses,
            "yields": sums["yields"],
        }


def _driven(scene: Scene[Any]) -> Any:
    """Return the scene after checking that it has a prescribed force and rock."""
    assert isinstance(scene, Driven) and isinstance(scene, HasRock)
    return scene


def _kept(scene: Scene[Any]) -> tuple[str, ...]:
    """Return the names of the features at the beginning of a pulse."""
    return (TIME, *map(state_name, scene.return_states), GROWTH)


def _scales(scene: HasRock[Any], c: Any, names: Sequence[str]) -> Features:
    """Return the scales of lengths and velocities at which the elastic and the kinetic energy make the rock yield."""
    length = scene.threshold(c) / scene.stiffness(c)
    velocity = length / scene.rock_period(c)
    states = {name: scene.states[scene.place(name)] for name in names}
    return {rock_scale(name): velocity if state.is_velocity else length for name, state in states.items()}


def _load(scene: HasRock[Any], c: Any, tightest: Lanes) -> Lanes:
    """Return the greatest force of the rock over its yield force, from the greatest compression [m]."""
    return tightest * scene.stiffness(c) / scene.threshold(c)


def _growth(scene: Scene[Any], step: Step) -> Lanes:
    """Return the growth of the hole over the step [m]."""
    growth = step.polynomials[scene.place("growth")]
    return value(growth, step.tau) - growth[0]


def _rates(scene: HasRock[Any], c: Any, sums: Mapping[str, Lanes], time: Lanes, blows: Lanes, gap: Lanes) -> Features:
    """Return the features of the hole from the sums over `time` [s]; `blows`: number of impacts or pulses."""
    mean_force = sums["force"] / time
    return {
        "rate_of_penetration": sums["growth"] / time,
        "slip_per_impact": sums["growth"] / blows,
        "mean_force": mean_force,
        "relief": mean_force / scene.threshold(c),
        "deepest_gap": gap,
    }
