"""Test the classification, shares and numbers of the attractors of a sweep."""

import json

import numpy as np
import pytest
import xarray as xr
from known_scenes import BeltOscillator
from matplotlib.collections import PolyCollection, QuadMesh
from read_off import note

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.errors import InputError
from vibrojax.io.files import source
from vibrojax.io.variables import NATURES
from vibrojax.lanes.run import LaneRun
from vibrojax.measures.labels import EQUILIBRIUM, FAILED, IRREGULAR, SINGLE_IMPACT, SUBHARMONIC
from vibrojax.studies.attractor_groups import Motion, classify_motions, is_ambiguous, join_chains, number_attractors
from vibrojax.studies.attractors import Attractors

BOX = {"x1": [-0.02, 0.02], "v1": [-2.0, 1.0], "x2": [-0.05, 0.05], "v2": [-3.0, 3.0]}
GAMMA = [0.35, 0.3625, 0.7375, 0.75, 0.7625]
SWEEP = {
    "scene": "vibro-impact",
    "parameters": {"delta": 0.005},
    "starts": {"sample": "sobol", "count": 64, "seed": 1, "box": BOX},
    "grid": {"beta": [0.395, 0.4], "gamma": GAMMA},
    "run": {"orbits": True},
}
SCENE = vj.read_sweep(SWEEP).system
REGIMES_AT = {"beta": 0.4, "gamma": 0.75}


@pytest.fixture(scope="module")
def sweep():
    return vj.run_sweep(SWEEP, progress=False)


@pytest.fixture(scope="module")
def attractors(sweep):
    return vj.attractors(sweep, progress=False)


def present(attractors, **point):
    """Return the attractors present at a point, by decreasing share."""
    local = attractors.sel(point)
    share = local.share.values
    return local.isel(attractor=np.argsort(-share, kind="stable")[: int((share > 0).sum())])


def test_structure_of_dataset(sweep, attractors):
    assert attractors.share.dims == ("beta", "gamma", "attractor") and attractors.unassigned.dims == ("beta", "gamma")
    assert attractors.lane_attractor.dims == sweep.regime.dims and attractors.lane_attractor.dtype == np.int32
    assert attractors.attractor.values.tolist() == list(range(attractors.sizes["attractor"]))
    assert all({"units", "long_name"} <= set(attractors[name].attrs) for name in attractors.variables)
    np.testing.assert_array_equal(attractors.start_x2, sweep.start_x2)
    assert attractors.attrs["title"] == "Attractors: vibro-impact"


def test_shares_count_every_start(attractors):
    starts = attractors.sizes["start"]
    np.testing.assert_allclose(attractors.share.sum("attractor") + attractors.unassigned / starts, 1.0, atol=1e-12)
    np.testing.assert_array_equal((attractors.lane_attractor == -1).sum("start"), attractors.unassigned)
    for number in attractors.attractor.values:
        np.testing.assert_allclose(
            (attractors.lane_attractor == number).mean("start"), attractors.share.sel(attractor=number)
        )
    np.testing.assert_allclose(
        attractors.share_stderr**2, attractors.share * (1 - attractors.share) / starts, atol=1e-15
    )
    assert (np.diff(attractors.share.sum(("beta", "gamma")).values) <= 0).all()


@pytest.mark.parametrize("gamma", GAMMA[2:])
def test_strong_single_impact_and_rattle_are_separated(sweep, attractors, gamma):
    """The impact velocity separates them: one strikes above 2 m/s, the other below 0.5 m/s."""
    here, lanes = present(attractors, beta=0.4, gamma=gamma), sweep.sel(beta=0.4, gamma=gamma)
    assert here.regime.values.tolist() == [SINGLE_IMPACT, IRREGULAR]
    assert here.cycles.values.tolist() == [1, 0] and here.impacts.values[0] == 1
    strong = lanes.impact_velocity.values > 1.0
    np.testing.assert_array_equal(attractors.lane_attractor.sel(beta=0.4, gamma=gamma) == here.attractor[0], strong)
    assert here.share.values[0] == strong.mean() and 0.8 < strong.mean() < 1
    velocity = here.impact_velocity.values
    assert velocity[0] > 2.0 and velocity[1] < 0.5
    assert velocity[0] == pytest.approx(float(lanes.impact_velocity.values[strong][0]), rel=1e-9)


def test_features_are_medians_over_lanes(sweep, attractors):
    point = {"beta": 0.4, "gamma": 0.75}
    lanes, strong = sweep.sel(point), int(attractors.impact_velocity.sel(point).argmax("attractor"))
    members = lanes.where(attractors.lane_attractor.sel(point) == strong)
    for name in ("impact_power", "stick_slip_index", "blow_frequency"):
        assert float(attractors[name].sel(point)[strong]) == pytest.approx(float(members[name].median()), rel=1e-6), (
            name
        )


def test_numbers_continue_along_axes(attractors):
    numbers = {
        (beta, gamma): present(attractors, beta=beta, gamma=gamma).attractor.values.tolist()
        for beta in attractors.beta.values
        for gamma in GAMMA[2:]
    }
    assert len(set(map(tuple, numbers.values()))) == 1
    # No attractor below the wide gap in the axis continues above it.
    below = set(np.flatnonzero((attractors.share.sel(gamma=GAMMA[:2]) > 0).any(("beta", "gamma"))))
    assert not below & set(next(iter(numbers.values())))


@pytest.mark.parametrize("axes", [("gamma",), ("beta",), ("beta", "gamma")])
def test_result_does_not_depend_on_direction_of_axes(attractors, axes):
    grid = {name: x[::-1] if name in axes else x for name, x in SWEEP["grid"].items()}
    other = vj.attractors(SWEEP | {"grid": grid}, progress=False)
    other = other.isel({name: slice(None, None, -1) for name in axes})
    for name in attractors.data_vars:
        np.testing.assert_array_equal(attractors[name], other[name])


def test_doubled_orbit_keeps_its_number(attractors):
    before, after = present(attractors, beta=0.4, gamma=0.35), present(attractors, beta=0.4, gamma=0.3625)
    assert (int(before.cycles[0]), int(after.cycles[0])) == (2, 4)
    assert before.regime.values[0] == after.regime.values[0] == SUBHARMONIC
    assert int(before.attractor[0]) == int(after.attractor[0])
    # Check by continuation of the first orbit: its period doubles between the two values.
    start = {"start": "drive", "beta": 0.4, "delta": 0.005, "cycles": 2}
    family = vj.follow("vibro-impact", along="gamma", at=0.35, span=(0.35, 0.3625), progress=False, **start)
    kinds = family.special_kind.attrs["flag_meanings"].split()
    doubled = family.special_kind.values == kinds.index("period-doubling")
    assert ((family.special_value.values[doubled] > 0.35) & (family.special_value.values[doubled] < 0.3625)).any()


@pytest.mark.long
def test_shares_of_belt_oscillator_match_published_values():
    """Compare with steady sliding and stick-slip of bSTAB's oscillator (Stender and Hoffmann 2021)."""
    speeds = {1.5: 0.3165, 1.55: 0.3636}
    starts = {"sample": "sobol", "count": 256, "seed": 1, "box": {"x1": [-2.0, 2.0], "v1": [-2.0, 0.0]}}
    tables = {"scene": BeltOscillator(), "starts": starts, "grid": {"v": list(speeds)}}
    attractors = vj.attractors(tables | {"run": {"settle": 400.0, "observe": 60.0}}, progress=False)
    assert attractors.sizes["attractor"] == 2 and attractors.unassigned.sum() == 0
    assert attractors.cycles.values.tolist() == [[1, 0], [1, 0]]  # attractor 0 sticks and slips, attractor 1 slides
    sliding = attractors.isel(attractor=1)
    assert (sliding.regime == EQUILIBRIUM).all()
    assert (np.abs(sliding.share - np.array(list(speeds.values()))) < 2 * sliding.share_stderr).all()


def test_named_starts_are_assigned_to_attractors(sweep, attractors):
    """Named starts reach the same regimes as in a sweep of their own. They do not contribute to the shares."""
    own = vj.run_sweep(SWEEP | {"starts": ["drive", "stuck"]}, progress=False)
    assert attractors.named_start.values.tolist() == ["drive", "stuck"]
    np.testing.assert_array_equal(attractors.named_regime, own.regime)
    for gamma in GAMMA[2:]:
        here = present(attractors, beta=0.4, gamma=gamma)
        strong = (own.impact_velocity.sel(beta=0.4, gamma=gamma) > 1.0).values
        assigned = attractors.named_attractor.sel(beta=0.4, gamma=gamma).values
        assert assigned.tolist() == here.attractor.values[np.where(strong, 0, 1)].tolist()
    listed = vj.attractors(own, progress=False)
    assert "named_attractor" not in listed


def test_lane_without_stable_orbit_is_unassigned(sweep, attractors):
    lanes = {"beta": 1, "gamma": 3, "start": np.flatnonzero(sweep.regime.sel(REGIMES_AT) == SINGLE_IMPACT)[:3]}
    changed = sweep.copy(deep=True)
    changed.stable[lanes] = 0
    changed.regime[lanes | {"gamma": 2}] = FAILED
    other = vj.attractors(changed, progress=False)
    assert other.unassigned.sel(REGIMES_AT) == attractors.unassigned.sel(REGIMES_AT) + 3
    assert (other.lane_attractor[lanes] == -1).all() and (other.lane_attractor[lanes | {"gamma": 2}] == -1).all()
    assert (other.lane_attractor.values != attractors.lane_attractor.values).sum() == 6


def test_undecided_lanes_are_all_unassigned(tmp_path):
    short = SWEEP | {"grid": {"gamma": [0.7, 0.75]}, "run": {"settle": 0.5, "observe": 1.0}}
    attractors = vj.attractors(short | {"starts": ["drive", "stuck"]}, progress=False)
    assert attractors.sizes["attractor"] == 0 and attractors.unassigned.values.tolist() == [2, 2]
    vj.save_picture(attractors, tmp_path / "none.png")
    assert "4 of 4 lanes unassigned (100.0 %)" in Attractors().summary(attractors)[0].lines


def irregular(**lanes):
    """Return a dataset of irregular lanes at one point."""
    count = len(next(iter(lanes.values())))
    fixed = {"regime": np.full(count, IRREGULAR), "stable": np.full(count, -1), "orbit_cycles": np.zeros(count)}
    orbits = {f"orbit_{name}": np.full(count, np.nan) for name in ("x1", "x2", "v2")}
    base = {"period": np.full(count, 0.2), "bit_amplitude": np.ones(count), "striker_amplitude": np.ones(count)}
    return xr.Dataset({name: ("start", np.array(x)) for name, x in (fixed | orbits | base | lanes).items()})


def groups(dataset, starts=None):
    """Return the motion of each lane, numbered in the order of the lanes."""
    motions = classify_motions(SCENE, dataset, {}, starts or dataset.sizes["start"])
    lanes = sorted(motion.lanes.tolist() for motion in motions)
    of_lane = {lane: number for number, own in enumerate(lanes) for lane in own}
    return [of_lane.get(lane, -1) for lane in range(dataset.sizes["start"])]


def test_irregular_lanes_are_grouped_by_statistics():
    """A chain of lanes, each within a quarter of the next, is one motion. Lanes without impacts are another one."""
    assert groups(irregular(impact_velocity=[1.0, 1.4, 1.2, 2.0, np.nan, 2.2, 2.1])) == [0, 0, 0, 1, 2, 1, 1]


def test_few_irregular_lanes_near_many_are_unassigned():
    """They may be the tail of the larger group's scatter. A lane far from all others is a separate motion."""
    assert groups(irregular(impact_velocity=[1.0, 1.1, 1.2, 2.0, 5.0])) == [0, 0, 0, -1, 1]


def test_irregular_motion_with_one_lane_everywhere_is_ambiguous():
    """It is ambiguous beside a motion with more lanes, unless it has several lanes at a neighbouring point."""
    regimes = ((0, 3, IRREGULAR), (0, 1, IRREGULAR), (1, 1, IRREGULAR), (2, 3, IRREGULAR), (2, 1, SINGLE_IMPACT))
    motions = [Motion(cell, np.arange(lanes), regime) for cell, lanes, regime in regimes]
    assert is_ambiguous(motions, np.array([0, 1, 2, 3, 4])).tolist() == [False, True, False, False, False]
    assert is_ambiguous(motions, np.array([0, 3, 2, 3, 4])).tolist() == [False] * 5


def test_lanes_at_different_points_are_different_motions():
    assert groups(irregular(impact_velocity=[1.0, 1.0, 1.0, 1.0]), 2) == [0, 0, 1, 1]


def test_irregular_lanes_are_grouped_by_lyapunov_exponents():
    """Known exponents replace the statistics, which may include a transient."""
    names = ["chaotic", "chaotic", "chaotic", "quasi-periodic", "not-settled", "chaotic"]
    lanes = {"nature": [NATURES.index(name) for name in names], "lyapunov": [1.0, 1.02, 2.0, 0.0, -0.1, 1.01]}
    lanes |= {"lyapunov_stderr": [0.01] * 6, "impact_velocity": [1.0, 3.0, 1.0, 1.0, 1.0, 9.0]}
    assert groups(irregular(**lanes)) == [0, 0, 1, 2, -1, 0]


def test_equilibria_at_one_point_are_one_motion():
    dataset = irregular(impact_velocity=[1.0, np.nan, np.nan])
    dataset.regime[1:] = EQUILIBRIUM
    assert groups(dataset) == [0, 1, 1]


def test_join_chains():
    x = np.array([[0.0, 0.0], [0.9, 0.5], [1.8, 0.0], [0.0, 2.5], [5.0, 0.0]])
    assert join_chains(x).tolist() == [0, 0, 0, 1, 2]


def test_numbers_are_unique_at_a_point():
    """Around a cusp, a chain of links joins two motions of one point. The longest link is dropped."""
    cells, lanes = [0, 0, 1, 2], [5, 4, 9, 9]
    links = [((0, 2), 0.1), ((2, 3), 0.2), ((1, 3), 0.3)]
    order = [(float(cell), float(k)) for k, cell in enumerate(cells)]
    expected = [0, 1, 0, 0]
    for subset in ([0, 1, 2], [2, 1, 0], [1, 2, 0]):
        assert number_attractors(cells, lanes, dict(links[k] for k in subset), order).tolist() == expected


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scene": "penetration", "starts": None, "parameters": {}, "grid": {"k3": [5e7, 6e7]}}, "with a drill"),
        ({"starts": ["drive"], "grid": {"gamma": [0.7, 0.75]}, "run": {"carry": "gamma"}}, "leave carry out"),
        ({"grid": None, "points": {"gamma": [0.7, 0.75]}, "starts": ["drive"]}, r"give a \[grid\] instead"),
    ],
)
def test_unsuitable_sweep_is_refused(change, message):
    tables = {name: x for name, x in (SWEEP | change).items() if x is not None}
    with pytest.raises(InputError, match=message):
        vj.attractors(tables, progress=False)


def test_picture_shows_shares(attractors):
    figure = vj.picture(attractors)
    assert "legend: most frequent regime, and share of all 640 lanes" in " ".join(note(figure).split())
    panel = next(axes for axes in figure.axes if axes.get_title("left") == "β = 0.4")
    number = int(present(attractors, beta=0.4, gamma=0.75).attractor[0])
    bands = [band.get_paths()[0].vertices for band in panel.collections if isinstance(band, PolyCollection)]
    share = attractors.share.sel(beta=0.4, attractor=number).values
    # stacked: the height of a band is its share
    for gamma, expected in zip(attractors.gamma.values, share, strict=True):
        assert np.ptp(bands[number][bands[number][:, 0] == gamma, 1]) == pytest.approx(100 * expected)


def test_maps_of_shares_and_named_starts(attractors):
    """The first map shows the share of strong single impacts, the others the regimes from the named starts."""
    grid = {"beta": np.linspace(0.2, 0.5, 6), "gamma": np.linspace(0.6, 0.9, 7)}
    shape, rng = (6, 7), np.random.default_rng(0)
    share = rng.dirichlet(np.ones(3), shape)
    velocity = np.broadcast_to([2.0, 1.0, 3.0], share.shape)  # the drive has a velocity of 1.5 m/s
    variables = {
        "share": share,
        "share_stderr": np.zeros(share.shape),
        "impact_velocity": velocity,
        "regime": np.broadcast_to(np.array([SINGLE_IMPACT, SINGLE_IMPACT, IRREGULAR], np.int8), share.shape),
    }
    dims = ("beta", "gamma", "attractor")
    ds = xr.Dataset({name: (dims, x) for name, x in variables.items()}, grid | {"attractor": range(3)})
    ds["regime"].attrs = attractors.regime.attrs
    ds["unassigned"] = (dims[:2], np.zeros(shape, int))
    ds["lane_attractor"] = ((*dims[:2], "start"), np.zeros((*shape, 4), int))
    ds["named_regime"] = ((*dims[:2], "named_start"), rng.integers(2, 7, (*shape, 2)).astype(np.int8))
    ds = ds.assign_coords(named_start=["drive", "stuck"])
    ds.attrs["parameters"] = json.dumps({"v": 1.5})
    figure = vj.picture(ds)
    maps = [axes for axes in figure.axes if any(isinstance(collection, QuadMesh) for collection in axes.collections)][
        :3
    ]
    drawn = [axes.collections[0].get_array().reshape(shape) for axes in maps]
    np.testing.assert_allclose(drawn[0], 100 * share[..., 0])
    for k, name in enumerate(("drive", "stuck")):
        np.testing.assert_array_equal(drawn[1 + k], ds.named_regime.isel(named_start=k))
        assert maps[1 + k].get_title() == f"from {name}"
    without_starts = vj.picture(ds.drop_dims("named_start"))
    maps = [axes for axes in without_starts.axes if axes.get_xlabel().startswith("gamma") and axes.collections]
    np.testing.assert_array_equal(maps[1].collections[0].get_array().reshape(shape), (share > 0).sum(axis=-1))


FEW = """
scene = "vibro-impact"
starts = ["drive", "stuck", "touching"]
[parameters]
delta = 0.005
[grid]
gamma = [0.7375, 0.75, 0.7625]
[run]
settle = 20.0
observe = 6.0
chunk = 4
"""


@pytest.mark.parametrize("by", ["links", "lanes"])
def test_finished_chunks_survive_an_interrupt(by, tmp_path, capsys, monkeypatch):
    """Interrupt the computation of the lanes, or that of the links between them."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("VIBROJAX_THREADS", "1")  # a second thread would lose its unfinished chunk
    (tmp_path / "few.toml").write_text(FEW)
    compute, computed = LaneRun.chunk, []

    def counted(self, inputs, report):
        if by == "lanes" and len(computed) == 2:
            raise KeyboardInterrupt
        computed.append(inputs)
        return compute(self, inputs, report)

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(LaneRun, "chunk", counted)
    if by == "links":
        monkeypatch.setattr("vibrojax.studies.attractor_groups.find_links", interrupted)
    assert main(["attractors", "few.toml", "-o", "out.nc", "--quiet"]) == 130
    assert "finished chunks are kept; to go on: vibrojax attractors few.toml -o out.nc" in capsys.readouterr().err
    kept = len(list((tmp_path / "out.nc.chunks").glob("*.zip")))
    assert kept == len(computed) == (2 if by == "lanes" else 3) and not (tmp_path / "out.nc").exists()
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    computed.clear()
    by = ""
    monkeypatch.setattr(LaneRun, "chunk", counted)
    assert main(["attractors", "few.toml", "-o", "out.nc", "--quiet"]) == 0
    assert len(computed) == 3 - kept and {path.name for path in tmp_path.iterdir()} == {"few.toml", "out.nc", "out.png"}
    expected = vj.attractors("few.toml", progress=False)
    stored = vj.open_dataset("out.nc")
    for name in expected.data_vars:
        np.testing.assert_array_equal(stored[name], expected[name])


def test_plane_of_starts_marks_orbits():
    """The marks are where the orbits cross the section, according to the stored returns of another sweep."""
    plane = {"plane": {"x1": np.linspace(-0.1, 0.1, 6).tolist(), "x2": np.linspace(-0.15, 0.05, 6).tolist()}}
    tables = {"scene": "vibro-impact", "parameters": {"delta": 0.005, **REGIMES_AT}, "starts": plane}
    attractors = vj.attractors(tables, progress=False)
    kept = vj.run_sweep(tables | {"starts": ["stuck"], "run": {"keep_returns": 1}}, progress=False)
    crossing = [1e3 * float(kept[f"return_{state}"].squeeze()) for state in ("x1", "x2")]
    circle = next(line for line in vj.picture(attractors).axes[0].lines if line.get_marker() == "o")
    np.testing.assert_allclose([circle.get_xdata()[0], circle.get_ydata()[0]], crossing, rtol=1e-6)
    assert np.isfinite(attractors.orbit_v2.values).tolist() == (attractors.cycles.values > 0).tolist()


def test_command(sweep, attractors, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    vj.write_dataset(sweep, tmp_path / "map.nc")
    assert main(["attractors", "map.nc"]) == 0
    printed = capsys.readouterr().out
    assert f"{attractors.sizes['attractor']} attractors; picture map-attractors.png" in printed
    assert f"{int(attractors.unassigned.sum())} of 640 lanes unassigned" in printed
    again = vj.open_dataset(tmp_path / "map-attractors.nc")
    for name in attractors.data_vars:
        np.testing.assert_array_equal(again[name], attractors[name])
    with monkeypatch.context() as changed:  # reuses the finished result
        changed.setattr(Attractors, "of_lanes", None)
        assert main(["attractors", "map.nc"]) == 0
    line = f"map-attractors.nc: is there already ({source()}); it is not computed again without --fresh"
    stored = [f"{line}; picture map-attractors.png", *printed.splitlines()[1:]]
    assert capsys.readouterr().out.splitlines() == stored
    with monkeypatch.context() as changed:
        changed.setattr(Attractors, "of_lanes", lambda *_: again)
        assert main(["attractors", "map.nc", "--fresh"]) == 0
    assert capsys.readouterr().out == printed
    assert main(["info", "map-attractors.nc"]) == 0
    assert "single-impact" in capsys.readouterr().out
    assert main(["info", "--json", "map-attractors.nc"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["attractors"]["shares"] == pytest.approx(attractors.share.mean(("beta", "gamma")).values.tolist())
    assert facts["regimes"] == {}
    assert main(["attractors", "map-attractors.nc"]) == 2
    assert "give the sweep" in capsys.readouterr().err
    assert main(["attractors", "map.nc", "-o", "map.txt"]) == 2
    capsys.readouterr()
    vj.write_dataset(xr.Dataset({"x": 1.0}), tmp_path / "other.nc")
    assert main(["attractors", "other.nc"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
