"""Starts by the hundred: the axes that they lie on where they are a grid of states or a line, else their shares."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from vibrojax.measures.labels import REGIMES
from vibrojax.plot.axes import short
from vibrojax.plot.colours import regime_names
from vibrojax.plot.contents import HIDDEN, REGIME, START

PREFIX = "start_"
"""How the coordinate of a state at the start begins."""

SHARE = "share_"
"""How the name of the share of a regime begins."""

_SAME = 1e-9  # of a state's range, within which two starts have one value of it
SYMBOLS = {"x1": "x₁", "v1": "x₁′", "x2": "x₂", "v2": "x₂′", "x3": "x₃", "v3": "x₃′", "x4": "x₄"}

Steps = Int[np.ndarray, " starts"]


def start_states(ds: xr.Dataset) -> tuple[str, ...]:
    """The coordinates of the states at the start."""
    along = [str(name) for name, data in ds.coords.items() if data.dims == (START,)]
    return tuple(name for name in along if name.startswith(PREFIX) and ds[name].dtype.kind == "f")


def on_axes(ds: xr.Dataset) -> xr.Dataset:
    """`ds` with the states at the start as axes in place of `start`, where the starts are a full grid of them.

    A line in several states has one axis, the first of them. Starts with names are left out. What compares starts with
    each other is dropped. `ds` itself where the starts are no grid.
    """
    vectors = ds.isel({START: _vectors(ds)})
    varied = varied_states(vectors)
    axes = varied if _is_grid(vectors, varied) else varied[:1] if _is_line(vectors, varied) else ()
    if not axes:
        return ds
    steps = [np.unique(_steps(vectors[name]), return_inverse=True, return_index=True) for name in axes]
    shape = tuple(len(first) for _, first, _ in steps)
    order = np.argsort(np.ravel_multi_index([inverse.ravel() for *_, inverse in steps], shape))
    sorted_ = vectors.isel({START: order}).drop_vars([START, HIDDEN, *start_states(ds)], errors="ignore")
    found = {name: _reshaped(data, axes, shape) for name, data in sorted_.data_vars.items()}
    along = {
        name: (name, vectors[name].values[first], _about(ds[name]))
        for name, (_, first, _) in zip(axes, steps, strict=True)
    }
    fixed = {name: ((), vectors[name].values[0], _about(ds[name])) for name in start_states(ds) if name not in varied}
    return xr.Dataset(found, {**sorted_.coords, **along, **fixed}, ds.attrs)


def varied_states(ds: xr.Dataset) -> tuple[str, ...]:
    """The states at the start that are not the same for all starts that are vectors."""
    return tuple(name for name in start_states(ds) if np.unique(_steps(ds[name])).size > 1)


def described(ds: xr.Dataset) -> xr.Dataset:
    """`ds` with the states at the start described as on an axis."""
    return ds.assign_coords({name: ds[name].assign_attrs(_about(ds[name])) for name in start_states(ds)})


def left_out_text(ds: xr.Dataset) -> str:
    """Where the starts that are no vectors end, in words, if nothing but the start varies; else their names."""
    names = [short(str(ds[START].values[at])) for at in np.flatnonzero(~_vectors(ds))]
    if not names or not start_states(ds):
        return ""
    if ds[REGIME].dims == (START,):
        meanings = regime_names(ds[REGIME])
        ends = ds[REGIME].values[~_vectors(ds)].tolist()
        names = [f"{name} ({meanings[end]})" for name, end in zip(names, ends, strict=True)]
    return f"Not shown: the start{'s' * (len(names) > 1)} {', '.join(names)}"


def together(ds: xr.Dataset) -> xr.Dataset:
    """The regime that most starts end in, and the share [%] of each that occurs, `share_single-impact` and so on.

    The single impact comes first, the others by how much of all lanes they take.
    """
    regimes, names = ds[REGIME], regime_names(ds[REGIME])
    shares = {flag: 100.0 * (regimes == flag).mean(START) for flag in names}
    single = REGIMES.index("single-impact")
    flags = sorted(names, key=lambda flag: (flag != single, -float(shares[flag].mean())))
    occurring = [flag for flag in flags if bool((shares[flag] > 0).any())] or flags[:1]
    stacked = xr.concat([shares[flag] for flag in occurring], "flag")
    most = xr.DataArray(np.array(occurring, np.int8), dims="flag")[stacked.argmax("flag")]
    found = {REGIME: most.assign_attrs(regimes.attrs)}
    found |= {f"{SHARE}{names[flag]}": shares[flag].assign_attrs(units="%") for flag in occurring}
    coordinates = {name: data for name, data in ds.coords.items() if START not in data.dims}
    return xr.Dataset(found, coordinates, ds.attrs)


def medians(ds: xr.Dataset, names: Sequence[str]) -> xr.Dataset:
    """The median over the starts of each of the variables `names`, and the regime that most of them end in."""
    most = together(ds)
    found = {name: ds[name].median(START, keep_attrs=True) for name in names}
    return most[[REGIME]].assign(found)


def medians_text(ds: xr.Dataset) -> str:
    """What stands for many starts where medians are drawn, in words."""
    return f"Of {ds.sizes[START]} starts the median, and the regime that most end in"


def _vectors(ds: xr.Dataset) -> np.ndarray:
    """Which starts are vectors."""
    known = [np.isfinite(ds[name].values) for name in start_states(ds)]
    return np.all(known, axis=0) if known else np.zeros(ds.sizes[START], bool)


def _is_grid(ds: xr.Dataset, varied: tuple[str, ...]) -> bool:
    """Whether there is one start for each combination of the values of the states that vary."""
    steps = [_steps(ds[name]) for name in varied]
    if not steps:
        return False
    combinations = int(np.prod([np.unique(one).size for one in steps]))
    return combinations == ds.sizes[START] == np.unique(np.stack(steps), axis=1).shape[1]


def _is_line(ds: xr.Dataset, varied: tuple[str, ...]) -> bool:
    """Whether the starts lie on a straight line in the states, each at another place of it."""
    if not varied or np.unique(_steps(ds[varied[0]])).size < ds.sizes[START]:
        return False
    first, *others = (_along_range(ds[name].values) for name in varied)
    apart = (min(np.abs(one - first).max(), np.abs(1.0 - one - first).max()) for one in others)
    return all(distance < _SAME for distance in apart)


def _along_range(values: Float[np.ndarray, " starts"]) -> Float[np.ndarray, " starts"]:
    return (values - values.min()) / (np.ptp(values) or 1.0)


def _steps(data: xr.DataArray) -> Steps:
    """The values of a state at the starts that are vectors, as whole numbers: equal ones as equal numbers."""
    values = data.values[np.isfinite(data.values)]
    return np.round(_along_range(values) / _SAME).astype(np.int64) if values.size else np.zeros(0, np.int64)


def _reshaped(data: xr.DataArray, axes: tuple[str, ...], shape: tuple[int, ...]) -> xr.Variable:
    """`data` with the axes of `shape` in the place of `start`."""
    at = data.dims.index(START) if START in data.dims else None
    if at is None:
        return data.variable
    dims = (*data.dims[:at], *axes, *data.dims[at + 1 :])
    values = data.values.reshape(*data.shape[:at], *shape, *data.shape[at + 1 :])
    return xr.Variable(dims, values, data.attrs)


def _about(data: xr.DataArray) -> dict[str, str]:
    """Attributes with which a state at the start reads well on an axis."""
    name = str(data.name).removeprefix(PREFIX)
    return {
        "units": str(data.attrs.get("units", "1")),
        "long_name": "start",
        "symbol": f"{SYMBOLS.get(name, name)}(0)",
    }
