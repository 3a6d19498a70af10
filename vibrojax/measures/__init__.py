"""Measures: features of a lane, accumulated over its steps and evaluated between section crossings.

A return interval is the time between two successive crossings of the Poincaré section.
"""

from typing import Any

from vibrojax.errors import InputError, shown
from vibrojax.io.variables import VARIABLES
from vibrojax.measures.gauge import Gauge, Moment, Return, Whole
from vibrojax.measures.impacts import Hole, Impacts, PulseRecorder
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.measures.motion import Faults, Harmonics, Shares, Swings
from vibrojax.measures.recorder import Recorder, Records
from vibrojax.measures.repeats import KeptReturns
from vibrojax.scenes import Driven, HasImpacts, Scene

__all__ = ["GAUGES", "RETURNS_FOR_DRIFT", "Gauge", "Moment", "PulseRecorder", "Recorder", "Records", "Return", "Whole"]
__all__ += ["gauge_named", "recorder_for"]

RETURNS_FOR_DRIFT = 3 * MOST_CYCLES + 1
"""Least number of section crossings that contain three periods of any length up to `MOST_CYCLES` return intervals."""

GAUGES: dict[str, Gauge[Any]] = {
    "swings": Swings(),
    "shares": Shares(),
    "impacts": Impacts(),
    "harmonics": Harmonics(),
    "faults": Faults(),
    "drilling": Hole(),
}


def gauge_named(gauge: str | Gauge[Any]) -> Gauge[Any]:
    """Return the gauge with this name; a gauge object is returned unchanged.

    Raises `KeyError` if the name is unknown.
    """
    return gauge if isinstance(gauge, Gauge) else GAUGES[gauge]


def recorder_for(scene: Scene[Any], keep_returns: int = 0) -> Records:
    """Return a recorder with the gauges that the scene lists in `measures`.

    Amplitudes, and impacts if there is a contact, are always measured, because periodicity and regimes are derived from
    them. The recorder stores the last `keep_returns` section crossings individually, and at least `RETURNS_FOR_DRIFT`.
    For a scene without a section but with a prescribed force, the recorder measures the pulses.

    Raises `InputError` if a gauge is unknown or needs a capability that the scene lacks, or if nothing can be measured.
    """
    if scene.section is None:
        if isinstance(scene, Driven):
            return PulseRecorder(RETURNS_FOR_DRIFT)
        give = "give period= or section= to measure it" if scene.ends_at_once else "there is nothing to measure over"
        raise InputError(f"scene: {scene.name} declares neither a section nor pulses; {give}")
    unknown = [gauge for gauge in scene.measures if not isinstance(gauge, Gauge) and gauge not in GAUGES]
    if unknown:
        raise InputError(f"scene: {scene.name} measures {shown(unknown[0])}; choose from {', '.join(GAUGES)}")
    named = [gauge_named(gauge) for gauge in scene.measures]
    for gauge in named:
        if own := [name for name in gauge.variables if name in VARIABLES]:
            gives = f"{type(gauge).__name__} declares {own[0]}, which is a variable of vibrojax"
            raise InputError(f"scene: {scene.name}: {gives}; give it another name")
    always = (Swings(), Impacts()) if isinstance(scene, HasImpacts) else (Swings(),)
    missing = [gauge for gauge in always if not any(isinstance(other, type(gauge)) for other in named)]
    gauges = (*missing, *named)
    sums = {"time": "the package"}
    for gauge in gauges:
        for name in gauge.summed:
            if name in sums:
                what = f"{type(gauge).__name__} sums {shown(name)}, and so does {sums[name]}"
                raise InputError(f"scene: {scene.name}: {what}; give its sum another name")
            sums[name] = type(gauge).__name__
        for need in gauge.needs:
            if not isinstance(scene, need):
                lacks = f"{scene.name} is no {need.__name__}; {type(gauge).__name__} measures only those"
                raise InputError(f"scene: {lacks}")
    grows = any(isinstance(gauge, Hole) for gauge in gauges)
    return Recorder((*gauges, KeptReturns(max(keep_returns, RETURNS_FOR_DRIFT), grows)))
