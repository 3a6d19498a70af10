"""Linear modes: eqs. 5.15 to 5.17 and what the source says with them."""

import numpy as np

from vibrojax.physics.modes import empirical_frequency, natural_frequencies, striker
from vibrojax.reproduce._entry import AGREES, DIFFERS, LAST_DIGIT, Entry, Here, claim, number, printed, shown, trend
from vibrojax.reproduce._group import Group
from vibrojax.reproduce.groups._table_5_3 import ROWS

_PAIR = "the source's pair are no roots: their product is 468.6, and must be w1 w2 = 468.75"
TABLE_5_1 = {"m1": 250.0, "k1": 156250.0, "beta": 0.4, "gamma": 0.75}


def _modes(**p) -> tuple[float, float]:
    """Natural frequencies [rad/s] of eq. 5.16, lower first."""
    lower, upper = np.asarray(natural_frequencies({"m1": 250.0, "k1": 156250.0} | p))
    return float(lower), float(upper)


def _column(of, source: list[float]) -> Here:
    """A column of Table 5.3 as closed form: how many rows are within a unit of the last printed digit."""
    ours = [of({"m1": 250.0, "k1": 250.0 * row.w1**2, "beta": row.beta, "gamma": row.gamma}) for row in ROWS]
    off = np.abs(np.array(ours) - source) > 0.1
    wrong = "; ".join(f"row {i + 1} is {ours[i]:.2f} here, {source[i]} there" for i in np.flatnonzero(off))
    text = f"{min(ours):.2f} to {max(ours):.2f} rad/s, {np.sum(~off)} of 11 rows within 0.1"
    return Here(text, DIFFERS if off[np.arange(11) != 9].any() else AGREES, wrong)


def _rises() -> Here:
    lower = [_modes(beta=0.3, gamma=gamma)[0] for gamma in (0.6, 1.0, 1.2, 2.0, 4.0, 15.0)]
    limit = 25 / np.sqrt(1.3)
    text = f"{lower[2]:.1f} rad/s at gamma 1.2, {lower[3]:.1f} at 2, {lower[4]:.1f} at 4; the limit is {limit:.1f}"
    hertz = [w / (2 * np.pi) for w in (lower[2], limit)]
    note = f"it goes on rising, from {hertz[0]:.2f} to {hertz[1]:.2f} Hz"
    return trend(text, lower[2] > lower[0] and hertz[1] - hertz[0] < 0.1, note)


def _roots() -> Here:
    m2, k2 = (float(x) for x in striker(TABLE_5_1))
    matrix = np.array([[(156250.0 + k2) / 250.0, -k2 / 250.0], [-k2 / m2, k2 / m2]])
    found = np.sqrt(np.sort(np.linalg.eigvals(matrix).real))
    worst = np.abs(found / np.array(_modes(**TABLE_5_1)) - 1).max()
    return claim(f"{shown(worst)} relative difference", worst < 1e-9)


def _without_impact() -> Here:
    p = {"m1": 250.0, "k1": 156250.0, "beta": 0.4, "gamma": 0.9}
    ours, by_5_16 = float(empirical_frequency(p)) / (2 * np.pi), _modes(**p)[1] / (2 * np.pi)
    return number(ours, 4.9, "Hz", 0.01, f"by eq. 5.17; eq. 5.16 gives {by_5_16:.2f} Hz")


GROUP = Group(
    name="linear",
    title="Linear modes",
    text="Closed forms, without friction and impact: they check that the tables are read right.",
    entries=(
        Entry(
            "eq-5.15",
            "roots of the determinant and of the eigenvalue problem, Table 5.1",
            "identical",
            (),
            _roots,
            "rounding",
        ),
        Entry(
            "eq-5.16a",
            "higher natural frequency, Table 5.1",
            "29.34 rad/s",
            (),
            lambda: printed(_modes(**TABLE_5_1)[1], "29.34", "rad/s", _PAIR),
            LAST_DIGIT,
        ),
        Entry(
            "eq-5.16b",
            "lower natural frequency, Table 5.1",
            "15.97 rad/s",
            (),
            lambda: printed(_modes(**TABLE_5_1)[0], "15.97", "rad/s", _PAIR),
            LAST_DIGIT,
        ),
        Entry(
            "table-5.1",
            "stiffness of the second spring for beta 0.4, gamma 0.75",
            "35156 N/m",
            (),
            lambda: printed(float(striker(TABLE_5_1)[1]), "35156", "N/m"),
            LAST_DIGIT,
        ),
        Entry(
            "eq-5.16c",
            "column of eq. 5.16 in Table 5.3",
            "25.0 to 95.1 rad/s",
            (),
            lambda: _column(lambda p: float(natural_frequencies(p)[1]), [row.eq_5_16 for row in ROWS]),
            "all rows but the misprinted one within a unit of the last digit",
            ("R7",),
        ),
        Entry(
            "eq-5.17",
            "column of eq. 5.17 in Table 5.3",
            "25.0 to 94.7 rad/s",
            (),
            lambda: _column(lambda p: float(empirical_frequency(p)), [row.eq_5_17 for row in ROWS]),
            "all rows but the misprinted one within a unit of the last digit",
            ("R7",),
        ),
        Entry(
            "app-5.2a",
            "higher natural frequency at beta 0.3, gamma 1.2",
            "5.93 Hz",
            (),
            lambda: printed(_modes(beta=0.3, gamma=1.2)[1] / (2 * np.pi), "5.93", "Hz"),
            LAST_DIGIT,
        ),
        Entry(
            "app-5.2b",
            "lower natural frequency at beta 0.3, gamma 1.2",
            "3.2 Hz",
            (),
            lambda: number(_modes(beta=0.3, gamma=1.2)[0] / (2 * np.pi), 3.2, "Hz", 3e-3),
            "0.3 %, as the higher one is met: a tenth of its last digit",
        ),
        Entry(
            "fig-5.76a",
            "calculated frequency without impact at beta 0.4, gamma 0.9",
            "4.9 Hz",
            (),
            _without_impact,
            "0.01 of 4.9 Hz: half a unit of the last printed digit",
        ),
        Entry(
            "sec-5.5a",
            "the lower natural frequency over gamma at beta 0.3",
            "rises up to gamma 1.2, no more thereafter",
            (),
            _rises,
            "at gamma 1.2 within 0.1 Hz, the last digit of the source, of its limit w1/sqrt(1 + beta)",
        ),
    ),
)
