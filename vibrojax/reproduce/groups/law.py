"""The law of the rate of penetration, eq. 6.4, and its constant C (chapter 6, section 5)."""

from dataclasses import replace

import numpy as np

from vibrojax.laws import fit_rop
from vibrojax.reproduce._entry import AGREES, DIFFERS, IN_TREND, MOSTLY, Entry, Here, claim, listed, trend, within_range
from vibrojax.reproduce._group import Group, Picture
from vibrojax.reproduce._needs import grid
from vibrojax.reproduce.pictures import law as pictures

_RUN = {"settle": 1.0, "observe": 1.0}
FREQUENCIES = (10.0, 20.0, 30.0, 40.0)
C_MAP = grid(
    "rate constant",
    "penetration",
    {"pulse_width": (0.002, 0.004), "k3": (300e6, 500e6), "force": (200e3, 250e3, 300e3), "frequency": FREQUENCIES},
    zeta=0.6,
    **_RUN,
)
DAMPINGS = (0.5, 0.6, 0.9, 1.1, 1.5)
OVER_DAMPING = grid(
    "rate constant over damping",
    "penetration",
    {"zeta": DAMPINGS, "k3": (300e6, 500e6), "force": (200e3, 250e3, 300e3), "frequency": FREQUENCIES},
    **_RUN,
)
SOFT_MAP = grid(
    "soft rock of Fig 6.27",
    "penetration",
    {"zeta": (0.5, 0.6, 0.9, 1.1), "frequency": np.linspace(10, 40, 7)},
    force=200e3,
    k3=50e6,
    **_RUN,
)
ALONG_FORCE = grid(
    "rate along force",
    "penetration",
    {"k3": (300e6, 500e6), "frequency": (20.0,), "force": np.linspace(100e3, 300e3, 21)},
    zeta=0.6,
    **_RUN,
)
LISTED = 2 * np.pi
"""The listing's rate over the true one (R8)."""


def _constants(ds, width: float) -> np.ndarray:
    """C [m/s] in the listing's rate, over k3 and force, by the reading with an onset."""
    fit = fit_rop(ds.sel(pulse_width=width, drop=True), along="frequency", progress=False)
    return LISTED * fit.C.sel(form="onset").transpose("k3", "force").values


def _range(ds, damped) -> Here:
    found, short = _constants(ds, 0.004), _constants(ds, 0.002)
    fit = fit_rop(damped, along="frequency", progress=False)
    others = LISTED * fit.C.sel(form="onset")
    extents = {zeta: (float(others.sel(zeta=zeta).min()), float(others.sel(zeta=zeta).max())) for zeta in DAMPINGS}
    told = "; ".join(f"zeta {zeta}: {low:.3g} to {high:.3g}" for zeta, (low, high) in extents.items())
    note = f"pulses of 2 ms give {np.nanmin(short):.3g} to {np.nanmax(short):.3g}; with 4 ms {told}"
    here = within_range(float(found.min()), float(found.max()), (0.046, 0.189), "m/s", note)
    any_damping = all(low >= 0.046 and high <= 0.189 for low, high in extents.values())
    return here if any_damping or here.verdict != AGREES else replace(here, verdict=IN_TREND)


def _of_force(ds) -> Here:
    found = _constants(ds, 0.004)
    ratio = found[:, 2] / found[:, 0]
    return trend(f"{ratio[0]:.2f} times from 200 to 300 kN, {ratio[1]:.2f} at k3 500 MN/m", bool((ratio > 2).all()))


def _of_stiffness(ds) -> Here:
    found = _constants(ds, 0.004)
    ratio = found[1] / found[0]
    return trend(f"{listed(ratio)} times from k3 300 to 500 MN/m", bool((np.abs(ratio - 1) < 0.25).all()))


def _shape(ds, along: str) -> Here:
    fit = fit_rop(ds, along=along, progress=False)
    log, line = (fit.r_squared.sel(form=form).values.ravel() for form in ("onset", "line"))
    better = int((fit.aic.sel(form="onset") < fit.aic.sel(form="line")).sum())
    text = f"{better} of {log.size} groups are better told by the logarithm than by a line along {along}"
    note = (
        f"R² of the logarithm {np.nanmin(log):.3f} to {np.nanmax(log):.3f}, of the line {np.nanmin(line):.4f} at least"
    )
    verdict = AGREES if better == log.size else IN_TREND if better else DIFFERS
    return Here(text, verdict, note)


def _underestimates(ds) -> Here:
    rates = ds.rate_of_penetration
    slips = [float(zeta) for zeta in ds.zeta.values if float(rates.sel(zeta=zeta).max()) > 0]
    if not slips:
        return Here("0 mm/s for every damping", DIFFERS, "no slip in rock as soft as that")
    part = ds.sel(zeta=slips[0])
    fit = fit_rop(ds.sel(zeta=[slips[0]]), along="frequency", progress=False)
    C, eta0 = (float(fit[name].sel(form="onset").values.ravel()[0]) for name in ("C", "eta0"))
    last = part.isel(frequency=-1)
    missing = float(last.rate_of_penetration) / (C * np.log(float(last.relief) / eta0)) - 1
    note = f"at zeta {slips[0]}; of zeta {listed(ds.zeta.values)} the rock slips at {listed(slips)}"
    return trend(f"{100 * missing:.1f} % above the fitted law at the highest P/D", missing > 0, note)


def _thrust(ds) -> Here:
    part = ds.sel(pulse_width=0.004).where(ds.sel(pulse_width=0.004).rate_of_penetration > 0)
    low, high = 100 * float(part.relief.min()), 100 * float(part.relief.max())
    return within_range(low, high, (10, 20), "%", note="P/D of the lanes that slip, 200 to 300 kN, 10 to 40 Hz")


def _literal(ds) -> Here:
    fit = fit_rop(ds.sel(pulse_width=0.004, drop=True), along="frequency", progress=False)
    found = fit.C.sel(form="literal").values
    text = f"{found.min():.4f} to {found.max():.4f} m/s is C of the law as printed"
    return claim(text, bool((found > 0).all()), "P/D is below 1, so its logarithm is negative and C must be too")


_USUAL = ("R8", "R9", "R10")
GROUP = Group(
    name="law",
    title="The law of the rate of penetration",
    text="The source fits ROP = C ln(P/D) to pulses of different frequency. Here the same pulses are simulated, and "
    "the logarithm is fitted beside a line. Zeta 0.6 and D 150 kN, which the source does not say for these (R8).",
    entries=(
        Entry(
            "eq-6.4a",
            "C for 200, 250, 300 kN and k3 300, 500 MN/m, in the listing's rate",
            "0.046 to 0.189",
            (C_MAP, OVER_DAMPING),
            _range,
            "the range at every damping of the source, zeta 0.5 to 1.5; in trend where that at zeta 0.6 is within it",
            _USUAL,
        ),
        Entry(
            "eq-6.4b",
            "C over the force",
            "strongly affected",
            (C_MAP,),
            _of_force,
            "over 2 times from 200 to 300 kN",
            _USUAL,
        ),
        Entry(
            "eq-6.4c",
            "C over the stiffness",
            "little effect",
            (C_MAP,),
            _of_stiffness,
            "under 25 %, where the force makes over 100 %",
            _USUAL,
        ),
        Entry("eq-6.4d", "sign of C in the law as printed", "positive", (C_MAP,), _literal, "the sign", ("R9",)),
        Entry(
            "eq-6.4e",
            "shape of the rate over P/D, varied by the frequency",
            "logarithmic",
            (C_MAP,),
            lambda ds: _shape(ds.sel(pulse_width=0.004, drop=True), "frequency"),
            "AIC over the same lanes",
            _USUAL,
        ),
        Entry(
            "eq-6.4f",
            "shape of the rate over P/D, varied by the force",
            "logarithmic",
            (ALONG_FORCE,),
            lambda ds: _shape(ds, "force"),
            "AIC over the same lanes",
            _USUAL,
        ),
        Entry(
            "fig-6.27",
            "200 kN, k3 50 MN/m: the rate beside eq. 6.4 at high P/D",
            "the law underestimates",
            (SOFT_MAP,),
            _underestimates,
            "the sign",
            (*_USUAL, "R24"),
        ),
        Entry(
            "sec-7b",
            "applied load compared with the threshold",
            "10 to 20 %",
            (C_MAP,),
            _thrust,
            MOSTLY,
            ("R10",),
        ),
    ),
    pictures=(
        Picture(
            "Eq. 6.4",
            "The rate over P/D, varied by the frequency, with the logarithm and the line fitted to it: a straight line "
            "through zero, and the logarithm is a chord.",
            (C_MAP,),
            pictures.shapes,
        ),
        Picture(
            "Eq. 6.4",
            "C over force, stiffness and pulse width, in the listing's rate; the grey band is the source's range.",
            (C_MAP,),
            pictures.constants,
        ),
    ),
)
