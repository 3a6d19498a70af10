"""Without impact over the frequency ratio: settling, decay, lobes, two frequencies (Figs 5.37 to 5.50)."""

import numpy as np

from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import Entry, Here, claim, listed, number, trend
from vibrojax.reproduce._needs import lane, motion
from vibrojax.reproduce.groups.self_excitation._precision import USUAL

STRONGLY_DECAYING = motion("rotary", 30.0, sampling=5e-3, beta=0.3, gamma=1.2)
TWO = {"beta": 0.4, "gamma": 1.2, "k1": 625000.0, "c2": 75.0, "v": 0.5}
TWO_FREQUENCIES = motion("rotary", 48.0, sampling=2e-3, **TWO)
SLOW = {"beta": 0.3, "v": 0.5, "c2": 75.0}
LOBED = {gamma: motion("rotary", 60.0, sampling=1e-3, gamma=float(gamma), **SLOW) for gamma in range(2, 8)}
GAMMAS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
OVER_GAMMA = tuple(lane("rotary", beta=0.3, gamma=gamma) for gamma in GAMMAS)
FINE_GAMMAS = tuple(round(0.80 + 0.01 * step, 2) for step in range(15))
BORDER = tuple(lane("rotary", beta=0.3, gamma=gamma) for gamma in FINE_GAMMAS)


def settling_over_gamma(*lanes) -> Here:
    times = [one["settling_time"] for one in lanes]
    steps = np.diff(times)
    holds = bool(np.all(np.diff(times[3:]) > 0) and steps[-1] > 2 * steps[-2])
    return trend(
        f"{listed(times)} s at gamma {listed(GAMMAS)}", holds, "the last step is more than twice the one before"
    )


def border(*lanes) -> Here:
    sustained = [gamma for gamma, one in zip(FINE_GAMMAS, lanes, strict=True) if one.regime == "impact-free"]
    last = max(sustained, default=np.nan)
    return claim(f"{last:.2f} is the highest gamma sustained, in steps of 0.01", 0.8 <= last < 0.9)


def lag(one, at_most: float, at_least: float) -> Here:
    lag = abs(one["phase_lag"])
    return claim(f"{lag:.2f} rad behind the bit, at {one.frequency:.2f} Hz", at_least <= lag <= at_most)


def equal(*lanes) -> Here:
    ratios = [one["striker_amplitude"] / one["bit_amplitude"] for one in lanes]
    return claim(f"{listed(ratios)} times the bit's at gamma 8, 8.5, 9", max(abs(ratio - 1) for ratio in ratios) < 0.03)


def lobes(*motions) -> Here:
    found = [signal.lobes(one) for one in motions]
    others = [f"{listed([signal.lobes(one, abscissa) for one in motions])} with {abscissa}" for abscissa in (0.3, 0.5)]
    note = f"where slow is under 0.4 of the greatest velocity (R18); {', '.join(others)}"
    return claim(f"{listed(found)} lobes at gamma {listed(LOBED)}", found == list(LOBED), note)


def lower(moving) -> Here:
    low, weak = signal.peak(moving, "v2", 4.0, 8.0, since=40.0)
    _, strong = signal.peak(moving, "v2", 10.0, 15.0, since=40.0)
    note = f"its power in the striker's velocity is {weak / strong:.2f} of the higher one's"
    return number(low, 6.14, "Hz", 0.01, note)


def higher(moving) -> Here:
    high, _ = signal.peak(moving, "v2", 10.0, 15.0, since=40.0)
    return claim(f"{high:.2f} Hz", 12.3 <= high <= 12.8)


ENTRIES = (
    Entry(
        "fig-5.38",
        "settling time over gamma at beta 0.3, v 1.5",
        "grows; steeply at gamma 0.7",
        OVER_GAMMA,
        settling_over_gamma,
        "rising from gamma 0.4 on, and the step from 0.7 to 0.8 over twice that before",
        (*USUAL, "R16"),
    ),
    Entry(
        "fig-5.39",
        "highest gamma at which the vibration lasts, beta 0.3, v 1.5",
        "0.8; decays at 0.9",
        BORDER,
        border,
        "between 0.8 and 0.9",
        USUAL,
    ),
    Entry(
        "fig-5.40",
        "gamma 1.2, v 1.5",
        "decays after a few oscillations",
        (STRONGLY_DECAYING,),
        lambda one: trend(
            f"{signal.amplitude(one, 'v1', 3.0, 4.0) / signal.amplitude(one, 'v1', 0.0, 1.0):.2f} "
            "of the first second's velocity is left in the fourth",
            signal.amplitude(one, "v1", 3.0, 4.0) < 0.5 * signal.amplitude(one, "v1", 0.0, 1.0),
        ),
        "less than half is left",
        USUAL,
    ),
    Entry(
        "fig-5.41",
        "frequency at gamma 1.2, v 0.5, c2 75",
        "3.2 Hz, sustained",
        (lane("rotary", gamma=1.2, **SLOW),),
        lambda one: number(one.frequency, 3.2, "Hz", 0.016),
        "1.6 %: half a unit of its last digit",
        USUAL,
    ),
    *(
        Entry(
            name,
            f"bit and striker at gamma {gamma}, v 0.5, c2 75",
            said,
            (lane("rotary", gamma=gamma, **SLOW),),
            lambda one, most=most, least=least: lag(one, most, least),
            "within 0.3 rad of 0 or of pi: a twentieth of a cycle, as one sees it in a time history",
            (*USUAL, "R17"),
        )
        for name, gamma, said, most, least in (
            ("fig-5.42", 1.0, "in counter-phase, 3.14 rad", np.pi, np.pi - 0.3),
            ("sec-5.5b", 1.1, "transition: in phase or counter-phase", np.pi, np.pi - 0.3),
            ("fig-5.43", 1.2, "in phase, 0 rad", 0.3, 0.0),
            ("sec-5.5c", 1.3, "in phase at the lower mode, 0 rad", 0.3, 0.0),
        )
    ),
    Entry(
        "fig-5.44",
        "lobes of the striker's phase portrait, gamma 2 to 7",
        "as many as the whole part of gamma",
        tuple(LOBED.values()),
        lobes,
        "all the counts",
        (*USUAL, "R17", "R18"),
    ),
    Entry(
        "fig-5.45",
        "lobes of the striker's phase portrait at gamma 3",
        "3 lobes",
        (LOBED[3],),
        lambda one: claim(f"{signal.lobes(one)} lobes", signal.lobes(one) == 3),
        "the count",
        (*USUAL, "R17", "R18"),
    ),
    Entry(
        "fig-5.47",
        "amplitude of the striker at gamma 8 to 9, v 0.5, c2 75",
        "equal to the bit's, 1 times",
        tuple(lane("rotary", gamma=gamma, **SLOW) for gamma in (8.0, 8.5, 9.0)),
        equal,
        "3 %: what one tells apart in a phase portrait",
        (*USUAL, "R17"),
    ),
    Entry(
        "fig-5.50a",
        "lower of two frequencies at beta 0.4, gamma 1.2, k1 625000, c2 75, v 0.5",
        "6.14 Hz",
        (TWO_FREQUENCIES,),
        lower,
        "1 %: the source itself has 6.14 and 6.2 Hz for it",
        (*USUAL, "R17"),
    ),
    Entry(
        "fig-5.50b",
        "higher of two frequencies there",
        "12.3 to 12.8 Hz",
        (TWO_FREQUENCIES,),
        higher,
        "the range",
        (*USUAL, "R17"),
    ),
    Entry(
        "app-5.3",
        "beta 0.4, gamma 15, v 0.5, c2 75",
        "one limit cycle",
        (lane("rotary", beta=0.4, gamma=15.0, v=0.5, c2=75.0),),
        lambda one: claim(f"{one['cycles']:.0f} return to close", one["cycles"] == 1),
        "it repeats after one return to 0.1 %",
        (*USUAL, "R17"),
    ),
)
