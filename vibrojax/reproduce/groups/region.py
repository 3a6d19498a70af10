"""The source's region of best performance, tested over beta, gamma, v, the gap and the start (chapter 5, section 7)."""

import numpy as np

from vibrojax.reproduce._entry import AGREES, DIFFERS, IN_TREND, VERDICTS, Entry, Here, claim
from vibrojax.reproduce._group import Group, Picture
from vibrojax.reproduce._needs import ALL_STARTS, grid
from vibrojax.reproduce._region import clean, coexisting, single, strong
from vibrojax.reproduce.pictures import region as pictures

WIDE = grid(
    "region over beta and gamma",
    "vibro-impact",
    {
        "delta": (-0.005, 0.005),
        "v": (0.5, 1.5),
        "beta": np.round(np.arange(0.10, 1.2001, 0.05), 3),
        "gamma": np.round(np.arange(0.30, 1.2001, 0.05), 3),
    },
    ALL_STARTS,
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
    ALL_STARTS,
)


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
        return Here(f"{share:.3f} of {where}", _verdict(of(here)), note)

    return judge


STEP = 0.05 + 1e-6
"""Half the source's step of 0.1: it cannot know the borders of its region any better, and calls them critical."""
BOX = {"beta": (0.25, 0.6), "gamma": (0.6, 0.8)}


def _verdict(good) -> str:
    """Agreement where all of the region is good; in trend where four fifths are, and all that is over a step inside."""
    inner = {name: slice(low + STEP, high - STEP) for name, (low, high) in BOX.items()}
    core, share = good.sel(**inner), float(good.mean())
    return AGREES if share == 1 else IN_TREND if share >= 0.8 and bool(core.all()) else DIFFERS


def _wider(ds) -> Here:
    here = _at_home(ds)
    near = _within(here, BOX, STEP)
    share = float(strong(here).where(~near).mean())
    text = f"{share:.3f} of the points over 0.05 outside are clean and strong single impacts too"
    note = f"beta 0.1 to 1.2, gamma 0.3 to 1.2; {_extent(strong(here))}"
    return Here(text, AGREES if share == 0 else IN_TREND if share < 0.05 else DIFFERS, note)


def _within(ds, box: dict, margin: float):
    """Which points lie in a box of beta and gamma, or within `margin` of it."""
    sides = [(ds[name] >= low - margin) & (ds[name] <= high + margin) for name, (low, high) in box.items()]
    return sides[0] & sides[1]


def _extent(good) -> str:
    """Where along gamma the good points lie, at some mass ratios."""
    parts = []
    for beta in (0.1, 0.25, 0.4, 0.6, 0.8):
        gammas = good.gamma.values[good.sel(beta=beta, method="nearest").values]
        parts.append(f"beta {beta}: {gammas.min():g} to {gammas.max():g}" if gammas.size else f"beta {beta}: none")
    return "along gamma, " + "; ".join(parts)


def _coexist(ds) -> Here:
    box = ds.sel(beta=slice(0.249, 0.601), gamma=slice(0.599, 0.801))
    by_gap = coexisting(box).mean(("v", "beta", "gamma"))
    text = f"{float(coexisting(box).mean()):.3f} of the region has a second, worse motion, over gaps and speeds"
    gaps = ", ".join(
        f"{1e3 * gap:g} mm {float(share):.2f}" for gap, share in zip(ds.delta.values, by_gap.values, strict=True)
    )
    return claim(text, not by_gap.any(), f"by gap: {gaps}")


def _any_speed(ds) -> Here:
    good = single(ds.sel(delta=-0.005, start="drive"))
    shares = [float(good.sel(v=v).mean()) for v in ds.v.values]
    text = f"{min(shares):.3f} at least, of v {', '.join(f'{v:g}' for v in ds.v.values)} m/s: "
    verdicts = {_verdict(good.sel(v=v)) for v in ds.v.values}
    verdict = next(one for one in VERDICTS if one in verdicts)  # the worst
    return Here(text + ", ".join(f"{share:.3f}" for share in shares), verdict)


_SHARE = "all of it; in trend from 0.8 on, if all that fails is within 0.05 of the border: half the source's step"
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
            "sec-7a",
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
            "none; in trend under 0.05. The border is known to half the source's step",
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
            "sec-5.4.2",
            "does a motion depend on how it is started, in the region",
            "always one limit cycle, 0",
            (INSIDE,),
            _coexist,
            "no point has a second, worse motion: the source says always",
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
