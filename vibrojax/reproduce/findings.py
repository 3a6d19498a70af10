"""What the differences mean to who builds or runs such a drill, with the results behind each; and the readings."""

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

READINGS = {
    "R1": "eq. 5.11 prints the stick force with the sign of the pull; read as against it, as the text says",
    "R2": "eq. 5.10 prints +Φ on the bit; read as friction that grows by μJ against the sliding: impact brakes",
    "R3": "tables give a gap of 0.005 m, Fig. 5.51 gives -0.005 m; read as -0.005 m, a preload of 5 mm",
    "R4": "v_cr is not in the text; 3 m/s, from program listing A3-1",
    "R5": "zero initial condition: x1 = x1' = x2 = x2' = 0, so the bit moves with the drive (start `drive`)",
    "R6": "attractors coexist: another start can end in another motion",
    "R7": "row w1 = 66 of Table 5.3 is a misprint: its own eqs. 5.16 and 5.17 give 77.5 and 77.1, not 79.6 and 78.5",
    "R8": "the listing's rate of penetration is slip times 2πf; true rate = slip times f. C in the listing's rate",
    "R9": "ROP = C ln(P/D) is negative for P/D < 1; read as C ln(eta/eta0) with eta0 fitted, beside a line",
    "R10": "pulse width 2 and 4 ms in the text; 4 ms where none is given",
    "R11": "Table 6.7's 470 kN: Table 6.6 does not give such a blow at drive speeds up to 2 m/s; trend only",
    "R12": "c1 in the appendix tables is c2",
    "R13": "with a preload, start `drive` begins inside the contact, which kicks the striker; `touching` does not",
    "R14": "a few cycles to settle: in the best region; elsewhere transients last minutes",
    "R15": "Figs 5.14 to 5.17 give no driving velocity: 1.5 m/s, and 0.5 and 3 m/s change nothing of it",
    "R16": "the source does not say what settled means: here all returns from then on repeat to 1 %",
    "R17": "Figs 5.41 to 5.50 and appendix 5-3: c2 = 75 N s/m and v = 0.5 m/s wherever gamma is 1 or over",
    "R18": "a lobe of a phase portrait: a place farthest from its centre, faster than 0.4 of the greatest velocity; "
    "the small ones by the abscissa are not counted, as the source says",
    "R19": "Fig. 5.67's caption says beta 0.4, its Table 5.5 beta 0.3: read as 0.4; the other stands in the remark",
    "R20": "zero acceleration: under a tenth of the greatest in flight",
    "R21": "a clean blow: one swing of the striker per cycle; a strong one: an impact velocity over that of the drive",
    "R22": "the swept sine's force, damping and threshold are not given: 60 kN +- 70 kN, zeta 0.3, D 150 kN, 20 Hz/s",
    "R23": "Table 6.2 and Fig. 6.15 give the stiffness at which slip begins as 0.01 MN/m, at which Fig. 6.14 has none",
    "R24": "Fig. 6.27 gives no damping: the lightest of zeta 0.5 to 1.1 that slips",
    "R25": "Table 6.6 gives no driving velocity and no gap: 1.5 m/s, -5 mm; D 50 kN, the lowest of its range",
    "R26": "how the drill is set to 11.6 and 13.9 Hz is not said: k1 times the square of the frequencies' ratio",
    "R27": "Table 6.7's blow: a half-sine of 470 kN as long as Table 6.6's contact lasts, on the bit alone",
    "R28": "misprints of 2.14 and 2.17 corrected, 2.16's coefficients chosen; driven where the law falls",
    "R29": "eqs. 5.6 to 5.8 print the root 1 - 2 xi², which should be 1 - xi²",
    "R30": "last digits are cut: Table 4.5 has 4.7, 8.2, 10.5 GPa for 4.75, 8.27, 10.57; Table 5.3 27.8 for 27.87",
}
"""How the source was read where it is misprinted or silent, by name."""
