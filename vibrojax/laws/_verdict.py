"""Which form describes the data, in words."""

import numpy as np
import xarray as xr

from vibrojax.laws._forms import LOGARITHMIC

CLEARLY = 2.0
"""Difference of AIC from which a form is said to be beaten (Burnham and Anderson's rule of thumb)."""

_GROUPS_SHOWN = 5


def verdict(fit: xr.Dataset) -> list[str]:
    """Lines that tell which form describes the data, by AIC, and where a log law is beaten and by what.

    **Arguments:** `fit`: from `fit_rop`.
    """
    names = [str(name) for name in fit["form"].values]
    groups, aic = table(fit, "aic")
    told = np.isfinite(aic).all(axis=1)
    lines = _untold(fit, told)
    if not told.any():
        return [*lines, "no form can be told from the lanes that are there"]
    best = np.argmin(np.where(told[:, None], aic, 0.0), axis=1)
    counts = sorted(((int((best[told] == i).sum()), name) for i, name in enumerate(names)), key=lambda c: -c[0])
    for count, name in counts:
        if count:
            margins = _margins(aic[told & (best == names.index(name))], names.index(name))
            lines.append(f"{name} has the lowest AIC in {count} of {told.sum()}, the next is {_range(margins)} higher")
    return lines + _log_law(groups, aic, told, best, names)


def table(fit: xr.Dataset, name: str) -> tuple[list[str], np.ndarray]:
    """What the groups are called, and a variable's values (groups, forms)."""
    dims = [dim for dim in fit[name].dims if dim != "form"]
    values = fit[name].transpose(*dims, "form").values.reshape(-1, fit.sizes["form"])
    shape = [fit.sizes[dim] for dim in dims]
    return [_called(fit, dims, index) for index in np.ndindex(*shape)], values


def _called(fit: xr.Dataset, dims: list, index: tuple[int, ...]) -> str:
    parts = []
    for dim, position in zip(dims, index, strict=True):
        value = fit[dim].values[position].item() if dim in fit.coords else position
        unit = fit[dim].attrs.get("units", "1") if dim in fit.coords else "1"
        number = f"{value:.6g}" if isinstance(value, float) else str(value)
        parts.append(f"{dim}={number}" + ("" if unit == "1" else f" {unit}"))
    return ", ".join(parts) or "all lanes"


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


def _margins(aic: np.ndarray, best: int) -> np.ndarray:
    """How much higher the next form's AIC is in each group."""
    return np.delete(aic, best, axis=1).min(axis=1) - aic[:, best]


def _range(values: np.ndarray) -> str:
    low, middle, high = np.min(values), np.median(values), np.max(values)
    return f"{low:.3g}" if len(values) == 1 else f"{low:.3g} to {high:.3g} (median {middle:.3g})"


def _log_law(groups: list[str], aic: np.ndarray, told: np.ndarray, best: np.ndarray, names: list[str]) -> list[str]:
    """Where the best of the three readings of the log law is beaten, and by what."""
    log = aic[:, [names.index(name) for name in LOGARITHMIC]].min(axis=1)
    behind = np.where(told, log - np.where(told[:, None], aic, 0.0).min(axis=1), 0.0)
    beaten = told & (behind > CLEARLY)
    if not beaten.any():
        return ["the log law is not beaten"]
    worst = np.argsort(-behind, kind="stable")[: min(_GROUPS_SHOWN, beaten.sum())]
    lines = [f"the log law is beaten in {beaten.sum()} of {told.sum()}, by {_range(behind[beaten])}:"]
    lines += [f"  {groups[i]}: {names[best[i]]} by {behind[i]:.3g}" for i in worst]
    return lines + ([f"  and {beaten.sum() - len(worst)} more"] if beaten.sum() > len(worst) else [])
