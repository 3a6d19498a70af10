"""Judges of impact over the mass ratio, and of the source's region of best performance."""

from collections.abc import Callable, Mapping

import numpy as np
import xarray as xr

from vibrojax.reproduce import datasets_chapter5 as data
from vibrojax.reproduce import motions
from vibrojax.reproduce.judges_impact import change, forces, is_single
from vibrojax.reproduce.needs import ALL_STARTS, Features
from vibrojax.reproduce.verdicts import AGREES, DIFFERS, IN_TREND, VERDICTS, Here, Verdict, claim, listed, trend


def extra_swings(one: Features) -> Here:
    return claim(f"{one['striker_turns']:.2f} swings of the striker per cycle", one["striker_turns"] > 1.5)


def weaker(light: Features, usual: Features) -> Here:
    text = f"{change(light):.2f} m/s at beta 0.1, {change(usual):.2f} m/s at beta 0.4"
    return trend(text, change(light) < change(usual))


def unstable(*lanes: Features) -> Here:
    count = sum(not is_single(one) for one in lanes)
    text = f"{count} of {len(lanes)} points (beta 0.1, 0.15, 0.2) are not a single impact"
    return claim(text, count > 0, "the single impact is stable there too, with a second swing of the striker at 0.1")


def all_single(*lanes: Features) -> Here:
    counts = [one["impacts"] for one in lanes]
    return claim(f"{listed(counts)} impacts per cycle at beta {listed(data.BETAS)}", all(map(is_single, lanes)))


def amplitudes(*lanes: Features) -> Here:
    swings = [1e3 * one["striker_amplitude"] for one in lanes]
    return trend(f"{listed(swings)} mm at beta {listed(data.BETAS)}", np.all(np.diff(swings) > 0))


def smaller_swing(soft: Features, stiff: Features) -> Here:
    swings = [1e3 * one["striker_amplitude"] for one in (soft, stiff)]
    return trend(f"{swings[0]:.1f} mm at k1 156250, {swings[1]:.1f} mm at 625000", swings[1] < swings[0])


def greater_force(*soft_and_stiff: Features) -> Here:
    soft, stiff = forces(soft_and_stiff)
    return trend(f"{soft:.1f} kN at k1 156250, {stiff:.1f} kN at 625000", stiff > soft)


def same_frequency(*lanes: Features) -> Here:
    frequencies = np.array([one.angular_frequency for one in lanes])
    text = f"{100 * (frequencies.max() / frequencies.min() - 1):.1f} % between beta 0.25 and 0.6"
    return claim(text, np.ptp(frequencies) < 0.022 * frequencies.min())


def settles_late(early: Features, late: Features) -> Here:
    since = late["settling_time"]
    note = f"at 40 s it is {early.regime}, and creeps; returns differ by under 1 % from {since:.0f} s on"
    return claim(f"{late['cycles']:.0f} return to repeat, by 300 s", late["cycles"] == 1, note)


def no_sticking(one: Features) -> Here:
    text = f"{one['stick_fraction']:.4f} of the time sticking, {one['reverse_fraction']:.4f} sliding backwards"
    return claim(text, one["stick_fraction"] == 0 and one["reverse_fraction"] == 0)


def tolerable_damping(*lanes: Features) -> Here:
    shares = data.DAMPING_SHARES
    good = [share for share, one in zip(shares, lanes, strict=True) if is_single(one)]
    if not good:
        return Here("nan", DIFFERS)
    first_bad = next((share for share in shares if share not in good), np.inf)
    below = [share for share in good if share < first_bad]
    highest = 100 * max(below, default=np.nan)
    text = f"{highest:.0f} % of 250 N s/m gives a single impact by 40 s, of {listed(shares, 2)}"
    verdict: Verdict = IN_TREND if 0.25 in good and 1.0 not in good else DIFFERS
    return Here(text, AGREES if max(below, default=0) == 0.25 else verdict)


def equal_masses(early: Features, late: Features, damped_less: Features) -> Here:
    text = f"{late['impacts']:.3g} impact in {late['cycles']:.0f} returns by 300 s; at 40 s {early.regime}"
    note = f"with a quarter of the damping: {damped_less.regime}, {damped_less.angular_frequency:.2f} rad/s"
    return Here(text, AGREES if is_single(late) else IN_TREND if late["impacts"] == 1 else DIFFERS, note)


def creeps(motion: xr.Dataset) -> Here:
    _, swings = motions.envelope(motion, "x1", 2.0)
    early, middle, late = (1e3 * float(swings[part].max()) for part in (slice(2, 5), slice(7, 10), slice(15, 20)))
    text = f"{early:.1f} mm at 4 to 10 s, {middle:.1f} mm at 14 to 20 s, {late:.1f} mm after 30 s"
    return trend(text, early < middle < late)


def neither(*lanes: Features) -> Here:
    regimes = ", ".join(f"{one.regime} from `{start}`" for one, start in zip(lanes, ALL_STARTS, strict=True))
    irregular = sum(one["cycles"] == 0 for one in lanes)
    return claim(f"{irregular} of 3 starts not periodic by 40 s", lanes[0]["cycles"] == 0, regimes)


def still_single(one: Features, damped_less: Features) -> Here:
    note = f"with a quarter of the damping: {damped_less.regime}, change of velocity {change(damped_less):.2f} m/s"
    text = f"{one['impacts']:.2f} impacts per cycle, {one.regime}"
    return Here(text, AGREES if is_single(one) else DIFFERS, note)


def stronger(heavy: Features, usual: Features) -> Here:
    text = f"{change(heavy):.2f} m/s, {change(usual):.2f} m/s at beta 0.4"
    return trend(text, change(heavy) > change(usual))


# The region, of which maps are judged: arrays over beta and gamma, true where a lane is good.

SINGLE = 3
"""The flag of the regime single-impact."""
BEST_BOX = {"beta": (0.25, 0.6), "gamma": (0.6, 0.8)}
NARROW_BOX = {"beta": (0.25, 0.4), "gamma": (0.7, 0.8)}
"""That of the source's conclusions, in chapter 7."""
STEP = 0.05 + 1e-6
"""Half the source's step of 0.1: it cannot know the borders of its region any better, and calls them critical."""
ALL_OF_IT = "all of it; in trend from 0.8 on, if all that fails is within 0.05 of the border: half the source's step"
"""The tolerance of shares of the region."""


def single(ds: xr.Dataset) -> xr.DataArray:
    """Where a lane is a stable single impact."""
    return ds.regime == SINGLE


def clean(ds: xr.Dataset) -> xr.DataArray:
    """Where it is one with one swing of the striker a cycle."""
    return single(ds) & (ds.striker_turns < 1.05)


def strong(ds: xr.Dataset) -> xr.DataArray:
    """Where it is a clean one with an impact velocity over the drive's."""
    return clean(ds) & (ds.impact_velocity > ds.v)


def coexisting(ds: xr.Dataset) -> xr.DataArray:
    """Where one start ends in a single impact, and another in something else or in a weaker one."""
    good = single(ds)
    weakest, best = ds.impact_velocity.fillna(0).min("start"), ds.impact_velocity.where(good).max("start")
    return good.any("start") & (~good.all("start") | (weakest < 0.9 * best))


def _usual(ds: xr.Dataset) -> xr.Dataset:
    """The map at the source's gap and speed, from its own start."""
    return ds.sel(delta=-0.005, v=1.5, start="drive")


def share(
    good: Callable[[xr.Dataset], xr.DataArray], text: str, box: Mapping[str, tuple[float, float]] = BEST_BOX
) -> Callable[[xr.Dataset], Here]:
    """Which share of a box of beta and gamma is good, at the source's gap and speed."""

    def judge(ds: xr.Dataset) -> Here:
        here = _usual(ds).sel({name: slice(low - 1e-6, high + 1e-6) for name, (low, high) in box.items()})
        is_good = good(here)
        bad = here.where(~is_good).stack(point=("beta", "gamma")).dropna("point", subset=["regime"])
        note = f"{bad.sizes['point']} of {is_good.size} points are not" if bad.sizes["point"] else ""
        return Here(f"{float(is_good.mean()):.3f} of {text}", _verdict(is_good), note)

    return judge


def _verdict(good: xr.DataArray) -> Verdict:
    """Agreement where all of the region is good; in trend where four fifths are, and all that is over a step inside."""
    inner = {name: slice(low + STEP, high - STEP) for name, (low, high) in BEST_BOX.items()}
    core, portion = good.sel(inner), float(good.mean())
    return AGREES if portion == 1 else IN_TREND if portion >= 0.8 and bool(core.all()) else DIFFERS


def outside(ds: xr.Dataset) -> Here:
    here = _usual(ds)
    portion = float(strong(here).where(~_near_best(here)).mean())
    text = f"{portion:.3f} of the points over 0.05 outside are clean and strong single impacts too"
    note = f"beta 0.1 to 1.2, gamma 0.3 to 1.2; {_extent(strong(here))}"
    return Here(text, AGREES if portion == 0 else IN_TREND if portion < 0.05 else DIFFERS, note)


def _near_best(ds: xr.Dataset) -> xr.DataArray:
    """Which points lie in the region, or within a step of it."""
    beta, gamma = ((ds[name] >= low - STEP) & (ds[name] <= high + STEP) for name, (low, high) in BEST_BOX.items())
    return beta & gamma


def _extent(good: xr.DataArray) -> str:
    """Where along gamma the good points lie, at some mass ratios."""
    parts = []
    for beta in (0.1, 0.25, 0.4, 0.6, 0.8):
        gammas = good.gamma.values[good.sel(beta=beta, method="nearest").values]
        parts.append(f"beta {beta}: {gammas.min():g} to {gammas.max():g}" if gammas.size else f"beta {beta}: none")
    return "along gamma, " + "; ".join(parts)


def any_speed(ds: xr.Dataset) -> Here:
    good = single(ds.sel(delta=-0.005, start="drive"))
    shares = [float(good.sel(v=v).mean()) for v in ds.v.values]
    text = f"{min(shares):.3f} at least, of v {', '.join(f'{v:g}' for v in ds.v.values)} m/s: "
    verdicts = {_verdict(good.sel(v=v)) for v in ds.v.values}
    worst = next(verdict for verdict in VERDICTS if verdict in verdicts)
    return Here(text + ", ".join(f"{portion:.3f}" for portion in shares), worst)


def second_motion(ds: xr.Dataset) -> Here:
    box = ds.sel(beta=slice(0.249, 0.601), gamma=slice(0.599, 0.801))
    by_gap = coexisting(box).mean(("v", "beta", "gamma"))
    text = f"{float(coexisting(box).mean()):.3f} of the region has a second, worse motion, over gaps and speeds"
    pairs = zip(ds.delta.values, by_gap.values, strict=True)
    gaps = ", ".join(f"{1e3 * gap:g} mm {float(portion):.2f}" for gap, portion in pairs)
    return claim(text, not by_gap.any(), f"by gap: {gaps}")
