"""Count the results of the source that turn red if one sign of the drill is wrong; this takes some minutes.

    python tests/reproduce_signs.py none|friction|contact|impact-friction TABLE.md

TABLE.md is the table of the right equations, from `vibrojax reproduce`. `none` changes no sign, so nothing may turn
red.

Many lanes with a wrong sign never end, so the limit of steps is low. `none` shows that it is enough for right lanes.

Counted with 41 of the 189 results red under the right equations: none 0, friction 94, contact 66, impact-friction 35.
The last sign affects only the part of friction that an impact adds, which is absent without impacts.
"""

import sys
from dataclasses import replace
from pathlib import Path

from vibrojax.models.scenes import rotary, stick_slip
from vibrojax.reproduce import GROUPS, run_reproduction
from vibrojax.sweep.engine import batch

_right = rotary.accelerations


def friction(law, c, slip, state, impact):
    """Let F drive the bit instead of braking it."""
    bit, striker = _right(law, c, slip, state, impact)
    return bit + 2.0 * c.inverse_m1 * stick_slip.friction(law, c.slip, slip, state[1] + c.slip.v, impact), striker


def contact(law, c, slip, state, impact):
    """Let J pull the striker in instead of pushing it back."""
    bit, striker = _right(law, c, slip, state, impact)
    return bit, striker if impact is None else striker + 2.0 * c.inverse_m2 * impact


def impact_friction(law, c, slip, state, impact):
    """Let the part of friction that the impact adds drive the bit, as eq. 5.10 is printed (R2)."""
    bit, striker = _right(law, c, slip, state, impact)
    if impact is None:
        return bit, striker
    speed = slip * (state[1] + c.slip.v)
    return bit + 2.0 * c.inverse_m1 * (slip * law.on_impact(speed, c.slip.law) * impact), striker


WITHOUT_DRILL = ("linear", "penetration", "law")
"""Groups of results that do not depend on the signs of the drill."""
SIGNS = {"none": _right, "friction": friction, "contact": contact, "impact-friction": impact_friction}


def main(sign: str, path: str) -> None:
    """Run the registry with one wrong sign and print the results that turned red."""
    rows = [line.split("|") for line in Path(path).read_text().splitlines()[2:]]
    before = {cells[1].strip(): cells[5].strip() for cells in rows}
    rotary.accelerations = SIGNS[sign]
    batch.LANE_MAX_STEPS, batch.LANE_MAX_RATE = 1e4, 300.0
    groups = [replace(group, pictures=()) for group in GROUPS if group.name not in WITHOUT_DRILL]
    results = run_reproduction(groups).results
    turned = [result.entry.id for result in results if result.here.verdict == "differs" != before.get(result.entry.id)]
    print(f"{sign}: {len(turned)} of {len(before)} results turn red: {', '.join(turned)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
