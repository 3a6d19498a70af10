"""Steppers: time integration of many lanes at once, with the interface [vibrojax.stepping.stepper.Stepper][]."""

from vibrojax.physics.arrays import keep
from vibrojax.stepping.located import LOCATED_STRIDE, Located, Varied
from vibrojax.stepping.smoothed import Smoothed
from vibrojax.stepping.stepper import Accuracy, AccuracyRequest, Clock, Goal, Lane, Step, Stepper, lane_at

__all__ = ["LOCATED_STRIDE", "STEPPERS", "Accuracy", "Clock", "Goal", "Lane", "Located", "Smoothed", "Step", "Stepper"]
__all__ += ["AccuracyRequest", "Varied", "keep", "lane_at", "stepper_named"]

STEPPERS: dict[str, Stepper] = {stepper.name: stepper for stepper in (Located(), Smoothed())}


def stepper_named(stepper: str | Stepper) -> Stepper:
    """Return the stepper with this name; a stepper object is returned unchanged.

    Raises `KeyError` if the name is unknown.
    """
    return stepper if isinstance(stepper, Stepper) else STEPPERS[stepper]
