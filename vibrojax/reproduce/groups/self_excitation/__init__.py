"""Self-excitation without impact: chapter 5, section 4 (the scene *rotary*)."""

from vibrojax.reproduce._group import Group, Picture
from vibrojax.reproduce._needs import motion
from vibrojax.reproduce.groups.self_excitation import _from_zero, _over_gamma, _synchronised
from vibrojax.reproduce.groups.self_excitation._from_zero import (
    FAST_DRIVE,
    FROM_INSIDE,
    FROM_OUTSIDE,
    OVER_SPEED,
    SLOW_DRIVE,
)
from vibrojax.reproduce.groups.self_excitation._over_gamma import (
    LOBED,
    OVER_GAMMA,
    SLOW,
    STRONGLY_DECAYING,
    TWO_FREQUENCIES,
)
from vibrojax.reproduce.groups.self_excitation._synchronised import DECAYING
from vibrojax.reproduce.pictures import self_excitation as pictures

TEN = motion("rotary", 60.0, sampling=1e-3, gamma=10.0, **SLOW)
NINE = motion("rotary", 60.0, sampling=1e-3, gamma=9.0, **SLOW)
GROUP = Group(
    name="self-excitation",
    title="Self-excitation without impact",
    text="The bit slides on rock whose friction falls with speed, the striker hangs on it by a spring, and there is no "
    "contact between them. The motion grows by itself until the bit sticks. Where nothing else is said m1 = 250 kg, "
    "k1 = 156250 N/m, c2 = 250 N s/m, beta 0.4, gamma 0.75, v = 1.5 m/s.",
    entries=(
        *_synchronised.ENTRIES,
        *_from_zero.ENTRIES,
        *_over_gamma.ENTRIES,
    ),
    pictures=(
        Picture(
            "Figs 5.19 to 5.21",
            "The bit's velocity grows by itself until it reaches the drive's; the faster the drive, the later. "
            "At 2.5 m/s it decays here.",
            (SLOW_DRIVE, FROM_INSIDE, FAST_DRIVE),
            pictures.velocities,
        ),
        Picture(
            "Figs 5.29 to 5.31",
            "One limit cycle, reached from the centre and from outside; its flat edge is the bit that sticks.",
            (FROM_INSIDE, FROM_OUTSIDE),
            pictures.limit_cycle,
        ),
        Picture(
            "Figs 5.22 and 5.38",
            "Settling time over the driving velocity and over the frequency ratio.",
            (*OVER_SPEED, *OVER_GAMMA),
            pictures.settling,
        ),
        Picture(
            "Figs 5.32 and 5.33",
            "Friction force as the vibration grows, and with the bit's speed when it is steady.",
            (FROM_INSIDE,),
            pictures.friction_in_time,
        ),
        Picture(
            "Figs 5.39 and 5.40",
            "Beyond gamma 0.86 the vibration dies away at 1.5 m/s.",
            (DECAYING, STRONGLY_DECAYING),
            pictures.decaying,
        ),
        Picture(
            "Figs 5.44, 5.45 and 5.47",
            "Lobes of the striker's phase portrait at high frequency ratios (v 0.5 m/s, beta 0.3).",
            (LOBED[3], NINE, TEN),
            pictures.lobed,
        ),
        Picture(
            "Figs 5.25, 5.26 and 5.50",
            "One frequency with Table 5.1, two at beta 0.4 and gamma 1.2.",
            (FROM_INSIDE, TWO_FREQUENCIES),
            pictures.spectra,
        ),
    ),
)
