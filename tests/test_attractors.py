"""Attractors of a sweep: told apart, counted, and numbered alike from both ends of an axis."""

import json

import numpy as np
import pytest
import xarray as xr
from known_scenes import BeltOscillator
from matplotlib.collections import PolyCollection, QuadMesh
from read_off import note

import vibrojax as vj
from vibrojax.analyses.attractors.analysis import Attractors
from vibrojax.analyses.attractors.grouping import PointMotion, PointMotions, classify_motions, is_ambiguous, join_chains
from vibrojax.analyses.attractors.matching import number_attractors
from vibrojax.cli import main
from vibrojax.errors import InputError
from vibrojax.io.provenance import source
from vibrojax.io.variables import NATURES
from vibrojax.measures.labels import EQUILIBRIUM, FAILED, IRREGULAR, SINGLE_IMPACT, SUBHARMONIC
from vibrojax.sweep.engine.chunks import Chunks

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
def found(sweep):
    return vj.attractors(sweep, progress=False)


def present(found, **at):
    """The attractors at a point, by falling share."""
    here = found.sel(at)
    share = here.share.values
    return here.isel(attractor=np.argsort(-share, kind="stable")[: int((share > 0).sum())])


def test_what_is_in_it(sweep, found):
    assert found.share.dims == ("beta", "gamma", "attractor") and found.unassigned.dims == ("beta", "gamma")
    assert found.lane_attractor.dims == sweep.regime.dims and found.lane_attractor.dtype == np.int32
    assert found.attractor.values.tolist() == list(range(found.sizes["attractor"]))
    assert all({"units", "long_name"} <= set(found[name].attrs) for name in found.variables)
    np.testing.assert_array_equal(found.start_x2, sweep.start_x2)
    assert found.attrs["title"] == "Attractors: vibro-impact"


def test_every_start_is_counted(found):
    starts = found.sizes["start"]
    np.testing.assert_allclose(found.share.sum("attractor") + found.unassigned / starts, 1.0, atol=1e-12)
    np.testing.assert_array_equal((found.lane_attractor == -1).sum("start"), found.unassigned)
    for number in found.attractor.values:
        np.testing.assert_allclose((found.lane_attractor == number).mean("start"), found.share.sel(attractor=number))
    np.testing.assert_allclose(found.share_stderr**2, found.share * (1 - found.share) / starts, atol=1e-15)
    assert (np.diff(found.share.sum(("beta", "gamma")).values) <= 0).all()


@pytest.mark.parametrize("gamma", GAMMA[2:])
def test_the_strong_single_impact_and_the_rattle(sweep, found, gamma):
    """Which lane is in which follows from how hard it strikes: one is above 2 m/s, the other below 0.5."""
    here, lanes = present(found, beta=0.4, gamma=gamma), sweep.sel(beta=0.4, gamma=gamma)
    assert here.regime.values.tolist() == [SINGLE_IMPACT, IRREGULAR]
    assert here.cycles.values.tolist() == [1, 0] and here.impacts.values[0] == 1
    strong = lanes.impact_velocity.values > 1.0
    np.testing.assert_array_equal(found.lane_attractor.sel(beta=0.4, gamma=gamma) == here.attractor[0], strong)
    assert here.share.values[0] == strong.mean() and 0.8 < strong.mean() < 1
    velocity = here.impact_velocity.values
    assert velocity[0] > 2.0 and velocity[1] < 0.5
    assert velocity[0] == pytest.approx(float(lanes.impact_velocity.values[strong][0]), rel=1e-9)


def test_power_and_blows_are_those_of_the_lanes(sweep, found):
    at = {"beta": 0.4, "gamma": 0.75}
    lanes, strong = sweep.sel(at), int(found.impact_velocity.sel(at).argmax("attractor"))
    mine = lanes.where(found.lane_attractor.sel(at) == strong)
    for name in ("impact_power", "stick_slip_index", "blow_frequency"):
        assert float(found[name].sel(at)[strong]) == pytest.approx(float(mine[name].median()), rel=1e-6), name


def test_numbers_stay_along_the_axes(found):
    numbers = {
        (beta, gamma): present(found, beta=beta, gamma=gamma).attractor.values.tolist()
        for beta in found.beta.values
        for gamma in GAMMA[2:]
    }
    assert len(set(map(tuple, numbers.values()))) == 1
    # Over the wide gap in the axis none of those below is one of those above.
    below = set(np.flatnonzero((found.share.sel(gamma=GAMMA[:2]) > 0).any(("beta", "gamma"))))
    assert not below & set(next(iter(numbers.values())))


@pytest.mark.parametrize("axes", [("gamma",), ("beta",), ("beta", "gamma")])
def test_the_same_from_the_other_end_of_an_axis(found, axes):
    grid = {name: x[::-1] if name in axes else x for name, x in SWEEP["grid"].items()}
    other = vj.attractors(SWEEP | {"grid": grid}, progress=False)
    other = other.isel({name: slice(None, None, -1) for name in axes})
    for name in found.data_vars:
        np.testing.assert_array_equal(found[name], other[name])


def test_a_doubled_orbit_keeps_the_number(found):
    before, after = present(found, beta=0.4, gamma=0.35), present(found, beta=0.4, gamma=0.3625)
    assert (int(before.cycles[0]), int(after.cycles[0])) == (2, 4)
    assert before.regime.values[0] == after.regime.values[0] == SUBHARMONIC
    assert int(before.attractor[0]) == int(after.attractor[0])
    # By the family of the orbit before: it doubles between the two.
    start = {"start": "drive", "beta": 0.4, "delta": 0.005, "cycles": 2}
    family = vj.follow("vibro-impact", along="gamma", at=0.35, span=(0.35, 0.3625), progress=False, **start)
    kinds = family.special_kind.attrs["flag_meanings"].split()
    doubled = family.special_kind.values == kinds.index("period-doubling")
    assert ((family.special_value.values[doubled] > 0.35) & (family.special_value.values[doubled] < 0.3625)).any()


@pytest.mark.long
def test_shares_of_an_oscillator_on_a_belt():
    """Steady sliding and stick-slip of bSTAB's oscillator (Stender and Hoffmann 2021), whose shares are published."""
    speeds = {1.5: 0.3165, 1.55: 0.3636}
    starts = {"sample": "sobol", "count": 256, "seed": 1, "box": {"x1": [-2.0, 2.0], "v1": [-2.0, 0.0]}}
    tables = {"scene": BeltOscillator(), "starts": starts, "grid": {"v": list(speeds)}}
    found = vj.attractors(tables | {"run": {"settle": 400.0, "observe": 60.0}}, progress=False)
    assert found.sizes["attractor"] == 2 and found.unassigned.sum() == 0
    assert found.cycles.values.tolist() == [[1, 0], [1, 0]]  # 0 sticks and slips, 1 slides
    sliding = found.isel(attractor=1)
    assert (sliding.regime == EQUILIBRIUM).all()
    assert (np.abs(sliding.share - np.array(list(speeds.values()))) < 2 * sliding.share_stderr).all()


def test_what_the_scenes_own_starts_lead_to(sweep, found):
    """As in a sweep from these starts; they are no part of the shares."""
    own = vj.run_sweep(SWEEP | {"starts": ["drive", "stuck"]}, progress=False)
    assert found.named_start.values.tolist() == ["drive", "stuck"]
    np.testing.assert_array_equal(found.named_regime, own.regime)
    for gamma in GAMMA[2:]:
        here = present(found, beta=0.4, gamma=gamma)
        strong = (own.impact_velocity.sel(beta=0.4, gamma=gamma) > 1.0).values
        led = found.named_attractor.sel(beta=0.4, gamma=gamma).values
        assert led.tolist() == here.attractor.values[np.where(strong, 0, 1)].tolist()
    listed = vj.attractors(own, progress=False)
    assert "named_attractor" not in listed


def test_a_lane_without_a_stable_orbit_is_unassigned(sweep, found):
    lanes = {"beta": 1, "gamma": 3, "start": np.flatnonzero(sweep.regime.sel(REGIMES_AT) == SINGLE_IMPACT)[:3]}
    changed = sweep.copy(deep=True)
    changed.stable[lanes] = 0
    changed.regime[lanes | {"gamma": 2}] = FAILED
    other = vj.attractors(changed, progress=False)
    assert other.unassigned.sel(REGIMES_AT) == found.unassigned.sel(REGIMES_AT) + 3
    assert (other.lane_attractor[lanes] == -1).all() and (other.lane_attractor[lanes | {"gamma": 2}] == -1).all()
    assert (other.lane_attractor.values != found.lane_attractor.values).sum() == 6


def test_where_nothing_is_decided_all_is_unassigned(tmp_path):
    short = SWEEP | {"grid": {"gamma": [0.7, 0.75]}, "run": {"settle": 0.5, "observe": 1.0}}
    found = vj.attractors(short | {"starts": ["drive", "stuck"]}, progress=False)
    assert found.sizes["attractor"] == 0 and found.unassigned.values.tolist() == [2, 2]
    vj.save_picture(found, tmp_path / "none.png")
    assert "4 of 4 lanes unassigned (100.0 %)" in Attractors().summary(found)[0].lines


def irregular(**lanes):
    """A dataset of irregular lanes of one point."""
    count = len(next(iter(lanes.values())))
    fixed = {"regime": np.full(count, IRREGULAR), "stable": np.full(count, -1), "orbit_cycles": np.zeros(count)}
    orbits = {f"orbit_{name}": np.full(count, np.nan) for name in ("x1", "x2", "v2")}
    base = {"period": np.full(count, 0.2), "bit_amplitude": np.ones(count), "striker_amplitude": np.ones(count)}
    return xr.Dataset({name: ("start", np.array(x)) for name, x in (fixed | orbits | base | lanes).items()})


def groups(dataset, starts=None):
    """The motion of each lane, numbered in the order of the lanes."""
    of_lane = classify_motions(SCENE, dataset, {}, starts or dataset.sizes["start"]).of_lane.tolist()
    order = [number for number in dict.fromkeys(of_lane) if number >= 0]
    return [order.index(number) if number >= 0 else number for number in of_lane]


def test_irregular_lanes_by_their_statistics():
    """Within a quarter of the next: a chain of lanes is one motion, one without impacts is another."""
    assert groups(irregular(impact_velocity=[1.0, 1.4, 1.2, 2.0, np.nan, 2.2, 2.1])) == [0, 0, 0, 1, 2, 1, 1]


def test_few_irregular_lanes_near_many_cannot_be_told():
    """They may be the tail of the others' scatter; far from all others they are another motion."""
    assert groups(irregular(impact_velocity=[1.0, 1.1, 1.2, 2.0, 5.0])) == [0, 0, 0, -1, 1]


def test_an_irregular_motion_that_is_nowhere_of_several_lanes_is_doubtful():
    """Beside another of more lanes; alone at its point, or of several lanes at a neighbour, it is told."""
    motions = PointMotions(np.array([0, 0, 0, 1, 2, 3, 3, 3, 4]))
    for cell, regime in ((0, IRREGULAR), (0, IRREGULAR), (1, IRREGULAR), (2, IRREGULAR), (2, SINGLE_IMPACT)):
        motions.add(np.array([], int), PointMotion(cell, regime))
    assert is_ambiguous(motions, np.array([0, 1, 2, 3, 4])).tolist() == [False, True, False, False, False]
    assert is_ambiguous(motions, np.array([0, 3, 2, 3, 4])).tolist() == [False] * 5
    motions.remove(np.array([False, True, False, False, False]))
    assert motions.of_lane.tolist() == [0, 0, 0, -1, 1, 2, 2, 2, 3]
    assert [motion.cell for motion in motions.items] == [0, 1, 2, 2]


def test_lanes_of_different_points_are_different_motions():
    assert groups(irregular(impact_velocity=[1.0, 1.0, 1.0, 1.0]), 2) == [0, 0, 1, 1]


def test_irregular_lanes_by_their_exponents():
    """Where exponents are known, what was observed while lanes had not settled counts no more."""
    names = ["chaotic", "chaotic", "chaotic", "quasi-periodic", "not-settled", "chaotic"]
    lanes = {"nature": [NATURES.index(name) for name in names], "lyapunov": [1.0, 1.02, 2.0, 0.0, -0.1, 1.01]}
    lanes |= {"lyapunov_stderr": [0.01] * 6, "impact_velocity": [1.0, 3.0, 1.0, 1.0, 1.0, 9.0]}
    assert groups(irregular(**lanes)) == [0, 0, 1, 2, -1, 0]


def test_equilibria_of_a_point_are_one():
    dataset = irregular(impact_velocity=[1.0, np.nan, np.nan])
    dataset.regime[1:] = EQUILIBRIUM
    assert groups(dataset) == [0, 1, 1]


def test_chains():
    x = np.array([[0.0, 0.0], [0.9, 0.5], [1.8, 0.0], [0.0, 2.5], [5.0, 0.0]])
    assert join_chains(x).tolist() == [0, 0, 0, 1, 2]


def test_no_number_twice_at_a_point():
    """Around a cusp two motions of one point are linked by way of others; the farthest link is left out."""
    cells, lanes = [0, 0, 1, 2], [5, 4, 9, 9]
    links = [((0, 2), 0.1), ((2, 3), 0.2), ((1, 3), 0.3)]
    order = [(float(cell), float(k)) for k, cell in enumerate(cells)]
    expected = [0, 1, 0, 0]
    for some in ([0, 1, 2], [2, 1, 0], [1, 2, 0]):
        assert number_attractors(cells, lanes, dict(links[k] for k in some), order).tolist() == expected


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"scene": "penetration", "starts": None, "parameters": {}, "grid": {"k3": [5e7, 6e7]}}, "with a drill"),
        ({"starts": ["drive"], "grid": {"gamma": [0.7, 0.75]}, "run": {"carry": "gamma"}}, "leave carry out"),
        ({"grid": None, "points": {"gamma": [0.7, 0.75]}, "starts": ["drive"]}, r"give a \[grid\] instead"),
    ],
)
def test_what_has_no_attractors_is_refused(change, says):
    tables = {name: x for name, x in (SWEEP | change).items() if x is not None}
    with pytest.raises(InputError, match=says):
        vj.attractors(tables, progress=False)


def test_the_picture_shows_shares(found):
    figure = vj.picture(found)
    assert "legend: most frequent regime, and share of all 640 lanes" in " ".join(note(figure).split())
    panel = next(axes for axes in figure.axes if axes.get_title() == "β = 0.4")
    number = int(present(found, beta=0.4, gamma=0.75).attractor[0])
    bands = [band.get_paths()[0].vertices for band in panel.collections if isinstance(band, PolyCollection)]
    share = found.share.sel(beta=0.4, attractor=number).values
    for gamma, expected in zip(found.gamma.values, share, strict=True):  # stacked: a band is as high as its share
        assert np.ptp(bands[number][bands[number][:, 0] == gamma, 1]) == pytest.approx(100 * expected)


def test_the_share_map(found):
    """The strong single impact alone counts; beside it what the scene's own starts lead to."""
    grid = {"beta": np.linspace(0.2, 0.5, 6), "gamma": np.linspace(0.6, 0.9, 7)}
    shape, rng = (6, 7), np.random.default_rng(0)
    share = rng.dirichlet(np.ones(3), shape)
    velocity = np.broadcast_to([2.0, 1.0, 3.0], share.shape)  # the drive moves at 1.5 m/s
    held = {
        "share": share,
        "share_stderr": np.zeros(share.shape),
        "impact_velocity": velocity,
        "regime": np.broadcast_to(np.array([SINGLE_IMPACT, SINGLE_IMPACT, IRREGULAR], np.int8), share.shape),
    }
    dims = ("beta", "gamma", "attractor")
    ds = xr.Dataset({name: (dims, x) for name, x in held.items()}, grid | {"attractor": range(3)})
    ds["regime"].attrs = found.regime.attrs
    ds["unassigned"] = (dims[:2], np.zeros(shape, int))
    ds["lane_attractor"] = ((*dims[:2], "start"), np.zeros((*shape, 4), int))
    ds["named_regime"] = ((*dims[:2], "named_start"), rng.integers(2, 7, (*shape, 2)).astype(np.int8))
    ds = ds.assign_coords(named_start=["drive", "stuck"])
    ds.attrs["parameters"] = json.dumps({"v": 1.5})
    figure = vj.picture(ds)
    maps = [axes for axes in figure.axes if any(isinstance(one, QuadMesh) for one in axes.collections)][:3]
    drawn = [axes.collections[0].get_array().reshape(shape) for axes in maps]
    np.testing.assert_allclose(drawn[0], 100 * share[..., 0])
    for k, name in enumerate(("drive", "stuck")):
        np.testing.assert_array_equal(drawn[1 + k], ds.named_regime.isel(named_start=k))
        assert maps[1 + k].get_title() == f"from {name}"
    alone = vj.picture(ds.drop_dims("named_start"))
    maps = [axes for axes in alone.axes if axes.get_xlabel().startswith("gamma") and axes.collections]
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
def test_what_was_computed_outlives_an_interrupt(by, tmp_path, capsys, monkeypatch):
    """While lanes are computed, and while they are linked, which may take as long."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("VIBROJAX_THREADS", "1")  # two would lose the chunk that the other one computes
    (tmp_path / "few.toml").write_text(FEW)
    compute, computed = Chunks.compute, []

    def counted(self, index, *told):
        if by == "lanes" and len(computed) == 2:
            raise KeyboardInterrupt
        computed.append(index)
        return compute(self, index, *told)

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(Chunks, "compute", counted)
    if by == "links":
        monkeypatch.setattr("vibrojax.analyses.attractors.analysis.attractors_of", interrupted)
    assert main(["attractors", "few.toml", "-o", "out.nc", "--quiet"]) == 130
    assert "finished chunks are kept; to go on: vibrojax attractors few.toml -o out.nc" in capsys.readouterr().err
    kept = len(list((tmp_path / "out.nc.chunks").glob("*.shard")))
    assert kept == len(computed) == (2 if by == "lanes" else 3) and not (tmp_path / "out.nc").exists()
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    computed.clear()
    by = ""
    monkeypatch.setattr(Chunks, "compute", counted)
    assert main(["attractors", "few.toml", "-o", "out.nc", "--quiet"]) == 0
    assert len(computed) == 3 - kept and {path.name for path in tmp_path.iterdir()} == {"few.toml", "out.nc", "out.png"}
    expected = vj.attractors("few.toml", progress=False)
    found = vj.open_dataset("out.nc")
    for name in expected.data_vars:
        np.testing.assert_array_equal(found[name], expected[name])


def test_orbits_are_marked_in_a_plane_of_starts():
    """Where the section is passed, by the returns that another sweep keeps."""
    plane = {"plane": {"x1": np.linspace(-0.1, 0.1, 6).tolist(), "x2": np.linspace(-0.15, 0.05, 6).tolist()}}
    asked = {"scene": "vibro-impact", "parameters": {"delta": 0.005, **REGIMES_AT}, "starts": plane}
    found = vj.attractors(asked, progress=False)
    kept = vj.run_sweep(asked | {"starts": ["stuck"], "run": {"keep_returns": 1}}, progress=False)
    at = [1e3 * float(kept[f"return_{state}"].squeeze()) for state in ("x1", "x2")]
    circle = next(line for line in vj.picture(found).axes[0].lines if line.get_marker() == "o")
    np.testing.assert_allclose([circle.get_xdata()[0], circle.get_ydata()[0]], at, rtol=1e-6)
    assert np.isfinite(found.orbit_v2.values).tolist() == (found.cycles.values > 0).tolist()


def test_the_command(sweep, found, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    vj.write_dataset(sweep, tmp_path / "map.nc")
    assert main(["attractors", "map.nc"]) == 0
    said = capsys.readouterr().out
    assert f"{found.sizes['attractor']} attractors; picture map-attractors.png" in said
    assert f"{int(found.unassigned.sum())} of 640 lanes unassigned" in said
    again = vj.open_dataset(tmp_path / "map-attractors.nc")
    for name in found.data_vars:
        np.testing.assert_array_equal(again[name], found[name])
    with monkeypatch.context() as changed:  # the finished result is not computed again
        changed.setattr(Attractors, "of_lanes", None)
        assert main(["attractors", "map.nc"]) == 0
    line = f"map-attractors.nc: is there already ({source()}); it is not computed again without --fresh"
    stored = [f"{line}; picture map-attractors.png", *said.splitlines()[1:]]
    assert capsys.readouterr().out.splitlines() == stored
    with monkeypatch.context() as changed:
        changed.setattr(Attractors, "of_lanes", lambda *_: again)
        assert main(["attractors", "map.nc", "--fresh"]) == 0
    assert capsys.readouterr().out == said
    assert main(["info", "map-attractors.nc"]) == 0
    assert "single-impact" in capsys.readouterr().out
    assert main(["info", "--json", "map-attractors.nc"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["attractors"]["shares"] == pytest.approx(found.share.mean(("beta", "gamma")).values.tolist())
    assert facts["regimes"] == {}
    assert main(["attractors", "map-attractors.nc"]) == 2
    assert "give the sweep" in capsys.readouterr().err
    assert main(["attractors", "map.nc", "-o", "map.txt"]) == 2
    capsys.readouterr()
    vj.write_dataset(xr.Dataset({"x": 1.0}), tmp_path / "other.nc")
    assert main(["attractors", "other.nc"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
