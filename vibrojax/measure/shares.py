"""Shares of time in stick and in reverse, the striker's turns, and the power of the drive."""

from dataclasses import dataclass

import jax.numpy as jnp

from vibrojax.measure._gauge import Gauge
from vibrojax.stepping.polynomial import integral
from vibrojax.stepping.series import known


@dataclass(frozen=True)
class Shares(Gauge):
    """stick_fraction, reverse_fraction [1], striker_turns [1], drive_power [W]: mean F v."""

    summed = ("stick", "reverse", "turns", "friction")

    def increments(self, scene, p, moment):
        step = moment.step
        slip = step.mode[0]
        return {
            "stick": jnp.where(slip == 0, step.dt, 0),
            "reverse": jnp.where(slip < 0, step.dt, 0),
            "turns": (step.hits[scene.striker_turn] & step.falling[1]).astype(step.dt.dtype),
            "friction": friction_impulse(scene, p, step),
        }

    def read(self, scene, p, carry, whole):
        return {
            "stick_fraction": whole.sums["stick"] / whole.time,
            "reverse_fraction": whole.sums["reverse"] / whole.time,
            "striker_turns": whole.sums["turns"] / whole.returns,
            "drive_power": whole.sums["friction"] / whole.time * p["v"],
        }


def friction_impulse(scene, p, step):
    """Integral of F over the step [N s], what the spring force did not give to the bit: sliding and in stick alike."""
    pull = scene.pull(p, tuple(known(one) for one in step.polynomials))
    spring = step.h * integral([pull[k] for k in range(len(step.polynomials[0]))], step.tau)
    return spring - p["m1"] * (step.after[1] - step.before[1])
