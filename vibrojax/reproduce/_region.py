"""Which lanes of a map the source would call good: its region of best performance is judged and drawn by these."""

SINGLE = 3


def single(ds):
    """Where a lane is a stable single impact."""
    return ds.regime == SINGLE


def clean(ds):
    """Where it is one with one swing of the striker a cycle."""
    return single(ds) & (ds.striker_turns < 1.05)


def strong(ds):
    """Where it is a clean one with an impact velocity over the drive's."""
    return clean(ds) & (ds.impact_velocity > ds.v)


def coexisting(ds):
    """Where one start ends in a single impact, and another in something else or in a weaker one."""
    good = single(ds)
    weakest, best = ds.impact_velocity.fillna(0).min("start"), ds.impact_velocity.where(good).max("start")
    return good.any("start") & (~good.all("start") | (weakest < 0.9 * best))
