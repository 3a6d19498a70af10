"""The analysis `push`: the smallest push in each state variable after which a machine leaves its working cycle."""

from dataclasses import replace

import numpy as np
import xarray as xr

from vibrojax.pictures.axes import axis, margins, number, scale, values_along, with_unit
from vibrojax.pictures.colours import REGIME_COLOURS, regime_cells, regime_names
from vibrojax.pictures.contents import POINT, varied
from vibrojax.pictures.plots import Axis, Bars, Layer, Line, Look, Plot, Sheet, Text, dots, key, level, patch
from vibrojax.pictures.starts import SYMBOLS

_PUSH = "push_"
_SIDES = {-1: ("#0072B2", "v", "negative push"), 1: ("#D55E00", "^", "positive push")}
_RETURNS: Look = {"edge": "#B3B3B3", "hatch": "//"}  # every push tried returns
_BOUND: Look = {"colour": "#808080", "dash": "--", "width": 0.9}
_EDGE = "#595959"


def smallest_pushes(ds: xr.Dataset) -> Sheet:
    """Draw the smallest push in each state variable, with a panel for each variable.

    Several machines are drawn as curves over their parameter, one curve for each sign of the push. One machine is drawn
    as a bar for each sign.
    """
    if POINT in ds.dims and ds.sizes[POINT] == 1:
        ds = ds.isel({POINT: 0})
    states = [str(name).removeprefix(_PUSH) for name in ds.data_vars if str(name).startswith(_PUSH)]
    rows, several = -(-len(states) // 2), POINT in ds.dims
    plots = [(_curves if several else _sides)(ds, state) for state in states]
    plots = [replace(plot, place=divmod(k, 2)) for k, plot in enumerate(plots)]
    known = [ds[f"bound_{state}"] > 0 for state in states]
    returning = any(bool((ds[f"{_PUSH}{s}"].isnull() & k).any()) for s, k in zip(states, known, strict=True))
    leaving = any(bool(ds[f"{_PUSH}{state}"].notnull().any()) for state in states)
    keys: list[Layer] = [key(side, colour=c, marker=m, width=1.0) for c, m, side in _SIDES.values() if several]
    if not several:
        ends: dict[int, str] = {}
        for state in states:
            names = regime_names(ds[f"regime_{state}"])
            flags_here = regime_cells(ds[f"regime_{state}"]).astype(int).tolist()
            ends |= {flag: names[flag] for flag in flags_here if flag > 0}
        keys += [patch(REGIME_COLOURS[flag], ends[flag]) for flag in sorted(ends)]
    if returning:
        hollow = dots(label="every push tried returns", colour="#4D4D4D", face="none")
        keys.append(hollow if several else patch("#FFFFFF", hollow.label, **_RETURNS))
    keys.append(key("greatest push tried", **_BOUND))
    none_leaves = "No push up to the greatest tried leaves the working cycle"
    about = margins(ds, none_leaves if returning and not (leaving or several) else "")
    return Sheet(plots, (8.6, 2.3 * rows + 0.6), (1.0, 1.0), (1.0,) * rows, [keys], **about)


def _curves(ds: xr.Dataset, state: str) -> Plot:
    """Draw the smallest pushes of several machines over their parameter."""
    (factor, unit), push = scale(ds[f"bound_{state}"]), ds[f"{_PUSH}{state}"]
    bound = ds[f"bound_{state}"].values * factor
    over = next(iter(varied(ds)), POINT)
    x = values_along(ds[over]) if over in ds.coords else np.arange(ds.sizes[POINT], dtype=float)
    order = np.argsort(x, kind="stable")
    layers: list[Layer] = []
    for sign, (colour, marker, _) in _SIDES.items():
        y = push.sel(sign=sign).values * factor
        stays = np.isnan(y) & (bound > 0)
        layers.append(Line(x[order], y[order], colour, 1.0, marker=marker))
        layers.append(dots(x[stays], bound[stays], colour=colour, marker=marker, size=5.0 + sign, face="none"))
    layers.append(Line(x[order], bound[order], **_BOUND))
    top = 1.12 * float(np.nanmax([bound, *(push.transpose("sign", ...).values * factor)]))
    across = axis(ds[over], group="over") if over in ds.coords else Axis("machine", group="over")
    return Plot(layers, across, Axis(_words(state, unit), limits=(-0.03 * top, top or 1.0)))


def _sides(ds: xr.Dataset, state: str) -> Plot:
    """Draw the smallest push of one machine as a bar for each sign, in the colour of the regime that follows."""
    (factor, unit), push = scale(ds[f"bound_{state}"]), ds[f"{_PUSH}{state}"]
    bound = float(ds[f"bound_{state}"].values * factor)
    stable = bound > 0
    layers: list[Layer] = [level(bound, **_BOUND)] if stable else []
    for side, (size, flag) in enumerate(zip(push.values * factor, regime_cells(ds[f"regime_{state}"]), strict=True)):
        leaves = bool(np.isfinite(size))
        height = float(size) if leaves else bound if stable else 0.0
        look: Look = (
            {"colours": REGIME_COLOURS[int(flag)], "edge": _EDGE} if leaves else {"colours": "#FFFFFF"} | _RETURNS
        )
        layers.append(Bars([side - 0.3], [0.0], [0.6], [height], **look))
        text = number(float(f"{size:.3g}")) if leaves else "returns" if stable else "no stable\ncycle"
        layers.append(
            Text(
                float(side),
                height if leaves else height / 2,
                text,
                baseline="bottom",
                box=True,
                offset=(0.0, 3.0 * leaves),
            )
        )
    ticks = [(float(k), _SIDES[int(sign)][2]) for k, sign in enumerate(ds["sign"].values)]
    top = 1.13 * float(np.nanmax([bound, *(push.values * factor)]))
    up = Axis(_words(state, unit), limits=(0.0, top or 1.0), ticks=None if stable else [])
    return Plot(layers, Axis(ticks=ticks, limits=(-0.6, len(push) - 0.4), group="over"), up, grid="")


def _words(state: str, unit: str) -> str:
    return with_unit(f"push in {SYMBOLS.get(state, state)}", unit)
