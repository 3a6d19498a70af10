"""Shares of time in stick and in reverse, the striker's turns, and the power of the drive."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp

from vibrojax.measures.gauge import Gauge, Moment, Sums, Whole
from vibrojax.models.arrays import Lanes
from vibrojax.models.scenes.capabilities import HasFriction
from vibrojax.stepping import Step
from vibrojax.stepping.polynomial import integral
from vibrojax.stepping.series import known


@dataclass(frozen=True)
class Shares(Gauge[HasFriction[Any]]):
    """stick_fraction, reverse_fraction [1], striker_turns [1], drive_power [W]: mean F v.

    The striker is the section's second swing; where there is none, nothing is said of its turns.
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
            "friction": friction_impulse(scene, c, step),
        }

    def read(self, scene: HasFriction[Any], c: Any, carry: Any, whole: Whole) -> dict[str, Lanes]:
        turns = {"striker_turns": whole.sums["turns"] / whole.returns} if _striker(scene) is not None else {}
        return {
            "stick_fraction": whole.sums["stick"] / whole.time,
            "reverse_fraction": whole.sums["reverse"] / whole.time,
            "drive_power": whole.sums["friction"] / whole.time * scene.bit(c).drive_speed,
            **turns,
        }


def _striker(scene: HasFriction[Any]) -> str | None:
    """The velocity of the section's second swing, if there is one."""
    assert scene.section is not None
    return scene.section.swings[1].velocity if len(scene.section.swings) > 1 else None


def friction_impulse(scene: HasFriction[Any], c: Any, step: Step) -> Lanes:
    """Integral of F over the step [N s], what the spring force did not give to the bit: sliding and in stick alike."""
    pull = scene.pull(c, tuple(known(one) for one in step.polynomials))
    spring = step.h * integral([pull[k] for k in range(len(step.polynomials[0]))], step.tau)
    velocity = scene.place(scene.bit_velocity)
    return spring - scene.bit(c).mass * (step.after[velocity] - step.before[velocity])
