"""Test how valid sweep files and starts are read. Invalid files are in test_sweep_file_refused."""

from math import pi

import numpy as np
import pandas as pd
import pint
import pytest
import xarray as xr
from refusals import refusal
from systems import system

import vibrojax as vj
from vibrojax.errors import Place
from vibrojax.maps.read import read_point, read_sweep
from vibrojax.settings.run_settings import RunSettings

FULL = """
scene = "vibro-impact"
title = "a map"

[parameters]
k0 = 40e6

[grid]
beta = { start = 0.25, stop = 0.60, num = 8 }
gamma = [0.8, 0.6, 0.7]
v = { start = 0.5, stop = 2.0, num = 3, spacing = "log" }

[run]
settle = 10
error = 1e-3
keep_returns = 5
"""


def write_text(folder, text, name="map.toml"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_full_file_is_read_with_defaults(tmp_path):
    sweep = read_sweep(write_text(tmp_path, FULL))
    assert (sweep.name, sweep.title, sweep.scene, sweep.friction) == ("map", "a map", "vibro-impact", "stribeck")
    assert sweep.text == FULL
    assert tuple(sweep.starts) == ("drive", "stuck")
    assert sweep.given == {"k0": 40e6}
    assert sweep.parameters["k0"] == 40e6 and sweep.parameters["mu"] == 0.4 and sweep.parameters["delta"] == -0.005
    assert not {"beta", "gamma", "v"} & sweep.parameters.keys()
    assert sweep.dims == ("beta", "gamma", "v", "start") and sweep.shape == (8, 3, 3, 2) and sweep.lanes == 144
    np.testing.assert_allclose(sweep.axes["beta"], 0.25 + 0.05 * np.arange(8), rtol=1e-15)
    assert sweep.axes["gamma"].tolist() == [0.8, 0.6, 0.7]
    np.testing.assert_allclose(sweep.axes["v"], [0.5, 1.0, 2.0], rtol=1e-15)
    assert sweep.run == RunSettings(settle=10.0, error=1e-3, keep_returns=5)
    assert isinstance(sweep.run.settle, float)


def test_dict_and_its_text_give_same_sweep(tmp_path):
    tables = {
        "scene": "vibro-impact",
        "title": 'ä "quoted" \\ \t end',
        "starts": ("drive", [0.0, 0.0, 1e-3, 0.0]),
        "parameters": {"friction": "coulomb", "k0": np.float64(3e7)},
        "grid": {"beta": np.linspace(0.1, 0.3, 3), "gamma": {"start": 0.3, "stop": 0.6, "num": 4}},
        "run": {"end_early": False, "precision": "float32"},
    }
    sweep = read_sweep(tables)
    again = read_sweep(write_text(tmp_path, sweep.text))
    assert sweep.name == "sweep" and again.name == "map"
    assert again.title == tables["title"] and again.friction == "coulomb" and not again.run.end_early
    assert again.identity() == sweep.identity()


def test_identity_depends_only_on_what_is_computed():
    base = {"scene": "rotary", "grid": {"beta": np.linspace(0.1, 0.5, 20)}}
    same = base | {"title": "other", "run": {"chunk": 7}, "parameters": {"m1": 250}}
    identity = read_sweep(base).identity()
    assert read_sweep(same).identity() == identity
    axis = np.linspace(0.1, 0.5, 20)
    axis[7] = np.nextafter(axis[7], 1)
    for other in ({"grid": {"beta": axis}}, {"run": {"settle": 41}}, {"starts": ["stuck", "drive"]}):
        assert read_sweep(base | other).identity() != identity


# bit_frequency replaces k1 = m1 (2 pi bit_frequency)², striker_frequency gamma = striker_frequency/bit_frequency
@pytest.mark.parametrize(
    ("parameters", "grid", "k1", "gamma"),
    [
        ({"striker_frequency": 3.0}, {"v": [1.0]}, [156250.0], [3.0 * 2 * pi / 25.0]),
        ({"bit_frequency": 4.0}, {"gamma": [0.7]}, [250.0 * (8 * pi) ** 2], [0.7]),
        ({"bit_frequency": 4.0}, {"striker_frequency": [2.0, 3.0]}, [250.0 * (8 * pi) ** 2] * 2, [0.5, 0.75]),
        ({"striker_frequency": 3.0}, {"m1": [250.0, 1000.0]}, [156250.0] * 2, [6 * pi / 25, 6 * pi / 12.5]),
    ],
)
def test_frequencies_give_stiffness_and_ratio(parameters, grid, k1, gamma):
    sweep = read_sweep({"scene": "vibro-impact", "parameters": parameters, "grid": grid, "starts": ["drive"]})
    values, _ = sweep.lane_values(0, sweep.lanes)
    assert values["k1"] == pytest.approx(k1) and values["gamma"] == pytest.approx(gamma)
    assert set(values) == set(sweep.system.parameters())


def test_points_can_be_data_frame():
    """A data frame is read as the table of its columns, without its index."""
    base = {"scene": "vibro-impact", "run": {"settle": 1.0, "observe": 1.0}}
    table = {"beta": [0.3, 0.4], "gamma": [0.7, 0.66], "start": ["drive", "stuck"]}
    frame = pd.DataFrame(table, index=["a", "b"])
    assert read_sweep({**base, "points": frame}).identity() == read_sweep({**base, "points": table}).identity()
    for wrong, line in (
        (frame.assign(beta=[0.3, np.nan]), "sweep: points.beta[1]: is nan; a finite number is needed"),
        (frame[["beta", "beta"]], "sweep: points.beta: is there already; give each column once"),
        (frame.rename(columns={"beta": "bet"}), 'sweep: points.bet: scene "vibro-impact" has no such parameter'),
    ):
        assert refusal(read_sweep, {**base, "points": wrong}).startswith(line)


def with_unit(array, unit):
    array.attrs["units"] = unit
    return array


UNIT = pint.UnitRegistry()
SPEEDS = {
    "array": np.array([0.8, 1.2]),
    "series": pd.Series([0.8, 1.2]),
    "m/s": with_unit(xr.DataArray([0.8, 1.2]), "m s-1"),
    "mm/s": with_unit(xr.DataArray([800, 1200]), "mm/s"),
    "series in mm/s": with_unit(pd.Series([800.0, 1200.0]), "mm s-1"),
    "pint": [80, 120] * UNIT.cm / UNIT.s,
    "list of pint": [0.8 * UNIT.m / UNIT.s, 72 * UNIT.m / UNIT.min],
}


def test_values_are_converted_from_the_units_that_they_state():
    """Parameters may be arrays, or variables or coordinates; other coordinates number the points."""
    for values in SPEEDS.values():
        for key in ("grid", "points"):
            sweep = read_sweep({"scene": "vibro-impact", key: {"v": values}})
            assert (sweep.axes or sweep.points)["v"] == pytest.approx([0.8, 1.2], rel=1e-15)
            assert f"[{key}]\nv = [0.8, 1.2" in sweep.text
    table = xr.Dataset({"beta": ("v", [30, 40], {"units": "%"})}, {"v": SPEEDS["mm/s"].values, "row": ("v", [7, 8])})
    table.v.attrs["units"] = "mm/s"
    points = read_sweep({"scene": "vibro-impact", "points": table}).points
    np.testing.assert_allclose([points["v"], points["beta"]], [[0.8, 1.2], [0.3, 0.4]], rtol=1e-15)
    point = read_point(Place("simulate"), "vibro-impact", {"v": table.v[1], "beta": 40 * UNIT.percent})
    assert [point.parameters[name] for name in ("v", "beta")] == pytest.approx([1.2, 0.4], rel=1e-15)
    sliding = system({"x": "mm"}, lambda t, y, p: {"x": -y["x"]}, section="x")
    for starts in ([[2 * UNIT.m]], {"plane": {"x": {"start": 2 * UNIT.m, "stop": 3 * UNIT.m, "num": 2}}}):
        assert read_sweep({"scene": sliding, "starts": starts}).starts[0][0] == 2000.0
    assert read_point(Place("simulate"), sliding, {}, [2 * UNIT.m]).start == (2000.0,)
    minutes = with_unit(xr.DataArray(3.0), "min")
    for tables, line in (
        ({"grid": {"v": with_unit(xr.DataArray([0.8]), "kN")}}, 'sweep: grid.v: is in "kN"; a unit of m/s is needed'),
        ({"grid": {"v": [1 * UNIT.lightyear]}}, 'sweep: grid.v[0]: is in "ly"; a unit of m/s is needed'),
        ({"grid": {"v": [1.0]}, "run": {"settle": minutes}}, 'sweep: run.settle: is in "min"; a number in SI units is'),
    ):
        assert refusal(read_sweep, {"scene": "vibro-impact"} | tables).startswith(line)


def test_points_file_is_relative_to_sweep_file(tmp_path):
    (tmp_path / "p.csv").write_bytes(b"\xef\xbb\xbfbeta, gamma\r\n0.3,0.7\r\n\r\n0.4,1e0\r\n")
    sweep = read_sweep(write_text(tmp_path, 'scene = "vibro-impact"\npoints = "p.csv"\n'))
    assert sweep.dims == ("point", "start") and sweep.shape == (2, 2) and not sweep.own_starts
    values, starts = sweep.lane_values(0, 4)
    assert values["gamma"].tolist() == [0.7, 0.7, 1.0, 1.0] and starts.tolist() == [0, 1, 0, 1]
    points = {"beta": [0.3, 0.4, 0.5], "start": ["stuck", "drive", "stuck"]}
    sweep = read_sweep({"scene": "vibro-impact", "points": points, "starts": ["touching"]})
    assert sweep.dims == ("point",) and sweep.shape == (3,) and list(sweep.starts) == points["start"]
    values, starts = sweep.lane_values(1, 3)
    assert values["beta"].tolist() == [0.4, 0.5]
    assert [sweep.starts[index] for index in starts] == ["drive", "stuck"]


# Samples of a box, planes of states and columns of points as starts
BOX = {"x1": [-0.05, 0.05], "v1": [-2.0, 2.0], "x2": [-0.05, 0.05], "v2": [-3.0, 3.0]}
STATES = ("x1", "v1", "x2", "v2")
RUN = {"settle": 1.0, "observe": 1.0}


def read_starts(starts, **more):
    return vj.read_sweep({"scene": "vibro-impact", "starts": starts, "run": RUN} | more)


def sobol(count=64, **more):
    return {"sample": "sobol", "count": count, "seed": 0, "box": BOX} | more


def test_samples_and_planes_of_starts():
    """In one dimension, of 2^m points of the sequence one lies in each of 2^m slices (Sobol 1967)."""
    starts = read_starts(sobol()).starts
    low, high = np.array(list(BOX.values())).T
    slices = np.floor(64 * (starts.vectors - low) / (high - low)).astype(int)
    for column in slices.T:
        assert sorted(column) == list(range(64))
    assert (read_starts(sobol(40)).starts.vectors == starts.vectors[:40]).all()
    assert (read_starts(sobol(seed=1)).starts.vectors != starts.vectors).all()
    plane = {"plane": {"v2": [0.5, 1.0], "x2": {"start": -0.01, "stop": 0.01, "num": 3}}, "at": {"v1": -1.5}}
    expected = [[0.0, -1.5, x2, v2] for v2 in (0.5, 1.0) for x2 in (-0.01, 0.0, 0.01)]
    np.testing.assert_allclose(read_starts(plane).starts.vectors, expected, rtol=0, atol=1e-17)


def test_sweep_over_sample_agrees_with_sweep_over_listed_vectors(tmp_path):
    drawn = read_starts(sobol(6), parameters={"beta": 0.4})
    sampled = vj.run_sweep(drawn, progress=False)
    assert sampled.regime.dims == ("start",) and sampled.start.values.tolist() == list(range(6))
    vectors = [list(vector) for vector in drawn.starts]
    listed = vj.run_sweep({"scene": "vibro-impact", "starts": vectors, "grid": {"beta": [0.4]}, "run": RUN}, False)
    for name in ("period", "impact_velocity", "bit_amplitude"):
        np.testing.assert_array_equal(sampled[name], listed[name].isel(beta=0))
    for column, (name, unit) in enumerate(zip(STATES, ("m", "m s-1", "m", "m s-1"), strict=True)):
        np.testing.assert_array_equal(sampled[f"start_{name}"], np.array(vectors)[:, column])
        assert sampled[f"start_{name}"].attrs["units"] == unit
    vj.write_dataset(sampled, tmp_path / "starts.nc")
    assert vj.picture(vj.open_dataset(tmp_path / "starts.nc"))
    again = vj.orbits(sampled, progress=False)  # from the sweep text in the dataset
    np.testing.assert_array_equal(again.start_x1, sampled.start_x1)


def test_invalid_starts_are_refused_in_one_line():
    for starts, line in (
        ({}, "starts: neither a sample nor a plane; write one like"),
        (sobol(0), "starts.count: 0 does not fit; a whole number from 1 to"),
        (sobol(box={"y1": [0, 1]}), "starts.box.y1: unknown key; did you mean"),
        (sobol(box={"x1": [0.1, -0.1]}), "starts.box.x1: from 0.1 to -0.1 is not a side of a box; the first end must"),
        ({"plane": {"x2": {"start": 0, "stop": 1, "num": 10**4}, "v2": {"start": 0, "stop": 1, "num": 10**4}}}, "many"),
    ):
        assert line in refusal(read_starts, starts)


COLUMNS = ("start_x1", "start_v1", "start_x2", "start_v2")
VECTORS = np.array([[0.0, -1.5, 0.0, 0.0], [0.01, 0.3, -0.02, 1.0], [-0.03, 0.0, 0.001, -2.0]])


def sweep(vectors=VECTORS, **more):
    points = {name: vectors[:, i].tolist() for i, name in enumerate(COLUMNS)}
    return {"scene": "vibro-impact", "points": points | more, "run": RUN}


def test_each_point_starts_from_its_own_state():
    dataset = vj.run_sweep(sweep(beta=[0.4, 0.3, 0.5]), progress=False)
    assert dataset.regime.dims == ("point",) and "start" not in dataset.dims
    for i, beta in enumerate((0.4, 0.3, 0.5)):
        single_sweep = {"scene": "vibro-impact", "starts": [VECTORS[i].tolist()], "grid": {"beta": [beta]}, "run": RUN}
        alone = vj.run_sweep(single_sweep, progress=False).squeeze()
        for name in ("period", "impact_velocity", "bit_amplitude", "drive_power"):
            assert float(dataset[name][i]) == float(alone[name]), name
    # The first vector is the named start `stuck`.
    named = vj.run_sweep({"scene": "vibro-impact", "starts": ["stuck"], "grid": {"beta": [0.4]}, "run": RUN}, False)
    assert float(dataset.period[0]) == named.period.item()
