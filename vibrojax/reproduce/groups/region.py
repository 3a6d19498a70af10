"""The source's region of best performance, tested over beta, gamma, v, the gap and the start (chapter 5, section 7)."""

import numpy as np

from vibrojax.reproduce._entry import AGREES, DIFFERS, IN_TREND, Entry, Here
from vibrojax.reproduce._group import Group, Picture
from vibrojax.reproduce._needs import grid
from vibrojax.reproduce.pictures import region as pictures

STARTS = ("drive", "stuck", "touching")
SINGLE = 3
WIDE = grid(
    "region over beta and gamma",
    "vibro-impact",
    {
        "delta": (-0.005, 0.005),
        "v": (0.5, 1.5),
        "beta": np.round(np.arange(0.10, 1.2001, 0.05), 3),
        "gamma": np.round(np.arange(0.30, 1.2001, 0.05), 3),
    },
    STARTS,
)
INSIDE = grid(
    "region over gap and speed",
    "vibro-impact",
    {
        "delta": np.round(np.arange(-0.010, 0.0101, 0.0025), 4),
        "v": (0.5, 1.0, 1.5, 2.0),
        "beta": np.round(np.arange(0.25, 0.6001, 0.05), 3),
        "gamma": np.round(np.arange(0.60, 0.8001, 0.025), 4),
    },
    STARTS,
)


def single(ds):
    """Where a lane is a stable single impact."""
    return ds.regime == SINGLE


def clean(ds):
    """Where it is one with one swing of the striker a cycle."""
    return single(ds) & (ds.striker_turns < 1.05)


def strong(ds):
    """Where it is a clean one with an impact velocity over the drive's."""
    return clean(ds) & (ds.impact_velocity > ds.v)


def _at_home(ds):
    """The map at the source's gap and speed, from its own start."""
    return ds.sel(delta=-0.005, v=1.5, start="drive")


def _share(of, where: str, **box):
    """Judge the share of lanes in a box of beta and gamma at the source's gap and speed."""

    def judge(ds) -> Here:
        here = _at_home(ds).sel(**{name: slice(low - 1e-6, high + 1e-6) for name, (low, high) in box.items()})
        share = float(of(here).mean())
        bad = here.where(~of(here)).stack(point=("beta", "gamma")).dropna("point", subset=["regime"])
        note = f"{bad.sizes['point']} of {of(here).size} points are not" if bad.sizes["point"] else ""
        verdict = AGREES if share == 1 else IN_TREND if share >= 0.8 else DIFFERS
        return Here(f"{share:.3f} of {where}", verdict, note)

    return judge


def _wider(ds) -> Here:
    here = _at_home(ds)
    box = (here.beta >= 0.249) & (here.beta <= 0.601) & (here.gamma >= 0.599) & (here.gamma <= 0.801)
    outside = strong(here) & ~box
    share = float(outside.sum() / (~box).sum())
    text = (
        f"{share:.3f} of the points outside (beta 0.1 to 1.2, gamma 0.3 to 1.2) are clean and strong single impacts too"
    )
    return Here(text, AGREES if share < 0.05 else IN_TREND if share < 0.2 else DIFFERS, _extent(strong(here)))


def _extent(good) -> str:
    """Where along gamma the good points lie, at some mass ratios."""
    parts = []
    for beta in (0.1, 0.25, 0.4, 0.6, 0.8):
        gammas = good.gamma.values[good.sel(beta=beta, method="nearest").values]
        parts.append(f"beta {beta}: {gammas.min():g} to {gammas.max():g}" if gammas.size else f"beta {beta}: none")
    return "along gamma, " + "; ".join(parts)


def coexisting(ds):
    """Where one start ends in a single impact, and another in something else or in a weaker one."""
    good = single(ds)
    weakest, best = ds.impact_velocity.fillna(0).min("start"), ds.impact_velocity.where(good).max("start")
    return good.any("start") & (~good.all("start") | (weakest < 0.9 * best))


def _coexist(ds) -> Here:
    box = ds.sel(beta=slice(0.249, 0.601), gamma=slice(0.599, 0.801))
    by_gap = coexisting(box).mean(("v", "beta", "gamma"))
    text = f"{float(coexisting(box).mean()):.3f} of the region has a second, worse motion, over gaps and speeds"
    gaps = ", ".join(
        f"{1e3 * gap:g} mm {float(share):.2f}" for gap, share in zip(ds.delta.values, by_gap.values, strict=True)
    )
    verdict = AGREES if not by_gap.any() else IN_TREND if float(by_gap.sel(delta=-0.005)) < 0.05 else DIFFERS
    return Here(text, verdict, f"by gap: {gaps}")


def _any_speed(ds) -> Here:
    shares = [float(single(ds.sel(delta=-0.005, v=v, start="drive")).mean()) for v in ds.v.values]
    text = f"{min(shares):.3f} at least, of v {', '.join(f'{v:g}' for v in ds.v.values)} m/s: "
    verdict = AGREES if min(shares) == 1 else IN_TREND if min(shares) > 0.8 else DIFFERS
    return Here(text + ", ".join(f"{share:.3f}" for share in shares), verdict)


_SHARE = "agreement where it is all of it, in trend from 0.8 on"
_USUAL = ("R2", "R3", "R4", "R5")
GROUP = Group(
    name="region",
    title="The source's region, tested",
    text="The source recommends beta from 0.25 to 0.6 and gamma from 0.6 to 0.8. Here it is tested over a wide map, "
    "over gaps from -10 to 10 mm, speeds from 0.5 to 2 m/s, and three starts. A single impact is clean where the "
    "striker swings once a cycle, and strong where it hits faster than the drive moves.",
    entries=(
        Entry(
            "sec-5.7a",
            "stable single impact in beta 0.25 to 0.6, gamma 0.6 to 0.8, v 1.5",
            "all of it, 1",
            (INSIDE,),
            _share(single, "the region is a single impact", beta=(0.25, 0.6), gamma=(0.6, 0.8)),
            _SHARE,
            _USUAL,
        ),
        Entry(
            "sec-5.7b",
            "clean single impact there",
            "all of it, 1",
            (INSIDE,),
            _share(clean, "the region is clean", beta=(0.25, 0.6), gamma=(0.6, 0.8)),
            _SHARE,
            (*_USUAL, "R21"),
        ),
        Entry(
            "sec-5.7c",
            "strong blows there",
            "all of it, 1",
            (INSIDE,),
            _share(strong, "the region is clean and strong", beta=(0.25, 0.6), gamma=(0.6, 0.8)),
            _SHARE,
            (*_USUAL, "R21"),
        ),
        Entry(
            "sec-7",
            "single impact in beta 0.25 to 0.4, gamma 0.7 to 0.8, v 1.5",
            "all of it, 1",
            (INSIDE,),
            _share(strong, "the region is a clean and strong single impact", beta=(0.25, 0.4), gamma=(0.7, 0.8)),
            _SHARE,
            (*_USUAL, "R21"),
        ),
        Entry(
            "sec-5.7d",
            "outside of the region",
            "the best performance is inside, 0 outside",
            (WIDE,),
            _wider,
            "agreement under 0.05, in trend under 0.2",
            (*_USUAL, "R21"),
        ),
        Entry(
            "sec-5.7e",
            "the region at other driving velocities, gap -5 mm",
            "a moderate effect, 1",
            (INSIDE,),
            _any_speed,
            _SHARE,
            _USUAL,
        ),
        Entry(
            "sec-4.2",
            "does a motion depend on how it is started, in the region",
            "always one limit cycle, 0",
            (INSIDE,),
            _coexist,
            "agreement where no point has a second, worse motion, in trend under 0.05 at the source's gap",
            (*_USUAL, "R6", "R13"),
        ),
    ),
    pictures=(
        Picture(
            "Section 5.7",
            "Where a single impact is reached from every start, from some, from none, and where it is clean and "
            "strong, at v 1.5 m/s. The rectangle is the source's region.",
            (WIDE,),
            pictures.wide,
        ),
        Picture(
            "Section 5.7",
            "Share of the source's region with a single impact from each start, with a clean and strong one, and with "
            "a second, worse motion, over the gap.",
            (INSIDE,),
            pictures.over_gap,
        ),
    ),
)
