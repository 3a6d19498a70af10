"""Test samples of a box, planes of states and columns of points as starts, and sweeps over starts alone."""

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.errors import InputError
from vibrojax.io.dataset import open_dataset
from vibrojax.io.writers import write_dataset

BOX = {"x1": [-0.05, 0.05], "v1": [-2.0, 2.0], "x2": [-0.05, 0.05], "v2": [-3.0, 3.0]}
STATES = ("x1", "v1", "x2", "v2")
RUN = {"settle": 1.0, "observe": 1.0}


def read_starts(starts, **more):
    return vj.read_sweep({"scene": "vibro-impact", "starts": starts, "run": RUN} | more)


def sobol(count=64, **more):
    return {"sample": "sobol", "count": count, "seed": 0, "box": BOX} | more


def test_sobol_sample_has_one_start_in_each_slice():
    """In one dimension, of 2^m points of the sequence one lies in each of 2^m slices (Sobol 1967)."""
    starts = read_starts(sobol()).starts
    low, high = np.array(list(BOX.values())).T
    slices = np.floor(64 * (starts.vectors - low) / (high - low)).astype(int)
    for column in slices.T:
        assert sorted(column) == list(range(64))
    assert (read_starts(sobol(40)).starts.vectors == starts.vectors[:40]).all()
    assert (read_starts(sobol(seed=1)).starts.vectors != starts.vectors).all()


def test_plane_is_row_major_in_given_order():
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
    write_dataset(sampled, tmp_path / "starts.nc")
    assert vj.picture(open_dataset(tmp_path / "starts.nc"))
    again = vj.orbits(sampled, progress=False)  # from the sweep text in the dataset
    np.testing.assert_array_equal(again.start_x1, sampled.start_x1)


@pytest.mark.parametrize(
    ("starts", "line"),
    [
        ({}, "starts: neither a sample nor a plane; write one like"),
        (sobol(0), "starts.count: 0 does not fit; a whole number from 1 to"),
        (sobol(box={"y1": [0, 1]}), "starts.box.y1: unknown key; did you mean"),
        (sobol(box={"x1": [0.1, -0.1]}), "starts.box.x1: from 0.1 to -0.1 is not a side of a box; the first end must"),
        ({"plane": {"x2": {"start": 0, "stop": 1, "num": 10**4}, "v2": {"start": 0, "stop": 1, "num": 10**4}}}, "many"),
    ],
)
def test_invalid_starts_are_refused_in_one_line(starts, line):
    with pytest.raises(InputError) as caught:
        read_starts(starts)
    assert line in str(caught.value) and "\n" not in str(caught.value)


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
