"""Penetration under a given force, over whole pulses: growth of the hole, mean force, how far the bit jumps off."""

from dataclasses import dataclass
from types import SimpleNamespace

import jax.numpy as jnp

from vibrojax.measure import ledger
from vibrojax.stepping.polynomial import integral, value
from vibrojax.stepping.series import known


def _step(scene, p, carry: dict, lane, step) -> dict:
    return carry | {"waiting": carry["waiting"] | scene.pulse_begins(p, step.mode, step.hits)}


def _turn_over(carry: dict, lane) -> dict:
    waiting = carry["waiting"]
    return {"waiting": jnp.zeros_like(waiting), "number": jnp.where(waiting, carry["number"] + 1, carry["number"])}


@dataclass(frozen=True)
class PulseRecorder:
    """rate_of_penetration [m/s], slip_per_impact [m], mean_force [N], relief [1], deepest_gap [m].

    Means are over whole pulses, NaN where there is none; over the whole observation under a swept sine.
    """

    watch = SimpleNamespace(  # before the observation there is nothing to know
        begin=lambda lane: {}, pass_by=lambda scene, p, carry, lane, step: carry, turn_over_passed=lambda carry: carry
    )

    def begin(self, scene, p, lane, returns: dict) -> dict:
        """What is carried at the start of the observation."""
        compression = lane.state[0]
        # At t = 0 a pulse begins that no event tells of.
        first = (lane.clock.high == 0) & scene.has_pulses
        return {
            "returns": {"waiting": first, "number": jnp.zeros_like(compression)},
            "ledger": ledger.begin(("time", "growth", "force", "yields"), compression),
            "deepest": jnp.minimum(compression, 0),
        }

    def step(self, scene, p, carry: dict, lane, step) -> dict:
        """Take in a step."""
        states = tuple(known(one) for one in step.polynomials)
        force = scene.applied_force(p, step.mode, states)
        force = [force.array(k, step.dt) for k in range(len(step.polynomials[0]))]
        growth = step.polynomials[2]
        increments = {
            "time": step.dt,
            "growth": value(growth, step.tau) - growth[0],
            "force": step.h * integral(force, step.tau),
            "yields": (step.hits[0] & (step.mode[0] == 0)).astype(step.dt.dtype),
        }
        return {
            "returns": _step(scene, p, carry["returns"], lane, step),
            "ledger": ledger.add(carry["ledger"], increments),
            "deepest": jnp.minimum(carry["deepest"], lane.state[0]),
        }

    def turn_over(self, scene, p, carry: dict, lane, share) -> dict:
        """Take in the beginnings of pulses."""
        returns = carry["returns"]
        kept, _ = ledger.section(carry["ledger"], returns["waiting"], returns["number"])
        return carry | {"returns": _turn_over(returns, lane), "ledger": kept}

    def read(self, scene, p, carry: dict) -> dict:
        """The features of every lane, by name."""
        number = carry["returns"]["number"]
        whole, pulses = ledger.whole(carry["ledger"], number, jnp.zeros_like(number))
        # A half-open pulse at either end would bias the means; only a force without pulses is taken as it comes.
        alone = jnp.zeros_like(number, bool) if scene.has_pulses else number == 0
        sums = {name: jnp.where(alone, carry["ledger"]["sums"][name], whole[name]) for name in whole}
        mean_force = sums["force"] / sums["time"]
        return {
            "rate_of_penetration": sums["growth"] / sums["time"],
            "slip_per_impact": sums["growth"] / pulses,
            "mean_force": mean_force,
            "relief": mean_force / p["threshold"],
            "deepest_gap": carry["deepest"],
            "pulses": pulses,
            "yields": sums["yields"],
        }
