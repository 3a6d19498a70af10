"""Test the pictures of sweeps with many starts and of sweeps of any shape, and that they fit on a page."""

import json

import numpy as np
import pytest
import xarray as xr
from matplotlib.collections import PathCollection, QuadMesh
from read_off import axis_labels, legend, meshes, note, titles
from test_plot import COORDINATES, flagged, returns

import vibrojax as vj
from vibrojax.pictures.choose import picture
from vibrojax.pictures.sheet import PAGE

UNITS = {"x1": "m", "v1": "m s-1", "x2": "m", "v2": "m s-1"}


def basin(states, grid=None, named=(), keep=0):
    """Return a sweep from state vectors and then from named starts, with single impacts where x2 > 0 and gamma < 0.8.

    `states` holds the vectors by state name, each (vectors,). The velocity of single impacts grows with beta.
    """
    grid = {name: np.asarray(axis, float) for name, axis in (grid or {}).items()}
    count = len(next(iter(states.values())))
    rows = {name: np.concatenate([states.get(name, np.zeros(count)), np.full(len(named), np.nan)]) for name in UNITS}
    names = [*(json.dumps([float(rows[name][indices]) for name in UNITS]) for indices in range(count)), *named]
    mesh = np.meshgrid(*grid.values(), np.arange(len(names)), indexing="ij")
    indices = dict(zip([*grid, "start"], mesh, strict=True))
    single = (rows["x2"][indices["start"]] > 0) & (indices.get("gamma", 0.7) < 0.8)
    dims = (*grid, "start")
    variables = {
        "regime": flagged(dims, np.where(single, 3, 6)),
        "impact_velocity": (dims, np.where(single, 2.0 + indices.get("beta", 0.4), 0.3), {"units": "m s-1"}),
        "period": (dims, np.where(single, 0.23, 0.21), {"units": "s"}),
        "hidden_motion": (dims, np.ones(single.shape, np.int8)),
    }
    along = {f"start_{name}": ("start", values, {"units": UNITS[name]}) for name, values in rows.items()}
    ds = xr.Dataset(variables, {**grid, "start": names, **along}, {"title": "many starts"})
    for name in set(grid) & set(COORDINATES):
        long_name, symbol, units = COORDINATES[name]
        ds[name].attrs = {"long_name": long_name, "symbol": symbol, "units": units}
    if keep:
        ds["return_impact_velocity"] = ds["impact_velocity"].expand_dims(return_index=keep, axis=-1)
    return ds


def plane(x=12, v=10):
    x2, v2 = np.meshgrid(np.linspace(-0.05, 0.05, x), np.linspace(-3.0, 3.0, v), indexing="ij")
    return {"x2": x2.ravel(), "v2": v2.ravel(), "v1": np.full(x * v, -1.5)}


def line(count=40):
    return {"x2": np.linspace(-0.05, 0.05, count)}


def sample(count=100):
    draw = np.random.default_rng(1)
    return {name: draw.uniform(-1.0, 1.0, count) * (0.05 if name[0] == "x" else 3.0) for name in UNITS}


LONG = {"beta": np.linspace(0.25, 0.6, 8), "gamma": np.linspace(0.6, 0.9, 7)}


# Starts on a grid or a line of states.


@pytest.mark.parametrize("order", [None, 5])
def test_plane_of_starts_is_drawn_as_map_over_states(order):
    ds = basin(plane())
    shuffled = ds if order is None else ds.isel(start=np.random.default_rng(order).permutation(ds.sizes["start"]))
    figure = picture(shuffled)
    assert {"start, x₂(0) [mm]", "start, x₂′(0) [m/s]", "impact velocity [m/s]"} <= axis_labels(figure)
    regimes, velocity = meshes(figure)[0], meshes(figure, "viridis")[0]
    x2 = np.unique(ds["start_x2"])
    assert np.array_equal(regimes.get_array(), np.broadcast_to(np.where(x2 > 0, 3, 6), (10, 12)))
    assert np.allclose(velocity.get_array(), np.broadcast_to(np.where(x2 > 0, 2.4, 0.3), (10, 12)))
    assert np.allclose(regimes.get_coordinates()[0, [0, -1], 0], 1e3 * np.array([-0.05, 0.05]) * 12 / 11)
    assert "x₁′(0) = −1.5 m/s" in note(figure)
    assert not figure.axes[0].collections[1:]  # no marks for starts whose neighbours end elsewhere


def test_plane_of_starts_has_panel_for_each_parameter_value():
    figure = picture(basin(plane(), {"gamma": [0.5, 0.7, 0.9]}))
    assert titles(figure) == ["γ = 0.5", "γ = 0.7", "γ = 0.9"]
    assert [int((mesh.get_array() == 3).sum()) for mesh in meshes(figure)] == [60, 60, 0]


def test_line_of_starts_is_drawn_as_curve_or_as_map_with_one_axis():
    ds = basin(line())
    figure = picture(ds)
    velocity = figure.axes[0].lines[0]
    assert np.allclose(velocity.get_xydata(), np.column_stack([1e3 * ds["start_x2"], ds["impact_velocity"]]))
    assert "start, x₂(0) [mm]" in axis_labels(figure)
    over = picture(basin(line(), {"gamma": LONG["gamma"]}))
    assert {"frequency ratio w2/w1, γ", "start, x₂(0) [mm]"} <= axis_labels(over)
    assert meshes(over)[0].get_array().shape == (40, 7)


def test_line_in_two_states_uses_first_state_as_axis():
    states = {"x1": np.linspace(-0.02, 0.02, 20), "x2": np.linspace(0.05, -0.05, 20)}
    figure = picture(basin(states))
    assert "start, x₁(0) [mm]" in axis_labels(figure)
    assert (meshes(figure)[0].get_array()[0] == np.repeat([3, 6], 10)).all()


def test_named_starts_outside_plane_are_in_note():
    figure = picture(basin(plane(), named=("drive",)))
    assert meshes(figure)[0].get_array().shape == (10, 12)
    assert "Not shown: the start drive (irregular)" in note(figure)


# Starts anywhere in the state space.


def test_sample_is_scattered_over_phase_planes():
    ds = basin(sample())
    figure = picture(ds)
    assert {f"start, {name}(0) [{unit}]" for name, unit in zip(("x₁", "x₂"), ("mm", "mm"), strict=True)} <= axis_labels(
        figure
    )
    assert {"start, x₁′(0) [m/s]", "start, x₂′(0) [m/s]"} <= axis_labels(figure)
    striker = next(axes for axes in figure.axes if axes.get_ylabel().startswith("start, x₂′"))
    (dots,) = (
        collection
        for collection in striker.collections
        if isinstance(collection, PathCollection) and len(collection.get_offsets())
    )
    positions = dots.get_offsets()
    assert sorted(positions[:, 0].tolist()) == pytest.approx(sorted((1e3 * ds["start_x2"]).values.tolist()))
    assert np.array_equal(dots.get_array(), np.where(positions[:, 0] > 0, 3, 6))


def test_starts_without_states_are_counted_together():
    ds = basin(sample()).drop_vars([f"start_{name}" for name in UNITS])
    figure = picture(ds)
    assert titles(figure) == ["100 starts together"]
    widths = [bar.get_width() for bar in figure.axes[0].patches]
    assert widths == [int((ds["regime"] == flag).sum()) for flag in (3, 6)]


# Many starts at each point of a grid.


def test_many_starts_over_grid_are_drawn_as_share_of_each_regime():
    ds = basin(sample(64), LONG)
    ds["regime"][{"beta": 0, "gamma": 0, "start": slice(0, 16)}] = 5
    figure = picture(ds)
    shares = meshes(figure, "viridis")
    expected = [100.0 * (ds["regime"] == flag).mean("start").transpose("beta", "gamma") for flag in (3, 6, 5)]
    assert len(shares) == 3
    for mesh, share in zip(shares, expected, strict=True):
        assert np.allclose(mesh.get_array(), share)
        assert (mesh.norm.vmin, mesh.norm.vmax) == (0.0, 100.0)
    assert {"single-impact [% of starts]", "irregular [% of starts]"} <= axis_labels(figure)
    most = meshes(figure)[0].get_array()
    assert (most[:, ds["gamma"].values >= 0.8] == 6).all()
    assert "64 starts" in note(figure)


def test_many_starts_along_one_axis_are_dots_above_shares():
    ds = basin(sample(50), {"gamma": LONG["gamma"]})
    figure = picture(ds)
    (dots,) = (collection for collection in figure.axes[0].collections if isinstance(collection, PathCollection))
    expected = {(x, y) for x, ys in zip(ds["gamma"].values, ds["impact_velocity"].values, strict=True) for y in ys}
    assert set(map(tuple, dots.get_offsets().tolist())) == expected
    single = (ds["regime"] == 3).sum("start").values
    assert np.array_equal((meshes(figure)[0].get_array() == 3).sum(axis=0), single)
    assert (meshes(figure)[0].get_array()[0] == np.where(single > 0, 3, 6)).all()  # stacked from the bottom


def test_returns_of_many_starts_are_coloured_by_regime():
    ds = basin(sample(50), {"gamma": LONG["gamma"]}, keep=4)
    figure = picture(ds)
    (dots,) = (collection for collection in figure.axes[0].collections if isinstance(collection, PathCollection))
    lanes = np.stack(np.broadcast_arrays(ds["gamma"].values[:, None], ds["impact_velocity"].values), axis=-1)
    assert set(map(tuple, dots.get_offsets().tolist())) == set(map(tuple, lanes.reshape(-1, 2).tolist()))
    assert len(dots.get_offsets()) < 50 * 7 * 4  # coincident dots are drawn once
    assert np.array_equal(dots.get_array() == 3, dots.get_offsets()[:, 1] > 1.0)
    assert "start: " not in " ".join(legend(figure))


def test_many_starts_of_point_list_are_drawn_as_shares_or_counts():
    ds = basin(sample(20), {"point": np.arange(30.0)})
    draw = np.random.default_rng(2)
    ds = ds.assign_coords({name: ("point", draw.uniform(0.3, 0.9, 30)) for name in ("beta", "gamma")})
    assert "single-impact [% of starts]" in axis_labels(picture(ds))
    counted = picture(ds.assign_coords(v=("point", draw.uniform(1, 2, 30))))
    assert titles(counted) == ["20 starts together"]


# Page size.

AXES = ("gamma", "beta", "delta", "v")
SHAPES = [
    *[(starts,) for starts in (1, 8, 9, 576)],
    *[(2, 8), (2, 100), (40, 1), (40, 8), (40, 9)],
    *[(3, 5, 8), (3, 5, 9), (3, 11, 64), (12, 5, 9), (12, 11, 1), (12, 11, 8), (12, 11, 64)],
    *[(3, 4, 5, 8), (11, 7, 13, 2), (11, 7, 13, 64), (2, 3, 4, 5, 8), (7, 7, 7, 7, 9)],
]
CASES = [(kind, shape) for shape in SHAPES for kind in (sample, line) if kind is line or shape[-1] > 8]


PAGE_CASES = [pytest.param(*case, marks=[pytest.mark.long] * (index % 3 > 0)) for index, case in enumerate(CASES)]


@pytest.mark.parametrize(("kind", "shape"), PAGE_CASES)
def test_sweep_of_any_shape_fits_on_page(kind, shape):
    *sizes, starts = shape
    grid = {name: np.linspace(0.3, 0.9, size) for name, size in zip(AXES, sizes, strict=False)}
    ds = basin(kind(starts), grid).assign_attrs(title="Regimes of a drill " * 20)
    figure = picture(ds)
    figure.draw_without_rendering()
    assert figure.get_figwidth() <= PAGE[0] and figure.get_figheight() <= PAGE[1]
    cells = [collection for axes in figure.axes for collection in axes.collections if isinstance(collection, QuadMesh)]
    panels = len(titles(figure)) or 1
    assert len(cells) <= 60 and panels <= 60
    lanes = {name: size for name, size in ds.sizes.items() if name != "start" and size > 1}
    if np.prod(list(lanes.values())) * starts > 4000:
        assert "Too many panels" in note(figure) or "starts" in note(figure)


@pytest.mark.parametrize("starts", [5, 8])
def test_diagrams_of_several_starts_and_facets_fit_on_page(starts):
    names = [json.dumps([0.0, 0.0, 0.01 * index, 1.0 / 3.0]) for index in range(starts)]
    figure = picture(returns({"gamma": np.linspace(0.3, 1.2, 15), "delta": np.linspace(-0.005, 0.005, 11)}, 4, names))
    assert figure.get_figwidth() <= PAGE[0] and figure.get_figheight() <= PAGE[1]
    assert "Too many panels to show all" in note(figure)
    assert "start: [0, 0, 0.01, 0.333]" in " ".join(titles(figure))


# Coordinates of the dataset.


def test_vector_starts_have_states_as_coordinates():
    starts = ["stuck", [0.0, -1.5, 0.02, 1.0], [0.01, 0.0, -0.02, -1.0]]
    sweep = {
        "scene": "vibro-impact",
        "starts": starts,
        "grid": {"gamma": [0.7]},
        "run": {"settle": 1.0, "observe": 1.0},
    }
    ds = vj.run_sweep(sweep, progress=False)
    for index, name in enumerate(UNITS):
        coordinate = ds[f"start_{name}"]
        assert coordinate.dims == ("start",) and coordinate.attrs["units"] == UNITS[name]
        assert np.array_equal(coordinate, [np.nan, starts[1][index], starts[2][index]], equal_nan=True)
    assert ds["start"].values[0] == "stuck"
    named = vj.run_sweep(sweep | {"starts": ["stuck"]}, progress=False)
    assert not [name for name in named.coords if str(name).startswith("start_")]
