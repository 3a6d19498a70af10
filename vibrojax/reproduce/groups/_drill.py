"""How the results of the whole drill are judged, and the machine of Table 6.6."""

import numpy as np

from vibrojax.laws import fit_rop
from vibrojax.physics.contact import contact_time
from vibrojax.physics.modes import empirical_frequency
from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import DIFFERS, IN_TREND, Here, claim, listed, number, printed, shown, trend

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
BLOW = float(contact_time(M2, 20e6, 10.0))
"""Duration [s] of a blow on the contact of Table 6.6."""


def frequency(said: str):
    source = float(said)

    def judge(one) -> Here:
        p = {"m1": 250.0, "beta": 0.4, "gamma": TABLE_6_6["gamma"], "k1": K1 * max(1.0, (source / 5.8) ** 2)}
        without = float(empirical_frequency(p)) / (2 * np.pi)
        note = f"eq. 5.17, without impact, gives {without:.2f} Hz: the source may have given that"
        return printed(one.frequency, said, "Hz", note)

    return judge


def only_at_impact(moving) -> Here:
    """The growth of the hole that is neither during an impact nor in the 5 ms after one."""
    time = moving["time"].values[:-1]
    near = np.zeros(len(time), bool)
    for begin in signal.events(moving, "impact"):
        near |= (time >= begin - 1e-4) & (time <= begin + BLOW + 5e-3)
    share = signal.grown(moving, ~near)
    return trend(f"{shown(share)} of the hole grows away from impacts", share < 1e-6)


def over_gap(*lanes) -> Here:
    forces = [one["peak_impact_force"] / 1e3 for one in lanes]
    few, many = forces[: len(GAPS)], forces[len(GAPS) :]
    text = f"{listed(few)} kN at {listed([1e3 * gap for gap in GAPS])} mm, {listed(many)} kN at 10, 15, 20 mm"
    note = "it grows with the gap while there is a single impact; from 10 mm on the striker only rattles"
    rises = bool(np.all(np.diff(few) > 0))
    return Here(text, IN_TREND if rises and min(many) > max(few) else DIFFERS, note)


def rate_over_gap(*lanes) -> Here:
    rates = [1e3 * one["rate_of_penetration"] for one in lanes]
    return trend(
        f"{listed(rates)} mm/s at gaps of {listed([1e3 * g for g in GAPS])} mm", bool(np.all(np.diff(rates) > 0))
    )


def rate_over_stiffness(*lanes) -> Here:
    rates = [1e3 * one["rate_of_penetration"] for one in lanes]
    return trend(f"{listed(rates)} mm/s at k3 100, 300, 500 MN/m", grows_less(rates))


def grows_less(values) -> bool:
    """Whether the second step is one up, and under 0.3 of the first: 0.04 and 0.15 mm in Table 6.7."""
    first, second = np.diff(values)
    return bool(0 < second < 0.3 * first)


def slip(index: int, source: str):
    def judge(*pulses) -> Here:
        slips = [1e3 * one["slip_per_impact"] for one in pulses]
        note = "a half-sine pulse; the drill of Table 6.6 gives no such blow, and none that breaks rock of 250 kN"
        return printed(slips[index], source, "mm", note, trend=grows_less(slips))

    return judge


def highest(ds) -> Here:
    peak = float(ds.peak_impact_force.max() / 1e3)
    where = ds.peak_impact_force.max(("k3", "start"))
    v = float(ds.v[int(np.argmax(where.values))])
    return number(peak, 470.0, "kN", 0.01, f"the highest of v 0.5 to 2.5 m/s and three starts, at {v:g} m/s")


def constant(ds) -> Here:
    fit = fit_rop(ds.sel(start=["drive"]), along="v", progress=False)
    found = 2 * np.pi * fit.C.sel(form="onset").values.ravel()
    note = f"in the listing's rate, for k3 100, 300, 500 MN/m ({listed(found)}), D 50 kN, along the driving velocity"
    return printed(float(found[1]), "0.44", "m/s", note)


def same_cycle(one, without, coupled) -> Here:
    off, back = (abs(other.frequency / without.frequency - 1) for other in (one, coupled))
    force = coupled["peak_impact_force"] / without["peak_impact_force"] - 1
    note = f"with the bit's motion fed back: period {100 * back:.2f} %, greatest impact force {100 * force:+.1f} %"
    return claim(f"{100 * off:.2g} % change of the period", off < 0.01 and back < 0.01, note)


def in_contact(one) -> Here:
    gap = abs(1e3 * one["deepest_gap"])
    return claim(f"{gap:.4f} mm between bit and rock at most", gap < 0.01)


def response(one, without) -> Here:
    return claim(
        f"{abs(one.frequency - without.frequency):.2g} Hz of change", abs(one.frequency - without.frequency) < 0.01
    )
