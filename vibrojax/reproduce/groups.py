"""The groups of results that belong together, in the order of the page."""

from vibrojax.reproduce import entries_impact, entries_rock, entries_without_impact
from vibrojax.reproduce import pictures_impact as impact
from vibrojax.reproduce import pictures_rock as rock
from vibrojax.reproduce import pictures_without_impact as without_impact
from vibrojax.reproduce.entry import Group

GROUPS: tuple[Group, ...] = (
    Group(
        "linear",
        "Linear modes",
        "Closed forms, without friction and impact: they check that the tables are read right.",
        entries_without_impact.LINEAR,
    ),
    Group(
        "friction",
        "Friction laws",
        "Chapter 3 shows six kinds of friction; each can be used in any scene by its name. A falling branch is what "
        "excites the vibration, so the law matters: below, the drill's regimes under each of them.",
        entries_without_impact.FRICTION,
        without_impact.FRICTION,
    ),
    Group(
        "self-excitation",
        "Self-excitation without impact",
        "The bit slides on rock whose friction falls with speed, the striker hangs on it by a spring, and there is no "
        "contact between them. The motion grows by itself until the bit sticks. Where nothing else is said m1 = 250 "
        "kg, k1 = 156250 N/m, c2 = 250 N s/m, beta 0.4, gamma 0.75, v = 1.5 m/s.",
        entries_without_impact.SELF_EXCITATION,
        without_impact.SELF_EXCITATION,
    ),
    Group(
        "frequency-ratio",
        "Impact, and the frequency ratio",
        "The striker hits the bit through a one-sided contact; the blow adds to the friction and brakes the bit. "
        "Where nothing else is said beta 0.4, gamma 0.75, v 1.5 m/s, k0 50 MN/m, a preload of 5 mm, start `drive`.",
        entries_impact.FREQUENCY_RATIO,
        impact.FREQUENCY_RATIO,
    ),
    Group(
        "mass-ratio",
        "Impact, and the mass ratio",
        "Gamma 0.75 and v 1.5 m/s, where nothing else is said; beta is varied.",
        entries_impact.MASS_RATIO,
        impact.MASS_RATIO,
    ),
    Group(
        "region",
        "The source's region, tested",
        "The source recommends beta from 0.25 to 0.6 and gamma from 0.6 to 0.8. Here it is tested over a wide map, "
        "over gaps from -10 to 10 mm, speeds from 0.5 to 2 m/s, and three starts. A single impact is clean where the "
        "striker swings once a cycle, and strong where it hits faster than the drive moves.",
        entries_impact.REGION,
        impact.REGION,
    ),
    Group(
        "penetration",
        "Forced penetration",
        "The bit stands on rock, a spring with a damper in series with an element that slips at the threshold D, "
        "and is driven by given pulses or a swept sine. Pulses are rectangular, 4 ms wide, D 150 kN where nothing is "
        "said.",
        entries_rock.PENETRATION,
        rock.PENETRATION,
    ),
    Group(
        "law",
        "The law of the rate of penetration",
        "The source fits ROP = C ln(P/D) to pulses of different frequency. Here the same pulses are simulated, and "
        "the logarithm is fitted beside a line. Zeta 0.6 and D 150 kN, which the source does not say for these (R8).",
        entries_rock.LAW,
        rock.LAW,
    ),
    Group(
        "drill",
        "The whole drill",
        "The drill's own blows drive the rock, one way as in the source. Table 6.6 with v 1.5 m/s; D 50 kN, the "
        "weakest of the source's range, because its drill breaks nothing from 100 kN on.",
        entries_rock.DRILL,
        rock.DRILL,
    ),
    Group(
        "classical",
        "Classical checks",
        "The machines of chapter 5's review have periodic motions in closed form. They are small scenes of their own, "
        "stepped like the others: the contact is right, and a scene is quick to add.",
        entries_without_impact.CLASSICAL,
        without_impact.CLASSICAL,
    ),
)
