"""The synchronisation frequency: Tables 5.2 and 5.3."""

import numpy as np

from vibrojax.physics.modes import natural_frequencies
from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import DIFFERS, Entry, Here, number
from vibrojax.reproduce._needs import lane, motion
from vibrojax.reproduce.groups._table_5_3 import ROWS, Row
from vibrojax.reproduce.groups.self_excitation._precision import PERIOD, PERIOD_WITHIN, USUAL

DECAYING = motion("rotary", 30.0, sampling=5e-3, beta=0.3, gamma=0.9)


def _beside_5_16(row: Row) -> str:
    upper = natural_frequencies({"m1": 250.0, "k1": 250.0 * row.w1**2, "beta": row.beta, "gamma": row.gamma})[1]
    return f"eq. 5.16 gives {float(upper):.2f} rad/s, and the source prints {row.eq_5_16} for it"


def _row(index: int) -> Entry:
    row = ROWS[index - 1]
    need = lane("rotary", k1=250.0 * row.w1**2, v=row.v, beta=row.beta, gamma=row.gamma)
    return Entry(
        f"table-5.3.{index}",
        f"synchronisation frequency, w1 {row.w1}, v {row.v}, beta {row.beta}, gamma {row.gamma}",
        f"{row.simulation} rad/s",
        (need,),
        lambda one: number(one.angular_frequency, row.simulation, "rad/s", PERIOD_WITHIN, _beside_5_16(row)),
        PERIOD,
        (*USUAL, *(("R7",) if index == 10 else ()), "R30"),
    )


def first_row(moving) -> Here:
    frequency, _ = signal.peak(moving, "x1", 1.0, 20.0, since=5.0)
    decays = signal.amplitude(moving, "x1", 20.0) < 0.5 * signal.amplitude(moving, "x1", 0.0, 5.0)
    here = number(2 * np.pi * frequency, 30.7, "rad/s", PERIOD_WITHIN)
    return here if decays else Here(here.text, DIFFERS, "it does not decay here")


ENTRIES = (
    Entry(
        "table-5.3.1",
        "synchronisation frequency, w1 25, v 1.5, beta 0.3, gamma 0.9",
        "30.7 rad/s, and decays",
        (DECAYING,),
        first_row,
        PERIOD,
        USUAL,
    ),
    *(_row(index) for index in range(2, 12)),
    Entry(
        "table-5.2",
        "frequency at m1 300, k1 326700, beta 0.3, gamma 0.8, v 0.8",
        "6.1 Hz",
        (lane("rotary", m1=300.0, k1=326700.0, beta=0.3, gamma=0.8, v=0.8),),
        lambda one: number(one.frequency, 6.1, "Hz", 0.0082),
        "0.8 %: half a unit of its last digit",
        USUAL,
    ),
)
