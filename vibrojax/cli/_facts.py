"""What a dataset holds, as values with stable keys: what `info --json` prints."""

from typing import TYPE_CHECKING, Any

from vibrojax.cli._family_lines import family_facts
from vibrojax.cli._json import flags, numbers
from vibrojax.errors import printable

if TYPE_CHECKING:
    import xarray

_LONGEST_ABOUT = 300
"""Characters of a variable's unit or meaning that are shown."""

_TEXTS = ("title", "scene", "friction", "pulse_shape", "source", "jax", "along")
_VALUES = ("parameters", "differing", "run", "solver", "columns", "certified", "lanes", "wall_time_s")


def facts(dataset: "xarray.Dataset", file: str) -> dict[str, Any]:
    """The facts by key; what a dataset of the kind lacks is null, or empty.

    `file`, `title`, `scene`, `friction`, `pulse_shape`, `source`, `jax`, `along`, `history` (lines, the newest first);
    `dimensions` and `variables` by name; `parameters`, `differing`, `run`, `solver`, `columns`, `certified` as the
    attributes have them; `lanes`; `regimes`: lanes by regime; `orbits`: lanes by `reason` and by `stable`; `natures`:
    lanes by nature; `families`: what `follow --json` prints of them; `attractors`: their mean `shares` over the grid by
    number, and the lanes `unassigned`; `failures`: lanes by reason; `accuracy`; `found`: of one motion; `wall_time_s`.
    """
    from vibrojax.io.attributes import attribute_of, history_of, text_of

    texts = {name: text_of(dataset, name) if name in dataset.attrs else None for name in _TEXTS}
    no_lanes = bool({"time", "attractor"} & set(dataset.dims))  # one motion, or attractors
    return {
        "file": file,
        **texts,
        "history": history_of(dataset),
        "dimensions": {str(name): _dimension(dataset, name) for name in dataset.sizes},
        **{name: attribute_of(dataset, name) for name in _VALUES},
        "regimes": {} if no_lanes else _counted(dataset, "regime"),
        "orbits": {} if no_lanes else _orbits(dataset),
        "natures": {} if no_lanes else _counted(dataset, "nature"),
        "families": family_facts(dataset),
        "attractors": _attractors(dataset),
        "failures": _failures(dataset),
        "accuracy": _accuracy(dataset),
        "found": found(dataset) if "time" in dataset.dims else {},
        "variables": {str(name): _about(variable) for name, variable in dataset.data_vars.items()},
    }


def found(dataset: "xarray.Dataset") -> dict[str, Any]:
    """The single values of a motion: what was found along it."""
    return numbers(dataset, [str(name) for name, one in dataset.data_vars.items() if one.ndim == 0])


def _about(variable: "xarray.DataArray") -> dict[str, Any]:
    return {"dims": list(variable.dims), "units": _short(variable, "units"), "long_name": _short(variable, "long_name")}


def _short(variable: "xarray.DataArray", name: str) -> str | None:
    """Return a text attribute of a variable, shortened; None if it is not there."""
    return printable(variable.attrs[name], _LONGEST_ABOUT) if name in variable.attrs else None


def _dimension(dataset: "xarray.Dataset", name: Any) -> dict[str, Any]:
    """Its size, its unit, and its values where they are few, else the first and the last."""
    size = dataset.sizes[name]
    if name not in dataset.coords or not size:
        return {"size": size}
    values = dataset[name].values
    ends = {"first": values[0], "last": values[-1]}
    if values.dtype.kind not in "fiu":
        ends = {end: printable(value, _LONGEST_ABOUT) for end, value in ends.items()}
    return {"size": size, "units": _short(dataset[name], "units"), **ends}


def _counted(dataset: "xarray.Dataset", name: str) -> dict[str, int]:
    """How many lanes have each flag of a variable; those that none has are left out."""
    if name not in dataset:
        return {}
    values = dataset[name].values
    counts = {meaning: int((values == flag).sum()) for flag, meaning in flags(dataset[name]).items()}
    return {meaning: count for meaning, count in counts.items() if count}


def _orbits(dataset: "xarray.Dataset") -> dict[str, dict[str, int]]:
    """Lanes by what became of their orbits, and by their stability."""
    names = {"reason": "orbit_reason", "stable": "stable"} if "orbit_reason" in dataset else {}
    return {key: _counted(dataset, name) for key, name in names.items()}


def _attractors(dataset: "xarray.Dataset") -> dict[str, Any]:
    """The share of each attractor over the grid, in the order of their numbers, and lanes without one."""
    if "lane_attractor" not in dataset:
        return {}
    grid = [name for name in dataset["share"].dims if name != "attractor"]
    return {"shares": dataset["share"].mean(grid).values, "unassigned": int(dataset["unassigned"].sum())}


def _failures(dataset: "xarray.Dataset") -> dict[str, int]:
    reasons = _counted(dataset, "reason") if "status" in dataset else {}  # a fit's reasons are no failures
    return {name: count for name, count in reasons.items() if name != "none"}


def _accuracy(dataset: "xarray.Dataset") -> dict[str, Any] | None:
    """Median and largest error estimate; how many lanes have one, and how many are within the accepted error."""
    import numpy as np

    from vibrojax.io.attributes import run_of

    if "error_estimate" not in dataset:
        return None
    errors = dataset["error_estimate"].values
    errors = errors[~np.isnan(errors)]
    accepted = run_of(dataset).get("error")
    return {
        "accepted": accepted,
        "estimated": int(errors.size),
        "within": None if accepted is None else int((errors <= accepted).sum()),
        "median": float(np.median(errors)) if errors.size else None,
        "largest": float(errors.max()) if errors.size else None,
    }
