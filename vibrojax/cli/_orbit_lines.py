"""What became of the periodic orbits of a sweep's lanes, in words."""

from typing import TYPE_CHECKING

from vibrojax.cli._json import flags

if TYPE_CHECKING:
    import xarray


def orbit_lines(dataset: "xarray.Dataset") -> list[str]:
    """How many orbits were found, how many of them are stable, and why others were not; no lines without orbits."""
    if "orbit_reason" not in dataset:
        return []
    reason, stable = dataset["orbit_reason"].values, dataset["stable"].values
    counts = {meaning: int((reason == flag).sum()) for flag, meaning in flags(dataset["orbit_reason"]).items()}
    asked = sum(count for meaning, count in counts.items() if meaning not in ("not-repeating", "refused"))
    which = f"{(stable == 1).sum()} stable, {(stable == 0).sum()} unstable"
    found = f"{counts['found']} found of {asked} lanes that repeat: {which}"
    others = [f"{count} {meaning}" for meaning, count in counts.items() if count and meaning != "found"]
    cycles, own = dataset["orbit_cycles"], dataset.get("cycles")
    sooner = int(((cycles > 0) & (cycles < own)).sum()) if own is not None else 0
    if sooner:
        others.append(f"{sooner} lanes are on their way to an orbit that repeats sooner than they do")
    return [found, *others, *_limit(dataset), *_nearby(dataset)]


def _limit(dataset: "xarray.Dataset") -> list[str]:
    """The margin below which there are no multipliers."""
    from vibrojax.io.attributes import table_of

    limit = table_of(dataset, "orbits").get("grazing_limit")
    return [] if limit is None else [f"multipliers are given from a grazing_margin of {limit:g} on"]


def _nearby(dataset: "xarray.Dataset") -> list[str]:
    """Of the lanes that have not settled, how many have a stable orbit nearby."""
    if "nearby_cycles" not in dataset or "regime" not in dataset:
        return []
    unsettled = [flag for flag, meaning in flags(dataset["regime"]).items() if meaning in ("irregular", "undecided")]
    asked = dataset["regime"].isin(unsettled).values
    near = int((asked & (dataset["nearby_cycles"].values > 0)).sum())
    return [
        f"of {asked.sum()} lanes labelled irregular or undecided, {near} have a stable orbit nearby that they have not "
        "reached (nearby_cycles); a longer settle leads most of those there"
    ]
