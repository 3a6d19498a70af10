"""The whole drill: its own blows drive the rock (chapter 6, section 6; scenes *drilling*, *coupled-drilling*)."""

import numpy as np

from vibrojax.laws import fit_rop
from vibrojax.physics.contact import contact_time
from vibrojax.physics.modes import empirical_frequency
from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import (
    DIFFERS,
    IN_TREND,
    LAST_DIGIT,
    Entry,
    Here,
    claim,
    listed,
    not_compared,
    number,
    printed,
    shown,
    trend,
)
from vibrojax.reproduce._group import Group, Picture
from vibrojax.reproduce._needs import grid, lane, motion
from vibrojax.reproduce.pictures import drill as pictures

K1, K2, M2 = 246490.0, 55460.0, 100.0
TABLE_6_6 = {
    "k0": 20e6,
    "c0": 10.0,
    "k1": K1,
    "gamma": float(np.sqrt((K2 / M2) / (K1 / 250.0))),
    "beta": 0.4,
    "zeta": 1.5,
    "k3": 300e6,
    "threshold": 50e3,
}
GAPS = (-0.005, 0.0, 0.005)
WIDE_GAPS = (0.010, 0.015, 0.020)
STIFFNESSES = (100e6, 300e6, 500e6)
OVER_SPEED = grid(
    "drill over speed",
    "drilling",
    {"k3": STIFFNESSES, "v": np.linspace(0.5, 2.5, 17)},
    ("drive", "stuck", "touching"),
    **{name: value for name, value in TABLE_6_6.items() if name != "k3"},
)
MOVING = motion("drilling", 8.0, **TABLE_6_6)
BLOW = float(contact_time(M2, 20e6, 10.0))
"""Duration [s] of a blow on the contact of Table 6.6."""


def _drill(start: str = "drive", **parameters):
    return lane("drilling", start, **TABLE_6_6 | parameters)


def _pulse(k3: float):
    pulse = {"pulse_shape": "half-sine", "force": 470e3, "pulse_width": BLOW, "frequency": 5.8}
    return lane("penetration", settle=1.0, observe=1.0, threshold=250e3, zeta=1.5, k3=k3, **pulse)


def _frequency(said: str):
    source = float(said)

    def judge(one) -> Here:
        p = {"m1": 250.0, "beta": 0.4, "gamma": TABLE_6_6["gamma"], "k1": K1 * max(1.0, (source / 5.8) ** 2)}
        without = float(empirical_frequency(p)) / (2 * np.pi)
        note = f"eq. 5.17, without impact, gives {without:.2f} Hz: the source may have given that"
        return printed(one.frequency, said, "Hz", note)

    return judge


def _only_at_impact(moving) -> Here:
    """The growth of the hole that is neither during an impact nor in the 5 ms after one."""
    time = moving["time"].values[:-1]
    near = np.zeros(len(time), bool)
    for begin in signal.events(moving, "impact"):
        near |= (time >= begin - 1e-4) & (time <= begin + BLOW + 5e-3)
    share = signal.grown(moving, ~near)
    return trend(f"{shown(share)} of the hole grows away from impacts", share < 1e-6)


def _over_gap(*lanes) -> Here:
    forces = [one["peak_impact_force"] / 1e3 for one in lanes]
    few, many = forces[: len(GAPS)], forces[len(GAPS) :]
    text = f"{listed(few)} kN at {listed([1e3 * gap for gap in GAPS])} mm, {listed(many)} kN at 10, 15, 20 mm"
    note = "it grows with the gap while there is a single impact; from 10 mm on the striker only rattles"
    rises = bool(np.all(np.diff(few) > 0))
    return Here(text, IN_TREND if rises and min(many) > max(few) else DIFFERS, note)


def _rate_over_gap(*lanes) -> Here:
    rates = [1e3 * one["rate_of_penetration"] for one in lanes]
    return trend(
        f"{listed(rates)} mm/s at gaps of {listed([1e3 * g for g in GAPS])} mm", bool(np.all(np.diff(rates) > 0))
    )


def _rate_over_stiffness(*lanes) -> Here:
    rates = [1e3 * one["rate_of_penetration"] for one in lanes]
    return trend(f"{listed(rates)} mm/s at k3 100, 300, 500 MN/m", _grows_less(rates))


def _grows_less(values) -> bool:
    """Whether the second step is one up, and under 0.3 of the first: 0.04 and 0.15 mm in Table 6.7."""
    first, second = np.diff(values)
    return bool(0 < second < 0.3 * first)


def _slip(index: int, source: str):
    def judge(*pulses) -> Here:
        slips = [1e3 * one["slip_per_impact"] for one in pulses]
        note = "a half-sine pulse; the drill of Table 6.6 gives no such blow, and none that breaks rock of 250 kN"
        return printed(slips[index], source, "mm", note, trend=_grows_less(slips))

    return judge


def _highest(ds) -> Here:
    peak = float(ds.peak_impact_force.max() / 1e3)
    where = ds.peak_impact_force.max(("k3", "start"))
    v = float(ds.v[int(np.argmax(where.values))])
    return number(peak, 470.0, "kN", 0.01, f"the highest of v 0.5 to 2.5 m/s and three starts, at {v:g} m/s")


def _constant(ds) -> Here:
    fit = fit_rop(ds.sel(start=["drive"]), along="v", progress=False)
    found = 2 * np.pi * fit.C.sel(form="onset").values.ravel()
    note = f"in the listing's rate, for k3 100, 300, 500 MN/m ({listed(found)}), D 50 kN, along the driving velocity"
    return printed(float(found[1]), "0.44", "m/s", note)


def _same_cycle(one, without, coupled) -> Here:
    off, back = (abs(other.frequency / without.frequency - 1) for other in (one, coupled))
    force = coupled["peak_impact_force"] / without["peak_impact_force"] - 1
    note = f"with the bit's motion fed back: period {100 * back:.2f} %, greatest impact force {100 * force:+.1f} %"
    return claim(f"{100 * off:.2g} % change of the period", off < 0.01 and back < 0.01, note)


def _in_contact(one) -> Here:
    gap = abs(1e3 * one["deepest_gap"])
    return claim(f"{gap:.4f} mm between bit and rock at most", gap < 0.01)


def _response(one, without) -> Here:
    return claim(
        f"{abs(one.frequency - without.frequency):.2g} Hz of change", abs(one.frequency - without.frequency) < 0.01
    )


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
            _frequency("5.8"),
            LAST_DIGIT,
            _USUAL,
        ),
        Entry(
            "table-6.6.2",
            "frequency, k1 4 times",
            "11.6 Hz",
            (_drill(k1=K1 * 4),),
            _frequency("11.6"),
            LAST_DIGIT,
            (*_USUAL, "R26"),
        ),
        Entry(
            "table-6.6.3",
            "frequency, k1 5.74 times",
            "13.9 Hz",
            (_drill(k1=K1 * (13.9 / 5.8) ** 2),),
            _frequency("13.9"),
            LAST_DIGIT,
            (*_USUAL, "R26"),
        ),
        Entry(
            "fig-6.29",
            "motion of the hole",
            "only at impact, stepwise",
            (MOVING,),
            _only_at_impact,
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
            _over_gap,
            "the order, over -5 to 20 mm",
            (*_USUAL, "R6"),
        ),
        Entry(
            "fig-6.32",
            "rate of penetration over the gap",
            "increases with it",
            tuple(_drill("stuck", delta=gap) for gap in GAPS),
            _rate_over_gap,
            "the order, over -5 to 5 mm, where there is a single impact",
            (*_USUAL, "R6"),
        ),
        Entry(
            "fig-6.33",
            "rate of penetration over k3",
            "grows; little from 300 to 500 MN/m",
            tuple(_drill(k3=k3) for k3 in STIFFNESSES),
            _rate_over_stiffness,
            "the second step above 0, and under 0.3 of the first",
            _USUAL,
        ),
        *(
            Entry(
                f"table-6.7.{index + 1}",
                f"slip under a blow of 470 kN, D 250 kN, k3 {k3 / 1e6:g} MN/m",
                f"{source} mm",
                _PULSES,
                _slip(index, source),
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
            _highest,
            "1 %: its second digit is the last that is sure",
            (*_USUAL, "R11"),
        ),
        Entry(
            "fig-6.34",
            "C of the whole drill",
            "0.44 m/s",
            (OVER_SPEED,),
            _constant,
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
            _same_cycle,
            "1 % of the period, also with the bit's normal motion fed back",
            _USUAL,
        ),
        Entry(
            "sec-6.6a", "contact of bit and rock", "no separation, 0 mm", (_drill(),), _in_contact, "0.01 mm", _USUAL
        ),
        Entry(
            "fig-6.37",
            "frequency with penetration beside that without",
            "no change, 0 Hz",
            (_drill(), lane("vibro-impact", **_WITHOUT)),
            _response,
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
