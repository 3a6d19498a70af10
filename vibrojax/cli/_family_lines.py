"""What a dataset of families holds, in words and as values: points, branches, special points, where it is stable."""

from collections import Counter
from typing import TYPE_CHECKING, Any

from vibrojax.errors import printable

if TYPE_CHECKING:
    import xarray

    from vibrojax.io.branches import Interval

_VALUES_SHOWN, _FAMILIES_SHOWN = 4, 12


def family_lines(dataset: "xarray.Dataset") -> list[str]:
    """How many points and branches there are, the special points by kind, and where the first branch of each family is
    stable; no lines for what holds no families."""
    from vibrojax.io.branches import along_name, branches, is_families, kind_names, stable_intervals

    if not is_families(dataset):
        return []
    along, every, names = along_name(dataset), list(branches(dataset)), kind_names(dataset)
    values = dataset["special_value"].values
    families = list(dict.fromkeys(one.family for one in every))
    count = f"{_count(len(families), 'family')}, " if "family" in dataset.dims else ""
    low, high = dataset.attrs["span"]
    lines = [
        f"{count}{_count(dataset.sizes['point'], 'point')} on {_count(len(every), 'branch')} over {along} "
        f"{low:g} to {high:g}, {_count(len(names), 'special point')}"
    ]
    first = {k for one in every if one.number == 0 for k in one.special.tolist()}
    for kind, number in sorted(Counter(names).items(), key=lambda item: _order(dataset).index(item[0])):
        on_first = [f"{values[k]:.8g}" for k in sorted(first, key=lambda k: float(values[k])) if names[k] == kind]
        lines.append(f"{kind:<16}{number:>4}  {_where(on_first, along, len(families))}".rstrip())
    lines.append(
        "stable on branch 0:" if len(families) > 1 else _stable(dataset, every[0], along) if every else "no point"
    )
    if len(families) > 1:
        begun = [one for one in every if one.number == 0]
        for one in begun[:_FAMILIES_SHOWN]:
            of_family = "; ".join(_interval(stretch) for stretch in stable_intervals(dataset, one)) or "nowhere"
            lines.append(f"  {_name(dataset, one.family)}: {of_family}")
        if len(begun) > _FAMILIES_SHOWN:
            lines.append(f"  and {len(begun) - _FAMILIES_SHOWN} more")
    return lines + _without(dataset, families)


def family_facts(dataset: "xarray.Dataset") -> dict[str, Any]:
    """The same with stable keys: `along`, `span`, `families`, `branches`, `points`, `kinds` (their numbers), `special`
    (each: `kind`, `value`, `family`, `branch`, `note`) and `stable` (each: `family`, `branch`, `from`, `to` and what is
    at these ends); empty for what holds no families."""
    from vibrojax.io.branches import along_name, branches, is_families, kind_names, numbers_of, stable_intervals

    if not is_families(dataset):
        return {}
    every, names, family = list(branches(dataset)), kind_names(dataset), numbers_of(dataset, "special")
    special = [
        {
            "kind": name,
            "value": dataset["special_value"].values[k],
            "family": family[k],
            "branch": dataset["special_branch"].values[k],
            "note": printable(dataset["special_note"].values[k], 300),
        }
        for k, name in enumerate(names)
    ]
    stable = [
        {
            "family": one.family,
            "branch": one.number,
            "from": stretch.low,
            "to": stretch.high,
            "from_kind": stretch.low_kind,
            "to_kind": stretch.high_kind,
        }
        for one in every
        for stretch in stable_intervals(dataset, one)
    ]
    return {
        "along": along_name(dataset),
        "span": list(dataset.attrs["span"]),
        "families": len({one.family for one in every}),
        "branches": len(every),
        "points": dataset.sizes["point"],
        "kinds": dict(Counter(names)),
        "special": special,
        "stable": stable,
    }


def _order(dataset: "xarray.Dataset") -> list[str]:
    return str(dataset["special_kind"].attrs["flag_meanings"]).split()


def _where(values: list[str], along: str, families: int) -> str:
    """Where special points of one kind lie on the first branches."""
    if not values:
        return ""
    if families > 1:
        first = f"on the branches 0 at {along} {values[0]}"
        return f"{first} to {values[-1]}" if len(values) > 1 else first
    more = f" and {len(values) - _VALUES_SHOWN} more up to {values[-1]}" if len(values) > _VALUES_SHOWN else ""
    return f"on branch 0 at {along} {', '.join(values[:_VALUES_SHOWN])}{more}"


def _stable(dataset: "xarray.Dataset", branch: Any, along: str) -> str:
    from vibrojax.io.branches import stable_intervals

    stretches = stable_intervals(dataset, branch)
    if not stretches:
        return "branch 0 is stable nowhere"
    return f"branch 0 is stable for {along} {'; '.join(_interval(one) for one in stretches)}"


def _interval(stretch: "Interval") -> str:
    ends = ((stretch.low, stretch.low_kind), (stretch.high, stretch.high_kind))
    return " to ".join(f"{value:.8g}{f' ({kind})' if kind else ''}" for value, kind in ends)


def _name(dataset: "xarray.Dataset", family: int) -> str:
    """A family by what tells it from others."""
    along = [str(name) for name, one in dataset.coords.items() if one.dims == ("family",) and name != "family"]
    parts = [f"{name} {_number(dataset[name].sel(family=family).item())}" for name in along]
    return ", ".join(parts) or f"family {family}"


def _number(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _without(dataset: "xarray.Dataset", families: list[int]) -> list[str]:
    """The families that have no orbit to begin with."""
    if "family" not in dataset.dims:
        return []
    missing = [_name(dataset, one) for one in dataset["family"].values.tolist() if one not in families]
    more = f" and {len(missing) - _VALUES_SHOWN} more" if len(missing) > _VALUES_SHOWN else ""
    return [f"no orbit to begin with: {'; '.join(missing[:_VALUES_SHOWN])}{more}"] if missing else []


def _count(number: int, what: str) -> str:
    plural = {"family": "families", "branch": "branches"}.get(what, f"{what}s")
    return f"{number} {what if number == 1 else plural}"
