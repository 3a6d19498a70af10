"""The analysis `family`: picture and summary of branches of periodic orbits along a parameter."""

from collections import Counter
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.analyses.analysis import Analysis, PictureRule, SummaryPart
from vibrojax.analyses.continuation.picture import families
from vibrojax.errors import printable
from vibrojax.io.branches import Branch, along_name, branches, kind_names, numbers_of, stable_intervals

_VALUES_SHOWN, _FAMILIES_SHOWN = 4, 12


class Families(Analysis):
    """Continue a family of stable and unstable periodic orbits along one parameter, with its special points."""

    kind = "family"
    view = "families"
    pictures = (PictureRule("families", lambda held: True, families),)

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        """Return the numbers of points and branches, the special points, and the stable intervals."""
        return [SummaryPart("families", family_lines(ds), {"families": family_facts(ds)})]


def family_lines(ds: xr.Dataset) -> list[str]:
    """Return the summary as lines of text.

    The lines contain the numbers of points and branches, the special points by kind, and the stable intervals of
    branch 0.
    """
    along, every, kinds = along_name(ds), list(branches(ds)), kind_names(ds)
    values = ds["special_value"].values
    numbers = list(dict.fromkeys(branch.family for branch in every))
    low, high = ds.attrs["span"]
    count = f"{_count(len(numbers), 'family', 'families')}, " if "family" in ds.dims else ""
    lines = [
        f"{count}{_count(ds.sizes['point'], 'point')} on {_count(len(every), 'branch', 'branches')} over {along} "
        f"{low:g} to {high:g}, {_count(len(kinds), 'special point')}"
    ]
    first = {k for branch in every if branch.number == 0 for k in branch.special.tolist()}
    order = str(ds["special_kind"].attrs["flag_meanings"]).split()
    for kind, number in sorted(Counter(kinds).items(), key=lambda item: order.index(item[0])):
        on_first = np.sort([float(values[k]) for k in first if kinds[k] == kind])
        lines.append(f"{kind:<16}{number:>4}  {_places(on_first, along, len(numbers))}".rstrip())
    if len(numbers) == 1:
        intervals = _intervals(ds, every[0])
        lines.append(f"branch 0 is stable for {along} {intervals}" if intervals else "branch 0 is stable nowhere")
        return lines + _missing(ds, numbers)
    if not numbers:
        return [*lines, "no point", *_missing(ds, numbers)]
    lines.append("stable on branch 0:")
    begun = [branch for branch in every if branch.number == 0]
    lines += [f"  {_name(ds, b.family)}: {_intervals(ds, b) or 'nowhere'}" for b in begun[:_FAMILIES_SHOWN]]
    if len(begun) > _FAMILIES_SHOWN:
        lines.append(f"  and {len(begun) - _FAMILIES_SHOWN} more")
    return lines + _missing(ds, numbers)


def family_facts(ds: xr.Dataset) -> dict[str, Any]:
    """Return the summary as a dictionary, whose keys are a stable interface.

    - `along`, `span`: the parameter and its bounds; `families`, `branches`, `points`: numbers of these.
    - `kinds`: number of special points of each kind; `special`: `kind`, `value`, `family`, `branch` and `note` of each.
    - `stable`: `family`, `branch`, `from` and `to` of each stable interval. `from_kind` and `to_kind` are the kinds of
      special points at its ends.
    """
    every, kinds, family = list(branches(ds)), kind_names(ds), numbers_of(ds, "special")
    return {
        "along": along_name(ds),
        "span": list(ds.attrs["span"]),
        "families": len({branch.family for branch in every}),
        "branches": len(every),
        "points": ds.sizes["point"],
        "kinds": dict(Counter(kinds)),
        "special": [
            {
                "kind": kind,
                "value": ds["special_value"].values[k],
                "family": family[k],
                "branch": ds["special_branch"].values[k],
                "note": printable(ds["special_note"].values[k], 300),
            }
            for k, kind in enumerate(kinds)
        ],
        "stable": [
            {
                "family": branch.family,
                "branch": branch.number,
                "from": interval.low,
                "to": interval.high,
                "from_kind": interval.low_kind,
                "to_kind": interval.high_kind,
            }
            for branch in every
            for interval in stable_intervals(ds, branch)
        ],
    }


def _places(values: np.ndarray, along: str, families_count: int) -> str:
    """Return a phrase with the parameter values of special points of one kind on the first branches."""
    texts = [f"{value:.8g}" for value in values]
    if not texts:
        return ""
    if families_count > 1:
        return f"on the branches 0 at {along} {texts[0]}" + (f" to {texts[-1]}" if len(texts) > 1 else "")
    more = f" and {len(texts) - _VALUES_SHOWN} more up to {texts[-1]}" if len(texts) > _VALUES_SHOWN else ""
    return f"on branch 0 at {along} {', '.join(texts[:_VALUES_SHOWN])}{more}"


def _intervals(ds: xr.Dataset, branch: Branch) -> str:
    """Return a string of the stable intervals of a branch, with the kinds of special points at their ends."""
    texts = []
    for interval in stable_intervals(ds, branch):
        ends = ((interval.low, interval.low_kind), (interval.high, interval.high_kind))
        texts.append(" to ".join(f"{value:.8g}{f' ({kind})' if kind else ''}" for value, kind in ends))
    return "; ".join(texts)


def _name(ds: xr.Dataset, family: int) -> str:
    """Return a label of a family: its values of the parameters in which families differ."""
    names = [str(name) for name, data in ds.coords.items() if data.dims == ("family",) and name != "family"]
    values = ((name, ds[name].sel(family=family).item()) for name in names)
    parts = [f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}" for name, value in values]
    return ", ".join(parts) or f"family {family}"


def _missing(ds: xr.Dataset, families_begun: list[int]) -> list[str]:
    """Return a line that lists the families without an initial orbit, or no line if there are none."""
    if "family" not in ds.dims:
        return []
    missing = [_name(ds, family) for family in ds["family"].values.tolist() if family not in families_begun]
    more = f" and {len(missing) - _VALUES_SHOWN} more" if len(missing) > _VALUES_SHOWN else ""
    return [f"no orbit to begin with: {'; '.join(missing[:_VALUES_SHOWN])}{more}"] if missing else []


def _count(number: int, singular: str, plural: str = "") -> str:
    return f"{number} {singular if number == 1 else plural or singular + 's'}"
