"""What ends the lanes of a sweep early on orbits, where that is worth its while."""

from vibrojax.periodic.early import EarlyEnds
from vibrojax.periodic.shared import SharedEnds
from vibrojax.stepping import Located
from vibrojax.sweep.engine.underway import Ends
from vibrojax.sweep.input.definition import Sweep

WORTH = 5e6
"""Simulated seconds of all lanes below which to compile the return map takes longer than it spares. To compile it, and
what measures orbits, takes 2 s of processor time from nothing; of a million simulated seconds 1.4 s are spared over the
source's region, and 0.4 s over the default map, where more lanes are irregular and most others settle soon."""

SHARED = 16
"""Starts of a point from which on its lanes share the orbits that are found of some of them."""

SHARED_WORTH = 1.5e6
"""As `WORTH`, where orbits are shared; where the return map is compiled anyway, because orbits are asked for, it is
worth it at once."""


def early_ends(sweep: Sweep) -> Ends | None:
    """What finds lanes that need no more steps; None where none can be found, or it is not worth its while.

    Whether lanes do end early is for who steps them to see: all are looked at alike, so that the others go one way.
    """
    run, scene = sweep.run, sweep.system.driving_part()
    if not isinstance(run.stepper, Located) or scene.section is None:
        return None
    seconds = sweep.lanes * (run.settle + run.observe)
    if _starts_of_a_point(sweep) >= SHARED:
        return SharedEnds(EarlyEnds(sweep)) if run.orbits or seconds >= SHARED_WORTH else None
    return EarlyEnds(sweep) if seconds >= WORTH else None


def _starts_of_a_point(sweep: Sweep) -> float:
    """How many starts each point has; of a list of points that give their starts, on average."""
    if sweep.crosses_starts:
        return float(sweep.shape[-1])
    if sweep.point_vectors is None:
        return 1.0
    columns = [column.tolist() for column in (sweep.points or {}).values()]
    return sweep.lanes / max(len(set(zip(*columns, strict=True))), 1)
