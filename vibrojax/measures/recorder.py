"""Recorders, which update a scene's gauges with every step and return the features at the end."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp

from vibrojax.measures import ledger, repeats, section
from vibrojax.measures.gauge import Gauge, Moment, Return, Sums, Whole
from vibrojax.measures.ledger import Ledger
from vibrojax.measures.motion import section_of
from vibrojax.measures.repeats import Returns
from vibrojax.measures.section import Settling
from vibrojax.models.arrays import Flags, Lanes
from vibrojax.models.scenes.scene import Scene
from vibrojax.stepping import Lane, Step

Features = dict[str, Any]
"""Features by name: arrays (lanes,), or (rows, lanes) for section crossings that are stored individually."""


class Records(ABC):
    """A recorder: it computes the features of the observation, and may also record while lanes settle.

    While lanes settle, nothing is recorded by default. The carry is a pytree of arrays whose last axis is lanes.
    Recorder objects are static arguments of compiled programs, so a recorder is a frozen dataclass.
    """

    def settling(self, scene: Scene[Any], lane: Lane) -> Any:
        """Return the carry for the settling time, at t = 0."""
        return ()

    def settle(self, scene: Scene[Any], c: Any, carry: Any, lane: Lane, step: Step) -> Any:
        """Return the carry updated with a step before the observation."""
        return carry

    def settle_returns(self, carry: Any) -> Any:
        """Return the carry after storing the section crossings passed while settling; called once every few steps."""
        return carry

    def settled(self, begun: Any, observed: Any) -> Any:
        """Return the settling carry for an observation that continues another one.

        It is `begun` with the section crossings that the carry `observed` of the previous observation has stored.
        """
        return begun

    @abstractmethod
    def begin(self, scene: Scene[Any], c: Any, lane: Lane, settled: Any) -> Any:
        """Return the carry at the start of the observation; `settled`: the carry at the end of settling."""

    @abstractmethod
    def step(self, scene: Scene[Any], c: Any, carry: Any, lane: Lane, step: Step) -> Any:
        """Return the carry updated with a step of the observation."""

    @abstractmethod
    def waiting(self, carry: Any) -> Flags:
        """Return a mask of the lanes at a section crossing that must be recorded before the lanes continue."""

    @abstractmethod
    def take_returns(self, scene: Scene[Any], c: Any, carry: Any, lane: Lane, share: Lanes) -> Any:
        """Return the carry updated with the section crossings of the waiting lanes.

        `share`: elapsed fraction of the observation.
        """

    @abstractmethod
    def read(self, scene: Scene[Any], c: Any, carry: Any) -> Features:
        """Return the features of every lane, by name."""


class Observed(NamedTuple):
    """The recorder's carry during the observation: section crossings, sums, and the carry of each gauge."""

    returns: Returns
    ledger: Ledger
    gauges: tuple[Any, ...]


@dataclass(frozen=True)
class Recorder(Records):
    """The recorder of gauges, evaluated over complete return intervals of the scene's section."""

    gauges: tuple[Gauge[Any], ...]

    def settling(self, scene: Scene[Any], lane: Lane) -> Settling:
        return section.begin(scene, lane)

    def settle(self, scene: Scene[Any], c: Any, carry: Settling, lane: Lane, step: Step) -> Settling:
        return section.pass_by(scene, c, carry, lane, step)

    def settle_returns(self, carry: Settling) -> Settling:
        return section.take_in_passed(carry)

    def settled(self, begun: Settling, observed: Observed) -> Settling:
        return begun._replace(seen=observed.returns.seen)

    def begin(self, scene: Scene[Any], c: Any, lane: Lane, settled: Settling) -> Observed:
        names = ("time", *(name for gauge in self.gauges for name in gauge.summed))
        gauges = tuple(gauge.begin(scene, c, lane) for gauge in self.gauges)
        return Observed(section.observe(scene, settled), ledger.begin(names, lane.state[0]), gauges)

    def step(self, scene: Scene[Any], c: Any, carry: Observed, lane: Lane, step: Step) -> Observed:
        returns = section.step(scene, c, carry.returns, lane, step)
        moment = Moment(lane, step, returns.seen.since, returns.seen.frequency, returns.phase)
        increments = {"time": step.dt}
        for gauge in self.gauges:
            increments |= gauge.increments(scene, c, moment)
        own = zip(self.gauges, carry.gauges, strict=True)
        gauges = tuple(gauge.step(scene, c, mine, moment) for gauge, mine in own)
        return Observed(returns, ledger.add(carry.ledger, increments), gauges)

    def waiting(self, carry: Observed) -> Flags:
        return carry.returns.waiting

    def take_returns(self, scene: Scene[Any], c: Any, carry: Observed, lane: Lane, share: Lanes) -> Observed:
        returns = carry.returns
        here, number, interval = returns.waiting, returns.number, returns.seen.since

        def close(sums: Sums) -> Sums:
            replaced: Sums = {}
            for gauge in self.gauges:
                replaced |= gauge.close(sums, interval)
            return replaced

        totals, sums = ledger.section(carry.ledger, here, number, close)
        at = Return(here, number, interval, section.amplitudes(returns.seen.ranges), share, lane, sums)
        own = zip(self.gauges, carry.gauges, strict=True)
        gauges = tuple(gauge.section(scene, c, mine, at) for gauge, mine in own)
        return Observed(section.take_in(scene, returns, lane), totals, gauges)

    def read(self, scene: Scene[Any], c: Any, carry: Observed) -> Features:
        """Return the features of the gauges, and in addition returns, cycles, period and settling_time."""

        def features(whole: Whole) -> Features:
            gauges = zip(self.gauges, carry.gauges, strict=True)
            return {name: x for gauge, own in gauges for name, x in gauge.read(scene, c, own, whole).items()}

        returns = carry.returns
        everything, intervals = ledger.whole(carry.ledger, returns.number, jnp.zeros_like(returns.number))
        first = features(Whole(intervals, everything["time"], everything, jnp.zeros_like(intervals)))
        period = everything["time"] / intervals
        amplitudes = tuple(first[swing.amplitude] for swing in section_of(scene).swings)
        cycles = repeats.cycles(returns, amplitudes, period)
        sums, whole_returns = ledger.whole(carry.ledger, returns.number, cycles)
        return features(Whole(whole_returns, sums["time"], sums, cycles)) | {
            "returns": returns.number,
            "cycles": cycles,
            "period": sums["time"] / whole_returns,
            "settling_time": repeats.settling_time(returns, cycles),
        }
