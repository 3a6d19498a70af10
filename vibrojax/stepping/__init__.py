"""Ways to step many lanes at once, behind one interface, [vibrojax.stepping.stepper.Stepper][]."""

from vibrojax.models.arrays import keep as keep
from vibrojax.stepping import functions as functions
from vibrojax.stepping.lane import Clock as Clock
from vibrojax.stepping.lane import Lane as Lane
from vibrojax.stepping.lane import Step as Step
from vibrojax.stepping.lane import lane_at as lane_at
from vibrojax.stepping.located import LOCATED_STRIDE as LOCATED_STRIDE
from vibrojax.stepping.located import Located as Located
from vibrojax.stepping.smoothed import Smoothed as Smoothed
from vibrojax.stepping.stepper import Accuracy as Accuracy
from vibrojax.stepping.stepper import Goal as Goal
from vibrojax.stepping.stepper import Stepper as Stepper
from vibrojax.stepping.stepper import Wanted as Wanted

STEPPERS: dict[str, Stepper] = {stepper.name: stepper for stepper in (Located(), Smoothed())}


def stepper_named(stepper: str | Stepper) -> Stepper:
    """The stepper of that name, or a stepper itself; raises `KeyError` where there is none of the name."""
    return stepper if isinstance(stepper, Stepper) else STEPPERS[stepper]
