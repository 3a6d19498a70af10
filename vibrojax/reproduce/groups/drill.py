"""The whole drill: its own blows drive the rock (chapter 6, section 6; scenes *drilling*, *coupled-drilling*)."""

import numpy as np

from vibrojax.reproduce._entry import LAST_DIGIT, Entry, not_compared
from vibrojax.reproduce._group import Group, Picture
from vibrojax.reproduce._needs import grid, lane, motion
from vibrojax.reproduce.groups import _drill as judge
from vibrojax.reproduce.groups._drill import BLOW, GAPS, K1, TABLE_6_6, WIDE_GAPS
from vibrojax.reproduce.pictures import drill as pictures

STIFFNESSES = (100e6, 300e6, 500e6)
OVER_SPEED = grid(
    "drill over speed",
    "drilling",
    {"k3": STIFFNESSES, "v": np.linspace(0.5, 2.5, 17)},
    ("drive", "stuck", "touching"),
    **{name: value for name, value in TABLE_6_6.items() if name != "k3"},
)
MOVING = motion("drilling", 8.0, **TABLE_6_6)


def _drill(start: str = "drive", **parameters):
    return lane("drilling", start, **TABLE_6_6 | parameters)


def _pulse(k3: float):
    pulse = {"pulse_shape": "half-sine", "force": 470e3, "pulse_width": BLOW, "frequency": 5.8}
    return lane("penetration", settle=1.0, observe=1.0, threshold=250e3, zeta=1.5, k3=k3, **pulse)


_USUAL = ("R2", "R3", "R4", "R5", "R25")
_WITHOUT = {name: value for name, value in TABLE_6_6.items() if name not in ("zeta", "k3", "threshold")}
_PULSES = tuple(_pulse(k3) for k3 in STIFFNESSES)
GROUP = Group(
    name="drill",
    title="The whole drill",
    text="The drill's own blows drive the rock, one way as in the source. Table 6.6 with v 1.5 m/s; D 50 kN, the "
    "weakest of the source's range, because its drill breaks nothing from 100 kN on.",
    entries=(
        Entry(
            "table-6.6.1",
            "frequency of the drill",
            "5.8 Hz",
            (_drill(),),
            judge.frequency("5.8"),
            LAST_DIGIT,
            _USUAL,
        ),
        Entry(
            "table-6.6.2",
            "frequency, k1 4 times",
            "11.6 Hz",
            (_drill(k1=K1 * 4),),
            judge.frequency("11.6"),
            LAST_DIGIT,
            (*_USUAL, "R26"),
        ),
        Entry(
            "table-6.6.3",
            "frequency, k1 5.74 times",
            "13.9 Hz",
            (_drill(k1=K1 * (13.9 / 5.8) ** 2),),
            judge.frequency("13.9"),
            LAST_DIGIT,
            (*_USUAL, "R26"),
        ),
        Entry(
            "fig-6.29",
            "motion of the hole",
            "only at impact, stepwise",
            (MOVING,),
            judge.only_at_impact,
            "under 1e-6 of it away from impacts",
            _USUAL,
        ),
        Entry(
            "fig-6.30",
            "impact force for gaps of 10 to 20 mm",
            "increases with the gap",
            (
                *(_drill("stuck", delta=gap) for gap in GAPS),
                *(_drill("stuck", delta=gap) for gap in WIDE_GAPS),
            ),
            judge.over_gap,
            "the order, over -5 to 20 mm",
            (*_USUAL, "R6"),
        ),
        Entry(
            "fig-6.32",
            "rate of penetration over the gap",
            "increases with it",
            tuple(_drill("stuck", delta=gap) for gap in GAPS),
            judge.rate_over_gap,
            "the order, over -5 to 5 mm, where there is a single impact",
            (*_USUAL, "R6"),
        ),
        Entry(
            "fig-6.33",
            "rate of penetration over k3",
            "grows; little from 300 to 500 MN/m",
            tuple(_drill(k3=k3) for k3 in STIFFNESSES),
            judge.rate_over_stiffness,
            "the second step above 0, and under 0.3 of the first",
            _USUAL,
        ),
        *(
            Entry(
                f"table-6.7.{index + 1}",
                f"slip under a blow of 470 kN, D 250 kN, k3 {k3 / 1e6:g} MN/m",
                f"{source} mm",
                _PULSES,
                judge.slip(index, source),
                f"{LAST_DIGIT}; in trend where the second step along k3 is above 0, and under 0.3 of the first",
                ("R11", "R27"),
            )
            for index, (k3, source) in enumerate(zip(STIFFNESSES, ("0.58", "0.73", "0.77"), strict=True))
        ),
        Entry(
            "sec-6.6b",
            "highest impact force of Table 6.6",
            "470 kN",
            (OVER_SPEED,),
            judge.highest,
            "1 %: its second digit is the last that is sure",
            (*_USUAL, "R11"),
        ),
        Entry(
            "fig-6.34",
            "C of the whole drill",
            "0.44 m/s",
            (OVER_SPEED,),
            judge.constant,
            LAST_DIGIT,
            (*_USUAL, "R8", "R9"),
        ),
        Entry(
            "fig-6.35",
            "limit cycle with penetration beside that without",
            "no change, 0 %",
            (
                lane("drilling", **TABLE_6_6),
                lane("vibro-impact", **_WITHOUT),
                lane("coupled-drilling", **TABLE_6_6),
            ),
            judge.same_cycle,
            "1 % of the period, also with the bit's normal motion fed back",
            _USUAL,
        ),
        Entry(
            "sec-6.6a",
            "contact of bit and rock",
            "no separation, 0 mm",
            (_drill(),),
            judge.in_contact,
            "0.01 mm",
            _USUAL,
        ),
        Entry(
            "fig-6.37",
            "frequency with penetration beside that without",
            "no change, 0 Hz",
            (_drill(), lane("vibro-impact", **_WITHOUT)),
            judge.response,
            "0.01 Hz",
            _USUAL,
        ),
        Entry(
            "fig-6.31",
            "depth of the hole after 8 s",
            "not in the text",
            (MOVING,),
            lambda moving: not_compared(
                f"{1e3 * float(moving['x4'][-1]):.2f} mm", "the figure's axis is not in the text"
            ),
            "none",
            _USUAL,
        ),
    ),
    pictures=(
        Picture(
            "Figs 6.29 and 6.31",
            "Impact force, bit and hole over three cycles: the hole grows by steps.",
            (MOVING,),
            pictures.steps,
        ),
        Picture(
            "Figs 6.33 and 6.34",
            "Rate of penetration of the drill over P/D, varied by the drive's speed.",
            (OVER_SPEED,),
            pictures.over_relief,
        ),
        Picture(
            "Figs 6.35 and 6.36", "Phase portraits of bit and striker while drilling.", (MOVING,), pictures.portraits
        ),
    ),
)
