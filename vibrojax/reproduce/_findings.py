"""What the differences mean to who builds or runs such a machine, with the results behind each."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """`text`: what is found; `ids`: the results that it explains where they differ."""

    text: str
    ids: tuple[str, ...]


FINDINGS = (
    Finding(
        "Two motions coexist. Which one the machine settles in depends on how it is started: with a gap instead of a "
        "preload a weak rattle stands beside the strong blow, in up to six tenths of the recommended region.",
        ("sec-5.6.1", "sec-5.4.2"),
    ),
    Finding(
        "The bit slides backwards where the source has it stick: at 1.5 m/s it passes through zero speed too fast to "
        "be held. With impact and at 0.5 m/s it sticks, as the source says.",
        ("fig-5.32", "fig-5.59"),
    ),
    Finding(
        "At a driving speed of 2.5 m/s the vibration dies away: with v_cr at 3 m/s the friction hardly falls there. "
        "With v_cr from 3.5 m/s on it lasts.",
        ("fig-5.21",),
    ),
    Finding(
        "The region of best performance is not where good blows end: one point in seven well outside of it has them "
        "too, clean and strong. Strikers lighter than a quarter of the bit are stable.",
        ("sec-5.7d", "sec-5.6.3.1"),
    ),
    Finding(
        "A heavier striker lowers the frequency with impact, by 5 % within the region. One of 1.2 times the bit "
        "repeats after all from the source's own start, and a stiffer spring does not give it a single blow a cycle.",
        ("sec-5.6.3.2c", "fig-5.84", "app-5.7"),
    ),
    Finding(
        "The speed of the drive does not move the blow within the cycle: it scales the whole motion.",
        ("fig-5.67a",),
    ),
    Finding(
        "Beyond gamma 1 the hardest blows are up to two thirds above the source's range.",
        ("sec-5.6.2.4", "table-a5.2"),
    ),
    Finding(
        "The rate of penetration is a straight line in P/D, not a logarithm: under pulses of one kind each slips as "
        "far, however often they fall. Printed as C ln(P/D), with P below D, the law gives a negative rate.",
        ("eq-6.4d", "eq-6.4e", "eq-6.4f", "fig-6.24b", "sec-7b"),
    ),
    Finding(
        "Damped rock does not yield to a pulse just as strong as its threshold, nor does soft rock to a stronger one: "
        "the rates that the source draws there are zero here, or begin in harder rock.",
        ("fig-6.15", "fig-6.17", "sec-6.4.2.3", "fig-6.20a", "fig-6.24a"),
    ),
    Finding(
        "The drill of Table 6.6 strikes with at most a third of the 470 kN of Table 6.7, 5 % slower than said, and "
        "weaker over wide gaps; a blow of 470 kN drives the bit a quarter to two thirds as deep, and no deeper in the "
        "hardest rock.",
        (
            *("table-6.6.1", "table-6.6.2", "table-6.6.3", "fig-6.30", "fig-6.33", "fig-6.34", "sec-6.6b"),
            *("table-6.7.1", "table-6.7.2", "table-6.7.3"),
        ),
    ),
    Finding(
        "Numbers that the source's own formulas do not give either, all within 3 %: misprints, or readings less "
        "fine than they are printed. No design hangs on them.",
        ("eq-5.16a", "eq-5.16b", "eq-5.17", "table-5.3.10"),
    ),
    Finding(
        "Read off plots: the velocity change at gamma 0.8 is 7 % smaller here, and at gamma 7 there is a lobe more.",
        ("fig-5.70a", "fig-5.44"),
    ),
    Finding(
        "Without impact the lower natural frequency goes on rising beyond gamma 1.2, by a tenth.",
        ("sec-5.5a",),
    ),
    Finding("The machine settles within seconds, but rarely in a few cycles.", ("fig-5.55", "fig-5.56")),
)
"""The weightiest first."""
