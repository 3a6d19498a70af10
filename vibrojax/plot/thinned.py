"""Less of a dataset than it holds, where it holds more than a picture shows and memory takes."""

from math import prod

import xarray as xr

from vibrojax.plot.contents import lane_dims

MOST_LANES = 300_000
"""Lanes that a picture is drawn of at most."""


def thinned(ds: xr.Dataset) -> xr.Dataset:
    """Every so many-th value of the longest axes of `ds`, in memory, where it has too many lanes; else `ds`."""
    steps = _steps(ds)
    if not steps:
        return ds
    found = ds.isel({name: slice(None, None, step) for name, step in steps.items()})
    for variable in found.variables.values():  # one after the other: what is read of one is all of it
        variable.load()
    return found


def thinned_text(ds: xr.Dataset) -> str:
    """What of `ds` is drawn, in words; nothing where all of it is."""
    parts = [f"every {_nth(step)} value of {name}" for name, step in _steps(ds).items()]
    return f"drawn is {' and '.join(parts)}" if parts else ""


def _steps(ds: xr.Dataset) -> dict[str, int]:
    """Of which dimensions only every so many-th value is drawn."""
    sizes = {name: ds.sizes[name] for name in lane_dims(ds)}
    steps = dict.fromkeys(sizes, 1)

    def left() -> dict[str, int]:
        return {name: -(-size // steps[name]) for name, size in sizes.items()}

    while prod(left().values()) > MOST_LANES:
        longest = max(sizes, key=left().__getitem__)
        steps[longest] += 1
    return {name: step for name, step in steps.items() if step > 1}


def _nth(number: int) -> str:
    return {2: "second", 3: "third"}.get(number, f"{number}th")
