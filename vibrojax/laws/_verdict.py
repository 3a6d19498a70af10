"""Which form describes the data, in words."""

import numpy as np
import xarray as xr

from vibrojax.laws._forms import LOGARITHMIC

CLEARLY = 2.0
"""Difference of AIC from which a form is said to be beaten (Burnham and Anderson's rule of thumb)."""

_GROUPS_SHOWN = 5


def verdict(fit: xr.Dataset) -> list[str]:
    """Lines that tell which form describes the data, by AIC, and where the log law holds and where it does not.

    A form holds in a group where its AIC is no more than `CLEARLY` above the lowest; the log law where one of its three
    readings does.

    **Arguments:** `fit`: from `fit_rop`.
    """
    names = [str(name) for name in fit["form"].values]
    groups, aic = table(fit, "aic")
    told = np.isfinite(aic).all(axis=1)
    lines = _untold(fit, told)
    if not told.any():
        return [*lines, "no form can be told from the lanes that are there"]
    r_squared = table(fit, "r_squared")[1]
    best = np.argmin(np.where(told[:, None], aic, 0.0), axis=1)
    behind = np.where(told[:, None], aic - np.where(told[:, None], aic, 0.0).min(axis=1, keepdims=True), np.inf)
    rows = [(int((best[told] == i).sum()), int((behind[:, i] <= CLEARLY).sum()), i) for i in range(len(names))]
    lines.append(f"along {fit.attrs['along']}, over {told.sum()} of {told.size}:")
    for lowest, holds, i in sorted(rows, reverse=True):
        share = _range(r_squared[told, i])
        lines.append(f"  {names[i]:<8} lowest AIC in {lowest}, within {CLEARLY:g} of it in {holds}; R2 {share}")
    return lines + _log_law(fit, groups, behind, best, names)


def table(fit: xr.Dataset, name: str) -> tuple[list[str], np.ndarray]:
    """What the groups are called, and a variable's values (groups, forms)."""
    dims = [dim for dim in fit[name].dims if dim != "form"]
    values = fit[name].transpose(*dims, "form").values.reshape(-1, fit.sizes["form"])
    shape = [fit.sizes[dim] for dim in dims]
    return [_called(fit, dims, index) for index in np.ndindex(*shape)], values


def _called(fit: xr.Dataset, dims: list, index: tuple[int, ...]) -> str:
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


def _untold(fit: xr.Dataset, told: np.ndarray) -> list[str]:
    """Why groups have no AIC for some form: the first reason of each."""
    if told.all():
        return []
    reasons = table(fit, "reason")[1][~told]
    meanings = dict(enumerate(str(fit["reason"].attrs["flag_meanings"]).split()))
    missing = ~np.isfinite(table(fit, "aic")[1][~told])
    first = [meanings[int(row[np.argmax(lacks)])] for row, lacks in zip(reasons, missing, strict=True)]
    counted = ", ".join(f"{name} {first.count(name)}" for name in sorted(set(first)))
    return [f"not every form can be told in {len(first)} of {told.size}: {counted}"]


def _range(values: np.ndarray) -> str:
    low, middle, high = np.min(values), np.median(values), np.max(values)
    return f"{low:.4g}" if len(values) == 1 else f"{low:.4g} to {high:.4g} (median {middle:.4g})"


def _log_law(fit: xr.Dataset, groups: list[str], behind: np.ndarray, best: np.ndarray, names: list[str]) -> list[str]:
    """Where the best of the three readings of the log law holds, and where it is beaten, by how much and by what."""
    log = behind[:, [names.index(name) for name in LOGARITHMIC]].min(axis=1)
    told, holds = np.isfinite(log), log <= CLEARLY
    beaten = told & ~holds
    lines = [f"the log law holds in {holds.sum()} of {told.sum()}{_where(fit, holds) if beaten.any() else ''}"]
    if not beaten.any():
        return lines
    lines.append(f"it is beaten in {beaten.sum()}, by an AIC of {_range(log[beaten])}:")
    worst = np.argsort(-np.where(beaten, log, 0.0), kind="stable")[: min(_GROUPS_SHOWN, beaten.sum())]
    lines += [f"  {groups[i]}: {names[best[i]]} by {log[i]:.3g}" for i in worst]
    return lines + ([f"  and {beaten.sum() - len(worst)} more"] if beaten.sum() > len(worst) else [])


def _where(fit: xr.Dataset, holds: np.ndarray) -> str:
    """The box of the groups' axes in which `holds`."""
    if not holds.any():
        return ""
    dims = [dim for dim in fit["aic"].dims if dim != "form"]
    found = []
    for dim, positions in zip(dims, np.nonzero(holds.reshape([fit.sizes[dim] for dim in dims])), strict=True):
        if dim in fit.coords:
            low, high = (_value(fit[dim], position) for position in (positions.min(), positions.max()))
            found.append(f"{dim} {low}" + (f" to {high}" if high != low else ""))
    return f", all of them within {', '.join(found)}" if found else ""
