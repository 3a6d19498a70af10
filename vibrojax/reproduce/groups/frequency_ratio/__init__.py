"""Impact, and the influence of the frequency ratio: chapter 5, sections 6 to 6.2 (the scene *vibro-impact*)."""

from vibrojax.reproduce._group import Group, Picture
from vibrojax.reproduce.groups._impact import STIFF, at, moving
from vibrojax.reproduce.groups.frequency_ratio import _best, _high, _low, _usual
from vibrojax.reproduce.groups.frequency_ratio._best import IN_PHASE, TYPICAL, TYPICAL_SLOW
from vibrojax.reproduce.groups.frequency_ratio._low import COUNTER
from vibrojax.reproduce.pictures import impact as pictures

TRIPLE = tuple(moving(20.0, gamma=gamma, **STIFF) for gamma in (1.0, 1.1, 1.2))
UNSAID = tuple(
    at(start=start, delta=delta, v_cr=v_cr)
    for delta in pictures.GAPS
    for start in pictures.STARTS
    for v_cr in pictures.CRITICAL
)
GROUP = Group(
    name="frequency-ratio",
    title="Impact, and the frequency ratio",
    text="The striker hits the bit through a one-sided contact; the blow adds to the friction and brakes the bit. "
    "Where nothing else is said beta 0.4, gamma 0.75, v 1.5 m/s, k0 50 MN/m, a preload of 5 mm, start `drive`.",
    entries=(
        *_usual.ENTRIES,
        *_low.ENTRIES,
        *_best.ENTRIES,
        *_high.ENTRIES,
    ),
    pictures=(
        Picture(
            "Figs 5.53 and 5.54, what the source does not say",
            "Frequency and change of velocity over the Stribeck speed v_cr, for both signs of the gap and three "
            "starts; dashed: the source. Hollow: no single impact.",
            UNSAID,
            pictures.unsaid,
        ),
        Picture(
            "Fig. 5.52 and 5.72",
            "The working cycle at v 0.5 m/s: stick (thick), slip, and the blow, which falls while the bit slows.",
            (TYPICAL_SLOW,),
            pictures.working_cycle,
        ),
        Picture(
            "Fig. 5.53",
            "Velocities of bit and striker with impact, from zero: settled after some cycles.",
            (TYPICAL,),
            pictures.velocities,
        ),
        Picture(
            "Figs 5.57 and 5.68",
            "Phase portraits of bit and striker; the striker's vertical edge is the blow.",
            (TYPICAL,),
            pictures.portraits,
        ),
        Picture(
            "Figs 5.51 and 5.74",
            "Impact force of one blow, and the friction force beside it (k0 50 MN/m).",
            (TYPICAL,),
            pictures.forces,
        ),
        Picture(
            "Figs 5.60 and 5.67",
            "Counter-phase at gamma 0.5 (beta 0.3), in phase at 0.6 (beta 0.4).",
            (COUNTER, IN_PHASE),
            pictures.phases,
        ),
        Picture(
            "Fig. 5.77",
            "k1 625000: single blows at gamma 1.0, single and double in turn at 1.1, irregular at 1.2.",
            TRIPLE,
            pictures.in_turn,
        ),
    ),
)
