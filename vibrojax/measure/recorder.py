"""Runs the gauges of a scene alongside its steps, and reads the features at the end."""

from dataclasses import dataclass

import jax.numpy as jnp

from vibrojax.measure import ledger, section
from vibrojax.measure._gauge import Gauge, Moment, Return, Whole


@dataclass(frozen=True)
class Recorder:
    """The gauges of an observation, over whole returns to the section (contract: dataset)."""

    gauges: tuple[Gauge, ...]
    watch = section

    def begin(self, scene, p, lane, returns: dict) -> dict:
        """What is carried at the start of the observation; `returns` is what the settling knows of the section."""
        names = ("time", *(name for gauge in self.gauges for name in gauge.summed))
        return {
            "returns": section.observe(returns),
            "ledger": ledger.begin(names, lane.state[0]),
            "gauges": [gauge.begin(scene, p, lane) for gauge in self.gauges],
        }

    def step(self, scene, p, carry: dict, lane, step) -> dict:
        """Take in a step."""
        returns = section.step(scene, p, carry["returns"], lane, step)
        moment = Moment(lane, step, *(returns[name] for name in ("since", "frequency", "phase")))
        increments = {"time": step.dt}
        for gauge in self.gauges:
            increments |= gauge.increments(scene, p, moment)
        gauges = [gauge.step(scene, p, own, moment) for gauge, own in zip(self.gauges, carry["gauges"], strict=True)]
        return {"returns": returns, "ledger": ledger.add(carry["ledger"], increments), "gauges": gauges}

    def turn_over(self, scene, p, carry: dict, lane, share) -> dict:
        """Take in the returns of the lanes that wait at the section; `share` of the observation is over."""
        returns = carry["returns"]
        here, number = returns["waiting"], returns["number"]
        kept, sums = ledger.section(carry["ledger"], here, number)
        bit, striker = section.amplitudes(returns)
        at = Return(here, number, returns["since"], bit, striker, share, lane, sums)
        gauges = [gauge.section(scene, p, own, at) for gauge, own in zip(self.gauges, carry["gauges"], strict=True)]
        return {"returns": section.turn_over(returns, lane), "ledger": kept, "gauges": gauges}

    def read(self, scene, p, carry: dict) -> dict:
        """The features of every lane, by name: those of the gauges, and returns, cycles, period, settling_time."""
        returns = carry["returns"]
        everything, intervals = ledger.whole(carry["ledger"], returns["number"], jnp.zeros_like(returns["number"]))
        unknown = Whole(intervals, everything["time"], everything, jnp.zeros_like(intervals))
        first = self._features(scene, p, carry, unknown)
        period = everything["time"] / intervals
        cycles = section.cycles(returns, first["bit_amplitude"], first["striker_amplitude"], period)
        sums, whole_returns = ledger.whole(carry["ledger"], returns["number"], cycles)
        features = self._features(scene, p, carry, Whole(whole_returns, sums["time"], sums, cycles))
        return features | {
            "returns": returns["number"],
            "cycles": cycles,
            "period": sums["time"] / whole_returns,
            "settling_time": section.settling_time(returns, cycles),
        }

    def _features(self, scene, p, carry, whole):
        features = {}
        for gauge, own in zip(self.gauges, carry["gauges"], strict=True):
            features |= gauge.read(scene, p, own, whole)
        return features
