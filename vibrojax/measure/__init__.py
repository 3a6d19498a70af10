"""Measuring in the loop: features of a lane are accumulated while it steps, over whole returns to the section."""

from vibrojax.measure import section as section
from vibrojax.measure._gauge import Gauge as Gauge
from vibrojax.measure.drilling import Drilling
from vibrojax.measure.harmonics import Harmonics
from vibrojax.measure.impacts import Impacts
from vibrojax.measure.kept_returns import KeptReturns
from vibrojax.measure.pulses import PulseRecorder as PulseRecorder
from vibrojax.measure.recorder import Recorder as Recorder
from vibrojax.measure.shares import Shares
from vibrojax.measure.swings import Swings

GAUGES = {
    "swings": Swings(),
    "shares": Shares(),
    "impacts": Impacts(),
    "harmonics": Harmonics(),
    "drilling": Drilling(),
}


def recorder_for(scene, keep_returns: int = 0) -> Recorder | PulseRecorder:
    """The recorder of what the scene names in `measures`, keeping the last `keep_returns` returns one by one."""
    if scene.measures == ("penetration",):
        return PulseRecorder()
    kept = (KeptReturns(keep_returns),) if keep_returns else ()
    return Recorder((*(GAUGES[name] for name in scene.measures), *kept))
