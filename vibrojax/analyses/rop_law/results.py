"""What every fit says of itself: variables with units, where it comes from, and the verdict on the forms in words."""

from collections.abc import Hashable, Mapping, Sequence
from datetime import UTC, datetime

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int, Shaped

from vibrojax.analyses.rop_law.forms import LOGARITHMIC
from vibrojax.analyses.rop_law.uncertainty import REASONS
from vibrojax.errors import Place
from vibrojax.io.attributes import title_of
from vibrojax.io.provenance import source
from vibrojax.io.variables import Variable

CLEARLY = 2.0
"""Difference of AIC from which a form is said to be beaten (Burnham and Anderson's rule of thumb)."""

_GROUPS_SHOWN = 5


def reason(long_name: str) -> Variable:
    """The variable that says why others are not numbers, by flags that mean `REASONS`."""
    return Variable("1", long_name, np.int8, REASONS)


def with_attributes(
    variables: Mapping[str, Variable], values: Mapping[str, object], dims: Mapping[str, Sequence[Hashable]]
) -> dict[str, xr.Variable]:
    """The dataset's `variables`, with `values` of their dtype; those without `dims` are numbers."""
    return {
        name: xr.Variable(dims.get(name, ()), np.asarray(values[name], variable.dtype), variable.attributes())
        for name, variable in variables.items()
    }


def law_title(place: Place, data: xr.Dataset) -> str:
    """The title of a fit of the rate-of-penetration law."""
    return f"rate-of-penetration law: {title_of(data, place.file)}"


def provenance(
    place: Place, data: xr.Dataset, what: str, title: str, more: Mapping[str, str | float]
) -> dict[str, str | float]:
    """The attributes of a fit: where it comes from, and what of its data still holds."""
    still_true = {name: data.attrs[name] for name in ("scene", "sweep", "parameters", "columns") if name in data.attrs}
    now = f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ} {what} {place.file}"
    earlier = [str(data.attrs["history"])] if "history" in data.attrs else []
    return {
        "title": title,
        "source": source(),
        "history": "\n".join([now, *earlier]),
        "Conventions": "CF-1.11",
        **still_true,
        **more,
    }


def table(fit: xr.Dataset, name: str) -> tuple[list[str], Shaped[np.ndarray, "groups forms"]]:
    """What the groups are called, and a variable's values.

    **Arguments:** `fit`: from `fit_rop`; `name`: of the variable.
    """
    dims = [dim for dim in fit[name].dims if dim != "form"]
    values = fit[name].transpose(*dims, "form").values.reshape(-1, fit.sizes["form"])
    shape = [fit.sizes[dim] for dim in dims]
    return [_group_name(fit, dims, index) for index in np.ndindex(*shape)], values


def verdict(fit: xr.Dataset) -> list[str]:
    """Lines that say which form describes the data, by AIC, and where the log law holds and where it does not.

    A form holds in a group where its AIC is no more than `CLEARLY` above the lowest; the log law where one of its three
    readings does.

    **Arguments:** `fit`: from `fit_rop`.
    """
    names = [str(name) for name in fit["form"].values]
    groups, aic = table(fit, "aic")
    judged = np.isfinite(aic).all(axis=1)
    lines = _not_judged(fit, judged)
    if not judged.any():
        return [*lines, "no form can be told from the lanes that are there"]
    r_squared = table(fit, "r_squared")[1]
    finite = np.where(judged[:, None], aic, 0.0)
    best = np.argmin(finite, axis=1)
    behind = np.where(judged[:, None], aic - finite.min(axis=1, keepdims=True), np.inf)
    rows = [(int((best[judged] == i).sum()), int((behind[:, i] <= CLEARLY).sum()), i) for i in range(len(names))]
    lines.append(f"along {fit.attrs['along']}, over {judged.sum()} of {judged.size}:")
    for lowest, holds, i in sorted(rows, reverse=True):
        share = _range(r_squared[judged, i])
        lines.append(f"  {names[i]:<8} lowest AIC in {lowest}, within {CLEARLY:g} of it in {holds}; R2 {share}")
    return lines + _log_law(fit, groups, behind, best, names)


def _group_name(fit: xr.Dataset, dims: Sequence[Hashable], index: tuple[int, ...]) -> str:
    parts = []
    for dim, position in zip(dims, index, strict=True):
        columns = [name for name in fit.coords if fit[name].dims == (dim,)]
        if not columns:
            parts.append(f"{dim}={position}")
        parts += [f"{name}={_value(fit[name], position)}" for name in columns]
    return ", ".join(parts) or "all lanes"


def _value(coordinate: xr.DataArray, position: int) -> str:
    value, unit = coordinate.values[position].item(), coordinate.attrs.get("units", "1")
    return (f"{value:.6g}" if isinstance(value, float) else str(value)) + ("" if unit == "1" else f" {unit}")


def _not_judged(fit: xr.Dataset, judged: Bool[np.ndarray, " groups"]) -> list[str]:
    """Why groups have no AIC for some form: the first reason of each."""
    if judged.all():
        return []
    reasons = table(fit, "reason")[1][~judged]
    meanings = dict(enumerate(str(fit["reason"].attrs["flag_meanings"]).split()))
    missing = ~np.isfinite(table(fit, "aic")[1][~judged])
    first = [meanings[int(row[np.argmax(lacks)])] for row, lacks in zip(reasons, missing, strict=True)]
    counted = ", ".join(f"{name} {first.count(name)}" for name in sorted(set(first)))
    return [f"not every form can be told in {len(first)} of {judged.size}: {counted}"]


def _range(values: Float[np.ndarray, " groups"]) -> str:
    values = values[np.isfinite(values)]
    if not len(values):
        return "is not defined, since no rate varies"
    low, middle, high = np.min(values), np.median(values), np.max(values)
    return f"{low:.4g}" if len(values) == 1 else f"{low:.4g} to {high:.4g} (median {middle:.4g})"


def _log_law(
    fit: xr.Dataset,
    groups: list[str],
    behind: Float[np.ndarray, "groups forms"],
    best: Int[np.ndarray, " groups"],
    names: list[str],
) -> list[str]:
    """Where the best of the three readings of the log law holds, and where it is beaten, by how much and by what."""
    log = behind[:, [names.index(name) for name in LOGARITHMIC]].min(axis=1)
    judged, holds = np.isfinite(log), log <= CLEARLY
    beaten = judged & ~holds
    lines = [f"the log law holds in {holds.sum()} of {judged.sum()}{_where(fit, holds) if beaten.any() else ''}"]
    if not beaten.any():
        return lines
    lines.append(f"it is beaten in {beaten.sum()}, by an AIC of {_range(log[beaten])}:")
    worst = np.argsort(-np.where(beaten, log, 0.0), kind="stable")[: min(_GROUPS_SHOWN, beaten.sum())]
    lines += [f"  {groups[i]}: {names[best[i]]} by {log[i]:.3g}" for i in worst]
    return lines + ([f"  and {beaten.sum() - len(worst)} more"] if beaten.sum() > len(worst) else [])


def _where(fit: xr.Dataset, holds: Bool[np.ndarray, " groups"]) -> str:
    """The box of the groups' axes in which `holds`."""
    if not holds.any():
        return ""
    dims = [dim for dim in fit["aic"].dims if dim != "form"]
    ranges = []
    for dim, positions in zip(dims, np.nonzero(holds.reshape([fit.sizes[dim] for dim in dims])), strict=True):
        if dim in fit.coords:
            low, high = (_value(fit[dim], int(position)) for position in (positions.min(), positions.max()))
            ranges.append(f"{dim} {low}" + (f" to {high}" if high != low else ""))
    return f", all of them within {', '.join(ranges)}" if ranges else ""
