"""Judges of the law of the rate of penetration (eq. 6.4) with its constant C, and of the whole drill."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.analyses.rop_law import fit_rop
from vibrojax.models.physics.modes import empirical_frequency
from vibrojax.reproduce import datasets_chapter6 as data
from vibrojax.reproduce import motions
from vibrojax.reproduce.judges_penetration import rates
from vibrojax.reproduce.needs import Features
from vibrojax.reproduce.verdicts import (
    AGREES,
    DIFFERS,
    IN_TREND,
    Here,
    Verdict,
    claim,
    listed,
    not_compared,
    number,
    printed,
    shown,
    trend,
    within_range,
)

LISTED = 2 * np.pi
"""The listing's rate over the true one (R8)."""


def _constants(ds: xr.Dataset, width: float) -> Float[np.ndarray, "k3 force"]:
    """C [m/s] in the listing's rate, by the reading with an onset."""
    fit = fit_rop(ds.sel(pulse_width=width, drop=True), along="frequency", progress=False)
    return LISTED * fit.C.sel(form="onset").transpose("k3", "force").values


def constant_range(ds: xr.Dataset, damped: xr.Dataset) -> Here:
    usual, short = _constants(ds, 0.004), _constants(ds, 0.002)
    others = LISTED * fit_rop(damped, along="frequency", progress=False).C.sel(form="onset")
    extents = [(zeta, float(others.sel(zeta=zeta).min()), float(others.sel(zeta=zeta).max())) for zeta in data.DAMPINGS]
    by_damping = "; ".join(f"zeta {zeta}: {low:.3g} to {high:.3g}" for zeta, low, high in extents)
    note = f"pulses of 2 ms give {np.nanmin(short):.3g} to {np.nanmax(short):.3g}; with 4 ms {by_damping}"
    here = within_range(float(usual.min()), float(usual.max()), (0.046, 0.189), "m/s", note)
    any_damping = all(low >= 0.046 and high <= 0.189 for _, low, high in extents)
    return here if any_damping or here.verdict != AGREES else replace(here, verdict=IN_TREND)


def constant_over_force(ds: xr.Dataset) -> Here:
    constants = _constants(ds, 0.004)
    ratio = constants[:, 2] / constants[:, 0]
    return trend(f"{ratio[0]:.2f} times from 200 to 300 kN, {ratio[1]:.2f} at k3 500 MN/m", (ratio > 2).all())


def constant_over_stiffness(ds: xr.Dataset) -> Here:
    constants = _constants(ds, 0.004)
    ratio = constants[1] / constants[0]
    return trend(f"{listed(ratio)} times from k3 300 to 500 MN/m", (np.abs(ratio - 1) < 0.25).all())


def literal_constant(ds: xr.Dataset) -> Here:
    fit = fit_rop(ds.sel(pulse_width=0.004, drop=True), along="frequency", progress=False)
    constants = fit.C.sel(form="literal").values
    text = f"{constants.min():.4f} to {constants.max():.4f} m/s is C of the law as printed"
    return claim(text, (constants > 0).all(), "P/D is below 1, so its logarithm is negative and C must be too")


def shape_over_frequency(ds: xr.Dataset) -> Here:
    return _shape(ds.sel(pulse_width=0.004, drop=True), "frequency")


def shape_over_force(ds: xr.Dataset) -> Here:
    return _shape(ds, "force")


def _shape(ds: xr.Dataset, along: str) -> Here:
    fit = fit_rop(ds, along=along, progress=False)
    log, line = (fit.r_squared.sel(form=form).values.ravel() for form in ("onset", "line"))
    better = int((fit.aic.sel(form="onset") < fit.aic.sel(form="line")).sum())
    text = f"{better} of {log.size} groups are better told by the logarithm than by a line along {along}"
    note = (
        f"R² of the logarithm {np.nanmin(log):.3f} to {np.nanmax(log):.3f}, of the line {np.nanmin(line):.4f} at least"
    )
    return Here(text, AGREES if better == log.size else IN_TREND if better else DIFFERS, note)


def underestimates(ds: xr.Dataset) -> Here:
    speeds = ds.rate_of_penetration
    slips = [float(zeta) for zeta in ds.zeta.values if float(speeds.sel(zeta=zeta).max()) > 0]
    if not slips:
        return Here("0 mm/s for every damping", DIFFERS, "no slip in rock as soft as that")
    fit = fit_rop(ds.sel(zeta=[slips[0]]), along="frequency", progress=False)
    constant, onset = (float(fit[name].sel(form="onset").values.ravel()[0]) for name in ("C", "eta0"))
    highest = ds.sel(zeta=slips[0]).isel(frequency=-1)
    missing = float(highest.rate_of_penetration) / (constant * np.log(float(highest.relief) / onset)) - 1
    note = f"at zeta {slips[0]}; of zeta {listed(ds.zeta.values)} the rock slips at {listed(slips)}"
    return trend(f"{100 * missing:.1f} % above the fitted law at the highest P/D", missing > 0, note)


def thrust(ds: xr.Dataset) -> Here:
    part = ds.sel(pulse_width=0.004).where(ds.sel(pulse_width=0.004).rate_of_penetration > 0)
    low, high = 100 * float(part.relief.min()), 100 * float(part.relief.max())
    return within_range(low, high, (10, 20), "%", note="P/D of the lanes that slip, 200 to 300 kN, 10 to 40 Hz")


# The whole drill.


def frequency(source: str) -> Callable[[Features], Here]:
    """The drill's frequency [Hz] beside the source's, with k1 set to give that."""
    k1 = data.K1 * max(1.0, (float(source) / 5.8) ** 2)

    def judge(one: Features) -> Here:
        p = {"m1": 250.0, "beta": 0.4, "gamma": data.TABLE_6_6["gamma"], "k1": k1}
        without = float(empirical_frequency(p)) / (2 * np.pi)
        note = f"eq. 5.17, without impact, gives {without:.2f} Hz: the source may have given that"
        return printed(one.frequency, source, "Hz", note)

    return judge


def only_at_impact(motion: xr.Dataset) -> Here:
    """The growth of the hole that is neither during an impact nor in the 5 ms after one."""
    time = motion["time"].values[:-1]
    near = np.zeros(len(time), bool)
    for begin in motions.events(motion, "impact"):
        near |= (time >= begin - 1e-4) & (time <= begin + data.BLOW + 5e-3)
    share = motions.grown(motion, ~near)
    return trend(f"{shown(share)} of the hole grows away from impacts", share < 1e-6)


def over_gap(*lanes: Features) -> Here:
    forces = [one["peak_impact_force"] / 1e3 for one in lanes]
    gaps = [1e3 * gap for gap in data.SINGLE_IMPACT_GAPS]
    narrow, wide = forces[: len(gaps)], forces[len(gaps) :]
    text = f"{listed(narrow)} kN at {listed(gaps)} mm, {listed(wide)} kN at 10, 15, 20 mm"
    note = "it grows with the gap while there is a single impact; from 10 mm on the striker only rattles"
    verdict: Verdict = IN_TREND if np.all(np.diff(narrow) > 0) and min(wide) > max(narrow) else DIFFERS
    return Here(text, verdict, note)


def rate_over_gap(*lanes: Features) -> Here:
    gaps = [1e3 * gap for gap in data.SINGLE_IMPACT_GAPS]
    return trend(f"{listed(rates(lanes))} mm/s at gaps of {listed(gaps)} mm", np.all(np.diff(rates(lanes)) > 0))


def rate_over_stiffness(*lanes: Features) -> Here:
    return trend(f"{listed(rates(lanes))} mm/s at k3 100, 300, 500 MN/m", _grows_less(rates(lanes)))


def _grows_less(values: Sequence[float] | Float[np.ndarray, " values"]) -> bool:
    """Whether the second step is one up, and under 0.3 of the first: 0.04 and 0.15 mm in Table 6.7."""
    first, second = np.diff(values)
    return bool(0 < second < 0.3 * first)


def slip(index: int, source: str) -> Callable[..., Here]:
    """The slip [mm] of one of the pulses beside the source's."""

    def judge(*pulses: Features) -> Here:
        slips = [1e3 * one["slip_per_impact"] for one in pulses]
        note = "a half-sine pulse; the drill of Table 6.6 gives no such blow, and none that breaks rock of 250 kN"
        return printed(slips[index], source, "mm", note, trend=_grows_less(slips))

    return judge


def highest_force(ds: xr.Dataset) -> Here:
    peak = float(ds.peak_impact_force.max() / 1e3)
    where = ds.peak_impact_force.max(("k3", "start"))
    v = float(ds.v[int(np.argmax(where.values))])
    return number(peak, 470.0, "kN", 0.01, f"the highest of v 0.5 to 2.5 m/s and three starts, at {v:g} m/s")


def drilled_constant(ds: xr.Dataset) -> Here:
    fit = fit_rop(ds.sel(start=["drive"]), along="v", progress=False)
    constants = LISTED * fit.C.sel(form="onset").values.ravel()
    note = (
        f"in the listing's rate, for k3 100, 300, 500 MN/m ({listed(constants)}), D 50 kN, along the driving velocity"
    )
    return printed(float(constants[1]), "0.44", "m/s", note)


def same_cycle(one: Features, without: Features, coupled: Features) -> Here:
    off, back = (abs(other.frequency / without.frequency - 1) for other in (one, coupled))
    force = coupled["peak_impact_force"] / without["peak_impact_force"] - 1
    note = f"with the bit's motion fed back: period {100 * back:.2f} %, greatest impact force {100 * force:+.1f} %"
    return claim(f"{100 * off:.2g} % change of the period", off < 0.01 and back < 0.01, note)


def in_contact(one: Features) -> Here:
    gap = abs(1e3 * one["deepest_gap"])
    return claim(f"{gap:.4f} mm between bit and rock at most", gap < 0.01)


def same_response(one: Features, without: Features) -> Here:
    change = abs(one.frequency - without.frequency)
    return claim(f"{change:.2g} Hz of change", change < 0.01)


def depth(motion: xr.Dataset) -> Here:
    return not_compared(f"{1e3 * float(motion['x4'][-1]):.2f} mm", "the figure's axis is not in the text")
