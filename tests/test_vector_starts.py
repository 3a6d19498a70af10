"""Test points with their own initial states in the columns start_x1, start_v1, start_x2, start_v2."""

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.errors import InputError

COLUMNS = ("start_x1", "start_v1", "start_x2", "start_v2")
VECTORS = np.array([[0.0, -1.5, 0.0, 0.0], [0.01, 0.3, -0.02, 1.0], [-0.03, 0.0, 0.001, -2.0]])
RUN = {"settle": 1.0, "observe": 1.0}


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


@pytest.mark.parametrize(
    ("header", "line"),
    [
        (
            "beta,start_x1,start_v1,start_x2",
            "line 1, column start_x1: start_v2 missing; a start is start_x1, start_v1, ",
        ),
        ("start_x1,start_v1,start_x2,start_v2", 'line 2, column start_v1: "fast" is not a number'),
    ],
)
def test_wrong_columns_are_refused_in_one_line(tmp_path, header, line):
    cells = {"start": "drive", "beta": "0.4", "start_v1": "fast" if "not a number" in line else "0.1"}
    row = ",".join(cells.get(name, "0.02") for name in header.split(","))
    (tmp_path / "points.csv").write_text(f"{header}\n{row}\n")
    (tmp_path / "map.toml").write_text('scene = "vibro-impact"\npoints = "points.csv"\n')
    with pytest.raises(InputError) as caught:
        vj.read_sweep(tmp_path / "map.toml")
    assert line in str(caught.value) and "\n" not in str(caught.value)
