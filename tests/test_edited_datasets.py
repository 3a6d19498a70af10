"""Tests of analyses of edited datasets: the lanes that they run are those of the coordinates, as a new sweep has."""

import json
import tomllib

import numpy as np
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from refusals import refusal

import vibrojax as vj
from vibrojax.explorer.views import sweep_of
from vibrojax.io.attributes import table_of
from vibrojax.maps.rerun import holds_orbits, sweep_of_dataset
from vibrojax.pictures.axes import certified_text
from vibrojax.pictures.selection import select
from vibrojax.studies.attractors import Attractors
from vibrojax.studies.curves import problem_of, read_curves
from vibrojax.studies.summary import summary_facts

RUN = {"settle": 1.0, "observe": 1.0}
SETTLED = {"settle": 20.0, "observe": 4.0}
GRID = {"beta": [0.3, 0.35, 0.4], "gamma": [0.65, 0.7]}
STARTS = {
    "names": ["stuck", "drive", "touching"],
    "vectors": ["stuck", [0.0, 0.1, 0.0, 0.2], [0.01, 0.0, 0.0, 0.0]],
    "sample": {"sample": "random", "count": 3, "seed": 1, "box": {"x1": [-0.05, 0.05], "v1": [-2.0, 2.0]}},
}


def tables(starts="names"):
    return {"scene": "vibro-impact", "parameters": {"delta": 0.005}, "grid": GRID, "starts": STARTS[starts], "run": RUN}


@pytest.fixture(scope="module")
def datasets():
    return {name: vj.run_sweep(tables(name), progress=False) for name in STARTS}


@pytest.fixture(scope="module")
def points():
    columns = {"beta": [0.3, 0.4, 0.5], "gamma": [0.6, 0.7, 0.8], "start": ["stuck", "drive", "stuck"]}
    return vj.run_sweep({"scene": "vibro-impact", "points": columns, "run": RUN}, progress=False)


def lanes(sweep):
    """Return the parameters and initial states of all lanes, as rows that can be compared, in the sweep's order."""
    values, index = sweep.lane_values(0, sweep.lanes)
    start = [sweep.starts[i] for i in index]
    return [(*(float(x[k]) for x in values.values()), start[k]) for k in range(sweep.lanes)]


def expected_lanes(ds, starts):
    """Return the lanes of a new sweep at the coordinates of a dataset."""
    grid = {name: ds[name].values for name in GRID if ds[name].ndim}
    fixed = {name: ds[name].item() for name in GRID if not ds[name].ndim}
    fresh = {"scene": "vibro-impact", "run": RUN, "parameters": fixed | {"delta": float(ds.coords.get("delta", 0.005))}}
    fresh["starts"] = np.atleast_1d(ds["start"].values).tolist()
    if starts != "names":
        vectors = np.array([np.atleast_1d(ds[f"start_{name}"].values) for name in ("x1", "v1", "x2", "v2")]).T
        fresh["starts"] = ["stuck" if np.isnan(row).any() else row.tolist() for row in vectors]
    return lanes(vj.read_sweep(fresh | ({"grid": grid} if grid else {})))


@st.composite
def edits(draw):
    """Draw some edits of a dataset; each is a function."""
    name = draw(st.sampled_from(("beta", "gamma", "start")))
    size = 2 if name == "gamma" else 3
    order = draw(st.permutations(range(size)))[: draw(st.integers(1, size))]
    low = draw(st.integers(0, size - 1))
    selections = [
        lambda ds: ds.isel({name: [index for index in order if index < ds.sizes[name]] or [0]}),
        lambda ds: ds.isel({name: min(low, ds.sizes[name] - 1)}),
        lambda ds: ds.sel({name: ds[name].values[:2]}),
        lambda ds: xr.concat([ds.isel({name: [-1]}), ds.isel({name: slice(0, -1)})], name),
    ]
    selection = draw(st.sampled_from(selections))
    moved = lambda ds: ds.assign_coords(beta=ds.beta + 0.01 * (1 + low))
    selected = lambda ds: selection(ds) if ds.sizes.get(name, 0) > 1 else ds
    return draw(st.sampled_from([selected, moved, lambda ds: ds.assign_coords(delta=0.001 * low)]))


@settings(max_examples=30, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(st.sampled_from(list(STARTS)), st.lists(edits(), min_size=1, max_size=3))
def test_lanes_are_those_of_the_coordinates(datasets, starts, changes):
    ds = datasets[starts]
    for change in changes:
        ds = change(ds)
    sweep, given = sweep_of_dataset(ds), vj.read_sweep(tables(starts))
    for own in (sweep, Attractors().sweep(ds), sweep_of(ds)[0], sweep_of(ds, given)[0]):
        assert lanes(own) == expected_lanes(ds, starts)
    assert lanes(vj.read_sweep(tomllib.loads(sweep.text))) == lanes(sweep)  # as the next dataset states


def test_combined_datasets_are_one_sweep(datasets):
    """`xr.combine_by_coords` of neighbouring grids: lanes, counts and orbits are those of both, claims of neither."""
    low = datasets["names"]
    low = low.assign_attrs(certified=json.dumps(table_of(low, "certified") | {"estimated": 2, "within": 1}))
    high = vj.run_sweep(tables() | {"grid": GRID | {"beta": [0.45, 0.5]}}, progress=False)
    both = xr.combine_by_coords([high, low], combine_attrs="override")
    assert both.beta.values.tolist() == [0.3, 0.35, 0.4, 0.45, 0.5] and both.regime.attrs == low.regime.attrs
    facts = summary_facts(both, "")
    assert facts["lanes"] == both.regime.size == low.regime.size + high.regime.size and facts["certified"] is None
    assert summary_facts(low, "")["certified"]["lanes"] == low.regime.size
    assert "that repeat" in certified_text(low) and "that repeat" not in certified_text(both)
    assert "that repeat" not in certified_text(low.isel(beta=[0]))
    fresh = vj.orbits(tables() | {"grid": GRID | {"beta": both.beta.values}}, progress=False)
    xr.testing.assert_equal(vj.orbits(both, progress=False), fresh)
    with pytest.raises(vj.InputError, match='no attribute sweep; combine_attrs="override" keeps'):
        vj.orbits(xr.combine_by_coords([high, low], combine_attrs="drop_conflicts"))
    other = tables() | {"grid": GRID | {"beta": [0.45, 0.5]}, "parameters": {"delta": -0.005}, "run": SETTLED}
    same = vj.run_sweep(tables() | {"run": SETTLED}, progress=False)
    joined = xr.combine_by_coords([same, vj.run_sweep(other, progress=False)], combine_attrs="override")
    assert "another period than in the dataset" in refusal(vj.orbits, joined, progress=False)


def test_orbits_are_not_those_of_other_lanes(datasets):
    """Stored orbits belong to the coordinates at which they were computed."""
    ds = vj.orbits(datasets["names"].isel(start=[0]), progress=False)
    assert holds_orbits(ds) and vj.orbits(ds) is ds
    moved = ds.assign_coords(beta=[0.31, 0.36, 0.41])
    assert not any(map(holds_orbits, (moved, ds.isel(beta=[0]), ds.isel(gamma=[1, 0]))))
    result = vj.orbits(moved, progress=False)
    assert result.beta.values.tolist() == [0.31, 0.36, 0.41] and holds_orbits(result)


def test_lanes_without_coordinates_are_refused(datasets):
    ds = datasets["names"]
    for changed, line in (
        (ds.isel(beta=0, drop=True), "has no coordinate beta"),
        (xr.concat([ds, ds], "copy"), 'lanes are along "copy"'),
        (ds.assign_coords(mu=("beta", [0.1, 0.2, 0.3])), "mu: varies along beta"),
        (ds.assign_coords(beta=[-0.1, 0.2, 0.3]), "grid.beta[0]: is -0.1"),
    ):
        assert line in refusal(sweep_of_dataset, changed)


def test_edited_starts_and_points(datasets, points):
    """Either the label of a start or its states may be edited."""
    ds, both = datasets["vectors"], ("start", [np.nan, 0.1, 0.5])
    assert list(sweep_of_dataset(ds.assign_coords(start_v1=both)).starts)[2] == (0.01, 0.5, 0.0, 0.0)
    label = "[0.02, 0.0, 0.0, 0.0]"
    labels = ds.assign_coords(start=[*ds.start.values[:2], label])
    assert list(sweep_of_dataset(labels).starts)[2] == (0.02, 0.0, 0.0, 0.0)
    assert "change both, or one" in refusal(sweep_of_dataset, labels.assign_coords(start_v1=both))
    moved = points.assign_coords(gamma=("point", [0.6, 0.66, 0.8]))
    for ds in (points.isel(point=[2, 0]), points.isel(point=1), moved):
        sweep = sweep_of_dataset(ds)
        for name in ("beta", "gamma"):
            assert sweep.points[name].tolist() == np.atleast_1d(ds[name].values).tolist()
        assert list(sweep.starts) == np.atleast_1d(ds["start"].values).tolist()
    assert sweep_of_dataset(points.assign_coords(delta=0.001)).points["delta"].tolist() == [0.001] * 3
    for name in ("beta", "start"):
        with pytest.raises(vj.InputError, match=f"has no coordinate {name}"):
            sweep_of_dataset(points.drop_vars(name))
    assert "has no coordinate beta" in refusal(sweep_of_dataset, points.isel(point=0, drop=True))


def test_rocks_and_carried_lanes():
    rocks = {"scene": "penetration", "grid": {"rock": ["sandstone", "granite"], "frequency": [20.0, 40.0]}, "run": RUN}
    one = sweep_of_dataset(vj.run_sweep(rocks, progress=False).isel(rock=1, frequency=[1]))
    fresh = rocks | {"parameters": {"rock": "granite"}, "grid": {"frequency": [40.0]}}
    values = [sweep.lane_values(0, sweep.lanes)[0] for sweep in (one, vj.read_sweep(fresh))]
    assert all(values[0][name].tolist() == x.tolist() for name, x in values[1].items())
    carried = tables() | {"starts": ["stuck"], "run": RUN | {"carry": "gamma"}}
    ds = vj.run_sweep(carried, progress=False)
    assert sweep_of_dataset(ds.isel(beta=[2, 1])).axes["beta"].tolist() == [0.4, 0.35]
    for change, line in (({"direction": [0]}, "run up and down"), ({"gamma": [1, 0]}, "do not rise")):
        with pytest.raises(vj.InputError, match=line):
            sweep_of_dataset(ds.isel(change))


@pytest.fixture(scope="module")
def families():
    """Return families over gamma at three values of beta; of their special points, those at the ends count as folds."""
    values = {"at": 0.72, "span": (0.715, 0.725), "start": "stuck", "beta": [0.35, 0.4, 0.5], "settle": 20.0}
    ds = vj.follow("vibro-impact", along="gamma", progress=False, **values)
    assert ds.beta.dims == ("family",) and set(ds.special_family.values) == {0, 1, 2}
    return ds.assign(special_kind=ds.special_kind.copy(data=np.zeros_like(ds.special_kind)))


def curves_of(ds, special=None):
    return read_curves(ds, "v", (0.5, 2.5), special, None)


def test_curves_begin_at_the_selected_families(families):
    for ds, values in (
        (families.isel(family=[2, 0]), {0: 0.35, 2: 0.5}),
        (select(families, {"beta": 0.5}), {2: 0.5}),
        (families.drop_vars("family"), {0: 0.35, 1: 0.4, 2: 0.5}),
    ):
        spec = curves_of(ds)
        number = ds.special_family.values[spec.special]
        assert spec.parameters["beta"].tolist() == [values[k] for k in number] and set(number) == set(values)
    other = int(np.flatnonzero(families.special_family.values == 0)[0])
    for ds, special, line in (
        (families.isel(family=1), other, "of a family that the dataset does not hold"),
        (families.isel(family=1, drop=True), None, "beta is not known"),
        (families.assign_coords(delta=0.001), None, "at delta = -0.005, not 0.001"),
    ):
        with pytest.raises(vj.InputError, match=line):
            curves_of(ds, special)
    assert "is not in the family" in refusal(problem_of, curves_of(families.isel(point=slice(2, 4)), [other]))


def test_means_of_flags_are_not_drawn(datasets):
    mean = datasets["names"].mean("beta", keep_attrs=True)
    assert "flags" in refusal(vj.picture, mean)
    assert vj.picture(datasets["names"].where(datasets["names"].beta > 0.3))
