"""Measuring in the loop: features of a lane are accumulated while it steps, over whole returns to the section."""

from typing import Any

from vibrojax.errors import InputError, shown
from vibrojax.measures import section as section
from vibrojax.measures.gauge import Gauge as Gauge
from vibrojax.measures.gauge import Moment as Moment
from vibrojax.measures.gauge import Return as Return
from vibrojax.measures.gauge import Whole as Whole
from vibrojax.measures.harmonics import Harmonics
from vibrojax.measures.hole import Hole
from vibrojax.measures.impacts import Impacts
from vibrojax.measures.kept_returns import KeptReturns
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.measures.recorder import Recorder as Recorder
from vibrojax.measures.recorder import Records as Records
from vibrojax.measures.shares import Shares
from vibrojax.measures.swings import Swings
from vibrojax.measures.whole_pulses import PulseRecorder as PulseRecorder
from vibrojax.models.scenes import Driven, HasContact, Scene

RETURNS_FOR_DRIFT = 3 * MOST_CYCLES + 1
"""The fewest that show a repeat of any length three times over."""

GAUGES: dict[str, Gauge[Any]] = {
    "swings": Swings(),
    "shares": Shares(),
    "impacts": Impacts(),
    "harmonics": Harmonics(),
    "drilling": Hole(),
}


def gauge_named(gauge: str | Gauge[Any]) -> Gauge[Any]:
    """The gauge of that name, or a gauge itself; raises `KeyError` where there is none of the name."""
    return gauge if isinstance(gauge, Gauge) else GAUGES[gauge]


def recorder_for(scene: Scene[Any], keep_returns: int = 0) -> Records:
    """The recorder of what the scene names in `measures`.

    The swings and, where there is a contact, the impacts are always measured: repeats and labels go by them. It keeps
    the last returns one by one: `keep_returns` of them, or as many as it takes to tell where a lane is going.

    Raises `InputError` where a gauge needs what the scene does not have, or nothing can be measured of it.
    """
    if scene.section is None:
        if isinstance(scene, Driven):
            return PulseRecorder()
        raise InputError(f"scene: {scene.name} declares neither a section nor pulses; there is nothing to measure over")
    unknown = [gauge for gauge in scene.measures if not isinstance(gauge, Gauge) and gauge not in GAUGES]
    if unknown:
        raise InputError(f"scene: {scene.name} measures {shown(unknown[0])}; choose from {', '.join(GAUGES)}")
    gauges = [gauge_named(gauge) for gauge in scene.measures]
    always = (Swings(), Impacts()) if isinstance(scene, HasContact) else (Swings(),)
    gauges = [*(one for one in always if not any(isinstance(gauge, type(one)) for gauge in gauges)), *gauges]
    for gauge in gauges:
        for need in gauge.needs:
            if not isinstance(scene, need):
                raise InputError(
                    f"scene: {scene.name} is no {need.__name__}; {type(gauge).__name__} measures only those"
                )
    return Recorder(scene.section, (*gauges, KeptReturns(max(keep_returns, RETURNS_FOR_DRIFT))))
