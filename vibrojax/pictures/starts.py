"""Many initial conditions: drawn over initial states if they form a grid or a line, else as fractions of regimes."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from jaxtyping import Bool, Int

from vibrojax.pictures import axes, colours, contents
from vibrojax.pictures.colours import Value
from vibrojax.pictures.contents import HIDDEN, POINT, REGIME, START, lane_dims, swept
from vibrojax.pictures.layout import LEGEND_WIDTH
from vibrojax.pictures.lines import regime_lines
from vibrojax.pictures.maps import map_sheet, point_layers, regime_dots
from vibrojax.pictures.plots import Plot, Sheet

PREFIX = "start_"  # name prefix of a coordinate that holds an initial state
SHARE = "share_"  # name prefix of a variable that holds the fraction of a regime
_MOST_SHARES = 5  # number of fractions drawn as maps if there is a single facet
_SAME_STATE = 1e-9  # fraction of a state's range within which two initial values count as equal
SYMBOLS = {"x1": "x₁", "v1": "x₁′", "x2": "x₂", "v2": "x₂′", "x3": "x₃", "v3": "x₃′", "x4": "x₄"}

Steps = Int[np.ndarray, " starts"]


def start_states(ds: xr.Dataset) -> tuple[str, ...]:
    """Return the names of the coordinates that hold initial states."""
    along = [str(name) for name, data in ds.coords.items() if data.dims == (START,)]
    return tuple(name for name in along if name.startswith(PREFIX) and ds[name].dtype.kind == "f")


def varied_states(ds: xr.Dataset) -> tuple[str, ...]:
    """Return the initial states that differ between the initial conditions specified as vectors."""
    return tuple(name for name in start_states(ds) if np.unique(_steps(ds[name])).size > 1)


def on_axes(ds: xr.Dataset) -> xr.Dataset:
    """Return the dataset with initial states as axes in place of `start`, if the initial conditions form a full grid.

    For initial conditions on a line, the axis is the first state that varies. Named initial conditions, and variables
    that compare initial conditions, are dropped. The dataset is returned unchanged if they form neither grid nor line.
    """
    vectors = ds.isel({START: _is_vector(ds)})
    states = list(varied_states(vectors))
    if not states:
        return ds
    steps = np.stack([_steps(vectors[name]) for name in states])
    is_grid = np.prod([len(np.unique(row)) for row in steps]) == vectors.sizes[START] == len(np.unique(steps.T, axis=0))
    if not is_grid and not _is_line(vectors, states):
        return ds
    axes = states if is_grid else states[:1]
    unique = [np.unique(row, return_index=True, return_inverse=True)[1:] for row in steps]
    near = {name: vectors[name].values[first][inverse] for name, (first, inverse) in zip(states, unique, strict=True)}
    fixed = {name: ((), vectors[name].values[0], _about(ds[name])) for name in start_states(ds) if name not in states}
    bare = vectors.drop_vars([START, HIDDEN, *start_states(ds)], errors="ignore")
    spread = bare.assign_coords({name: (START, near[name]) for name in axes}).sortby(axes)
    spread = spread.swap_dims({START: axes[0]}) if len(axes) == 1 else spread.set_index(start=axes).unstack(START)
    return spread.assign_coords({name: spread[name].assign_attrs(_about(ds[name])) for name in axes} | fixed)


def described(ds: xr.Dataset) -> xr.Dataset:
    """Return the dataset with axis-label attributes for the initial states."""
    return ds.assign_coords({name: ds[name].assign_attrs(_about(ds[name])) for name in start_states(ds)})


def left_out_text(ds: xr.Dataset) -> str:
    """Return the note on named initial conditions, which are not shown, with regimes if nothing else varies."""
    others = ~_is_vector(ds)
    names = [axes.short(str(name)) for name in ds[START].values[others]]
    if not names or not start_states(ds):
        return ""
    if ds[REGIME].dims == (START,):
        meanings = colours.regime_names(ds[REGIME])
        flags = ds[REGIME].values[others].tolist()
        names = [f"{name} ({meanings[flag]})" for name, flag in zip(names, flags, strict=True)]
    return f"Not shown: the start{'s' * (len(names) > 1)} {', '.join(names)}"


def regime_shares(ds: xr.Dataset) -> xr.Dataset:
    """Return the most frequent regime over `start`, and the fraction [%] of each regime that occurs.

    Fractions are named `share_single-impact` and so on: single impact first, then by decreasing fraction of all lanes.
    """
    regimes, names = ds[REGIME], colours.regime_names(ds[REGIME])
    shares = {flag: 100.0 * (regimes == flag).mean(START) for flag in names}
    flags = sorted(names, key=lambda flag: (flag != colours.SINGLE, -float(shares[flag].mean())))
    occurring = [flag for flag in flags if bool((shares[flag] > 0).any())] or flags[:1]
    stacked = xr.concat([shares[flag] for flag in occurring], "flag")
    most = xr.DataArray(np.array(occurring, np.int8), dims="flag")[stacked.argmax("flag")]
    variables = {REGIME: most.assign_attrs(regimes.attrs)}
    variables |= {f"{SHARE}{names[flag]}": shares[flag].assign_attrs(units="%") for flag in occurring}
    coordinates = {name: data for name, data in ds.coords.items() if START not in data.dims}
    return xr.Dataset(variables, coordinates, ds.attrs)


def medians(ds: xr.Dataset, names: Sequence[str]) -> xr.Dataset:
    """Return the medians of variables over the initial conditions, and the most frequent regime."""
    return regime_shares(ds)[[REGIME]].assign({name: ds[name].median(START, keep_attrs=True) for name in names})


def medians_text(ds: xr.Dataset) -> str:
    """Return the note on medians over many initial conditions."""
    return f"Of {ds.sizes[START]} starts the median, and the regime that most end in"


def _is_vector(ds: xr.Dataset) -> Bool[np.ndarray, " starts"]:
    """Return which initial conditions are vectors, rather than names."""
    finite = [np.isfinite(ds[name].values) for name in start_states(ds)]
    return np.all(finite, axis=0) if finite else np.zeros(ds.sizes[START], bool)


def _is_line(ds: xr.Dataset, states: Sequence[str]) -> bool:
    """Return whether the initial conditions are distinct points on a straight line in the `states`."""
    if np.unique(_steps(ds[states[0]])).size < ds.sizes[START]:
        return False
    first, *others = (_relative(ds[name].values) for name in states)
    return all(min(np.abs(x - first).max(), np.abs(1.0 - x - first).max()) < _SAME_STATE for x in others)


def _relative(values: np.ndarray) -> np.ndarray:
    return (values - values.min()) / (np.ptp(values) or 1.0)


def _steps(data: xr.DataArray) -> Steps:
    """Quantise the finite initial values of a state to integers, so that nearly equal values become equal."""
    values = data.values[np.isfinite(data.values)]
    return np.round(_relative(values) / _SAME_STATE).astype(np.int64) if values.size else np.zeros(0, np.int64)


def _about(data: xr.DataArray) -> dict[str, str]:
    name = str(data.name).removeprefix(PREFIX)
    symbol = f"{SYMBOLS.get(name, name)}(0)"
    return {"units": str(data.attrs.get("units", "1")), "long_name": "start", "symbol": symbol}


# Pictures.


def many_starts(ds: xr.Dataset, values: Sequence[Value] | None = None) -> Sheet:
    """Draw the regimes that many initial conditions lead to.

    Initial states on a grid become maps over these states, and initial states on a line become curves. Other initial
    conditions are scattered over the phase planes of bit and striker. If parameters vary over more values than there
    can be panels, the fraction of initial conditions in each regime is drawn, or the median of `values`. If specified,
    `values` replace the regimes and the quantities next to them.
    """
    ds = colours.regimes_in(ds)
    if POINT in lane_dims(ds):
        names = list(contents.varied(ds))
        return _over_two(ds, names[0], names[1], values) if len(names) == 2 else regime_dots(ds)
    parameters, spread = swept(ds), on_axes(ds)
    shown = values or [colours.regime_value(ds[REGIME]), *colours.values_beside(ds)]
    quantities = [value for value in shown if not value.counted]
    states = [name for name in swept(spread) if name.startswith(PREFIX)]
    long = [name for name in parameters if ds.sizes[name] >= contents.ENOUGH]
    note = left_out_text(ds)
    if len(states) >= 2 and not long:
        return map_sheet(spread, states[0], states[1], shown, note)
    if len(states) == 1 and len(long) == 1:
        return map_sheet(spread, long[0], states[0], shown, note)
    if len(states) == 1 and not long:
        return regime_lines(spread, states[0], note, quantities)
    if not parameters:
        return _phase_planes(described(ds), shown) if varied_states(ds) else regime_dots(ds)
    if len(parameters) == 1 or len(long) == 1:
        return regime_lines(ds, values=quantities)
    return _over_two(ds, *contents.axes_of_map(ds), values)


def _over_two(ds: xr.Dataset, x: str, y: str, values: Sequence[Value] | None) -> Sheet:
    """Draw the medians of `values` over two parameters, or the shares of the first regimes; a note lists the others."""
    if values is not None:
        names = [value.name for value in values if not value.counted]
        return map_sheet(medians(ds, names), x, y, values, medians_text(ds))
    most = 1 if set(swept(ds)) - {x, y} else _MOST_SHARES
    shares = regime_shares(ds)
    names = [str(name).removeprefix(SHARE) for name in shares.data_vars if str(name).startswith(SHARE)]
    shown = [colours.share_value(shares[SHARE + name], name) for name in names[:most]]
    note = f"Without a map of its share: {', '.join(names[most:])}" if names[most:] else ""
    about = f"The regime that most of {ds.sizes[START]} starts end in, and the share of them that ends in each"
    return map_sheet(shares, x, y, [colours.regime_value(shares[REGIME]), *shown], about, note)


def _phase_planes(ds: xr.Dataset, shown: Sequence[Value]) -> Sheet:
    """Draw the values `shown` over pairs of states, for initial conditions that form no grid."""
    names = varied_states(ds)
    pairs = list(zip(names[::2], names[1::2], strict=False)) or [(names[0], names[0])]
    pairs += [(names[0], names[-1])] if len(names) > 1 and len(names) % 2 else []
    shuffled = ds.isel({START: np.random.default_rng(0).permutation(ds.sizes[START])})  # so none is always in front
    plots = [
        Plot(
            point_layers(shuffled, value, x, y),
            axes.axis(ds[x], group=f"x{row}", intervals=6),
            axes.axis(ds[y], group=f"y{row}"),
            place=(row, column),
            scale=None if value.counted else value,
        )
        for row, (x, y) in enumerate(pairs[:3])
        for column, value in enumerate(shown)
    ]
    size = 3.4 * len(shown) + LEGEND_WIDTH, 3.0 * len(pairs[:3]) + 1.2
    about = axes.margins(ds, axes.certified_text(ds), f"{ds.sizes[START]} starts", left_out_text(ds))
    keys = colours.cell_keys([ds], [value for value in shown if value.counted])
    return Sheet(plots, size, keys=[keys], **about)
