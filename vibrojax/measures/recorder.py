"""Runs the gauges of a scene alongside its steps, and reads the features at the end."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp

from vibrojax.measures import ledger, repeats, section
from vibrojax.measures.gauge import Gauge, Moment, Return, Sums, Whole
from vibrojax.measures.ledger import Ledger
from vibrojax.measures.repeats import Returns
from vibrojax.measures.section import Settling
from vibrojax.models.arrays import Flags, Lanes
from vibrojax.models.scenes.declared import Section
from vibrojax.models.scenes.scene import Scene
from vibrojax.stepping import Lane, Step

Features = dict[str, Any]
"""By name: arrays (lanes,), or (rows, lanes) for returns that are kept."""


class Records(ABC):
    """What records the motion of lanes: while they settle, as little as must be known then; then what is observed.

    What is carried is a pytree of arrays whose last axis is lanes, of the recorder's own kind. Its objects are static
    arguments of programs, so it is a frozen dataclass.
    """

    @abstractmethod
    def settling(self, scene: Scene[Any], lane: Lane) -> Any:
        """What is carried at t = 0."""

    @abstractmethod
    def settle(self, scene: Scene[Any], c: Any, carry: Any, lane: Lane, step: Step) -> Any:
        """Take in a step before the observation."""

    @abstractmethod
    def settle_returns(self, carry: Any) -> Any:
        """Take in the returns that have been passed, every few steps."""

    @abstractmethod
    def settled(self, begun: Any, observed: Any) -> Any:
        """What is carried before an observation, where all the way to it was `observed` too: as it was `begun`, with
        what has been seen of returns meanwhile."""

    @abstractmethod
    def begin(self, scene: Scene[Any], c: Any, lane: Lane, settled: Any) -> Any:
        """What is carried at the start of the observation; `settled` is what was carried before."""

    @abstractmethod
    def step(self, scene: Scene[Any], c: Any, carry: Any, lane: Lane, step: Step) -> Any:
        """Take in a step of the observation."""

    @abstractmethod
    def waiting(self, carry: Any) -> Flags:
        """Lanes that wait for their return to be taken in."""

    @abstractmethod
    def take_returns(self, scene: Scene[Any], c: Any, carry: Any, lane: Lane, share: Lanes) -> Any:
        """Take in the returns of the lanes that wait; `share` of the observation is over."""

    @abstractmethod
    def read(self, scene: Scene[Any], c: Any, carry: Any) -> Features:
        """The features of every lane, by name."""


class Observed(NamedTuple):
    """What is carried under observation: the returns, the sums over them, and what each gauge carries."""

    returns: Returns
    ledger: Ledger
    gauges: tuple[Any, ...]


@dataclass(frozen=True)
class Recorder(Records):
    """The gauges of an observation, over whole returns to the scene's section."""

    section: Section
    gauges: tuple[Gauge[Any], ...]

    def settling(self, scene: Scene[Any], lane: Lane) -> Settling:
        return section.begin(self.section, scene, lane)

    def settle(self, scene: Scene[Any], c: Any, carry: Settling, lane: Lane, step: Step) -> Settling:
        return section.pass_by(self.section, scene, c, carry, lane, step)

    def settle_returns(self, carry: Settling) -> Settling:
        return section.take_in_passed(carry)

    def settled(self, begun: Settling, observed: Observed) -> Settling:
        return begun._replace(seen=observed.returns.seen)

    def begin(self, scene: Scene[Any], c: Any, lane: Lane, settled: Settling) -> Observed:
        names = ("time", *(name for gauge in self.gauges for name in gauge.summed))
        gauges = tuple(gauge.begin(scene, c, lane) for gauge in self.gauges)
        return Observed(section.observe(self.section, settled), ledger.begin(names, lane.state[0]), gauges)

    def step(self, scene: Scene[Any], c: Any, carry: Observed, lane: Lane, step: Step) -> Observed:
        returns = section.step(self.section, scene, c, carry.returns, lane, step)
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
        here, number = returns.waiting, returns.number
        interval = returns.seen.since

        def close(sums: Sums) -> Sums:
            replaced: Sums = {}
            for gauge in self.gauges:
                replaced |= gauge.close(sums, interval)
            return replaced

        totals, sums = ledger.section(carry.ledger, here, number, close)
        at = Return(here, number, interval, section.amplitudes(returns), share, lane, sums)
        own = zip(self.gauges, carry.gauges, strict=True)
        gauges = tuple(gauge.section(scene, c, mine, at) for gauge, mine in own)
        return Observed(section.take_in(self.section, scene, returns, lane), totals, gauges)

    def read(self, scene: Scene[Any], c: Any, carry: Observed) -> Features:
        """Those of the gauges, and returns, cycles, period, settling_time."""
        returns = carry.returns
        everything, intervals = ledger.whole(carry.ledger, returns.number, jnp.zeros_like(returns.number))
        unknown = Whole(intervals, everything["time"], everything, jnp.zeros_like(intervals))
        first = self._features(scene, c, carry, unknown)
        period = everything["time"] / intervals
        amplitudes = tuple(first[swing.amplitude] for swing in self.section.swings)
        cycles = repeats.cycles(returns, amplitudes, period)
        sums, whole_returns = ledger.whole(carry.ledger, returns.number, cycles)
        features = self._features(scene, c, carry, Whole(whole_returns, sums["time"], sums, cycles))
        return features | {
            "returns": returns.number,
            "cycles": cycles,
            "period": sums["time"] / whole_returns,
            "settling_time": repeats.settling_time(returns, cycles),
        }

    def _features(self, scene: Scene[Any], c: Any, carry: Observed, whole: Whole) -> Features:
        features: Features = {}
        for gauge, own in zip(self.gauges, carry.gauges, strict=True):
            features |= gauge.read(scene, c, own, whole)
        return features
