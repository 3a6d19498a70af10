"""Tests of continuation against reference cases, the exact motion, and the theory of folds and doublings; a command."""

import json
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pint
import pytest
from exact import orbits
from refusals import command_refusal, refusal
from scipy.linalg import expm
from scipy.optimize import brentq
from systems import special_values

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.io.kinds import SPECIAL_KINDS
from vibrojax.studies.family_analysis import family_lines

ENDS = json.loads((Path(__file__).parent / "data" / "orbit_cases.json").read_text())["ends_of_families"]
STATES = ("orbit_x1", "orbit_x2", "orbit_v2")


def follow_drill(**more):
    return vj.follow(**({"scene": "vibro-impact", "progress": False} | more))


@pytest.fixture(scope="module")
def family():
    """Return a family over gamma, from the usual single impact down to its doubling and on to both ends."""
    return follow_drill(along="gamma", at=0.75, span=(0.3, 1.6), start="stuck", beta=0.4, cycles=2)


def branch_of(family, number):
    return family.isel(point=family.branch.values == number)


@pytest.mark.parametrize(("case", "kind"), [(ENDS[0], "torus"), (ENDS[1], "fold")])
def test_ends_of_families(case, kind):
    """The reference is accurate to about 1e-8."""
    span = tuple(sorted((case["at"], case["end_value"] + 0.1 * np.sign(case["end_value"] - case["at"]))))
    begin = {name: case[name] for name in ("along", "at", "start")} | case["fixed"]
    family = follow_drill(**begin, span=span, cycles=1)
    values = special_values(family, kind)
    assert np.abs(values - case["end_value"]).min() < 3e-9
    index = np.abs(family[case["along"]].values - case["end_value"]).argmin()
    exact = abs(complex(*case["largest_multiplier"]))
    # At the reference's own end the fold's multiplier differs from 1 by 3e-6: it follows the root of the distance.
    assert abs(family.multiplier_abs.values[index, 0] - exact) < 1e-5


DOUBLING = 0.392500037


@pytest.mark.parametrize("gamma", [0.33, DOUBLING, 1.5])
def test_orbits_match_exact_motion(family, gamma):
    branch = branch_of(family, 0)
    point = branch.isel(point=np.abs(branch.gamma.values - gamma).argmin())
    parameters = {"beta": 0.4, "gamma": float(point.gamma)}
    section = np.array([float(point[name]) for name in STATES])
    period = float(point.period)
    _, states = orbits.returns("vibro-impact", parameters, section, 1.01 * period)
    np.testing.assert_allclose(states[0], section, atol=1e-9)
    values = orbits.multipliers("vibro-impact", parameters, section, period)
    exact = np.abs(values)
    np.testing.assert_allclose(point.multiplier_abs.values, exact, atol=1e-6 * max(1, exact[0]))
    if gamma == DOUBLING:
        assert special_values(family, "period-doubling") == pytest.approx([gamma], abs=1e-8)
        assert abs(values + 1).min() < 1e-5
    else:
        assert (point.stable == 1) == (exact[0] < 1)


def test_stability_changes_only_at_special_points(family):
    branch, kinds = branch_of(family, 0), ("fold", "period-doubling", "torus", "grazing", "stick")
    assert {0, 1} <= set(branch.stable.values.tolist())
    bifurcations = np.concatenate([special_values(family, kind) for kind in kinds])
    for k in np.flatnonzero(np.diff(branch.stable.values)):
        low, high = sorted(branch.gamma.values[k : k + 2])
        assert ((bifurcations >= low - 1e-9) & (bifurcations <= high + 1e-9)).any()


def eigenvalue(gamma, beta, v, m1=250.0, k1=156250.0, c2=250.0, g=9.81, mu=0.4, v_cr=3.0):
    """Return the rightmost eigenvalue of steady sliding under Stribeck's law, from its characteristic polynomial."""
    m2, k2 = beta * m1, beta * gamma**2 * k1
    slope = m1 * g * mu * (-1 / v_cr + v**2 / v_cr**3)
    roots = np.roots(np.polysub(np.polymul([m1, slope, k1 + k2], [m2, c2, k2]), [k2**2]))
    return max(roots, key=lambda root: (root.real, root.imag))


def test_branch_ends_at_hopf_point_where_sliding_becomes_stable():
    along, span, fixed = "gamma", (0.89, 1.0), {"beta": 0.4, "v": 1.5}
    family = vj.follow("rotary", along=along, at=0.9, span=span, start="stuck", settle=60.0, progress=False, **fixed)
    [hopf] = special_values(family, "hopf")
    exact = brentq(lambda value: eigenvalue(**{along: value}, **fixed).real, *span, xtol=1e-14)
    assert hopf == pytest.approx(exact, abs=1e-12)
    assert len(special_values(family, "end")) == 1
    point = family.isel(point=family[along].values == hopf).squeeze("point")
    period = 2 * np.pi / eigenvalue(**{along: hopf}, **fixed).imag
    assert point.period.item() == pytest.approx(period, rel=1e-12)
    assert (point.impacts.item() if "impacts" in point else 0, point.bit_amplitude.item()) == (0, 0)
    # The largest multiplier belongs to the amplitude; the others are those of the neighbouring orbit.
    before = family.isel(point=np.argsort(np.abs(family[along].values - hopf))[1])
    np.testing.assert_allclose(point.multiplier_abs, before.multiplier_abs, atol=1e-3)
    assert point.multiplier_abs.values[0] == pytest.approx(1, abs=1e-12)


def test_doubled_branch_leaves_as_root_of_distance(family):
    [doubling] = special_values(family, "period-doubling")
    single, double = branch_of(family, 0), branch_of(family, 1)
    assert (double.cycles == 2).all() and double.impacts[0] == 2
    # The branch begins with two rounds of the single orbit: multipliers are squared, and -1 becomes 1.
    begin = np.abs(single.gamma.values - doubling).argmin()
    np.testing.assert_allclose(double.multiplier_abs[0], single.multiplier_abs[begin] ** 2, atol=1e-6)
    distance = double.gamma.values - doubling
    near = np.flatnonzero((np.abs(distance) > 1e-7) & (np.abs(distance) < 2e-3))
    order = np.argsort(single.gamma.values)
    on_single = np.interp(double.gamma.values[near], single.gamma.values[order], single.orbit_x1.values[order])
    ratio = (double.orbit_x1.values[near] - on_single) / np.sqrt(np.abs(distance[near]))
    assert len(near) >= 3
    np.testing.assert_allclose(ratio, ratio[0], rtol=0.1)
    np.testing.assert_allclose(double.period.values[0], single.period.values[begin], rtol=1e-9)


def test_branch_that_doubles_at_both_ends_is_listed_once():
    settings = {"start": "stuck", "beta": 0.268, "v": 0.82, "delta": 0.005}
    family = follow_drill(along="gamma", at=0.72, span=(0.32, 0.73), cycles=2, **settings)
    doublings = special_values(family, "period-doubling")
    assert len(doublings) == 2 and set(family.branch.values.tolist()) == {0, 1}
    [end] = special_values(family, "end", branch=1)
    branch = branch_of(family, 1)
    ends = {float(branch.gamma[0]), float(branch.gamma[-1])}
    # The branch begins and ends at the doublings themselves, and nowhere near them.
    assert ends == set(doublings.tolist()) and end in ends


def test_wrong_input_is_refused():
    """The command refuses the rest."""
    for more, says in (
        ({"span": 0.5}, "span"),
        ({"at": 0.75 * pint.Unit("mm")}, "a unit of 1 is needed"),
        ({"beta": []}, "empty"),
        ({"beta": 0.3, "at": 0.3}, "irregular"),
        ({"scene": "drilling", "along": "threshold", "at": 5e4, "span": (2e4, 1e5)}, "no orbit changes along it"),
    ):
        assert says in refusal(follow_drill, **({"along": "gamma", "at": 0.75, "span": (0.3, 1.6)} | more))


def test_rock_begins_to_yield_at_force_of_linear_response():
    """Until it yields, rock and bit are linear: the greatest compression is proportional to the force."""
    width, frequency, m1, k3, zeta, threshold = 4e-3, 20.0, 250.0, 3e8, 1.1, 150e3
    kn = pint.UnitRegistry().kN
    family = vj.follow("penetration", along="force", at=100 * kn, span=(1e5, 250 * kn), zeta=zeta, progress=False)
    w0 = np.sqrt(k3 / m1)
    field = np.array([[0.0, 1.0], [-(w0**2), -2 * zeta * w0]])
    still = np.array([1 / k3, 0.0])  # under 1 N
    within, after = expm(field * width), expm(field * (1 / frequency - width))
    # The state at the beginning of a pulse recurs after the pulse and the pause.
    begin = np.linalg.solve(np.eye(2) - after @ within, after @ (still - within @ still))
    end = still + within @ (begin - still)
    peak = max((expm(field * t) @ end)[0] for t in np.linspace(0, 4e-3, 4001))
    [onset] = special_values(family, "grazing")
    assert abs(onset / (threshold / k3 / peak) - 1) < 1e-7
    below = family.force.values < onset - 1.0
    assert (family.rate_of_penetration.values[below] == 0).all()
    assert (family.rate_of_penetration.values[family.force.values > onset + 1.0] > 0).all()
    [note] = family.special_note.values[family.special_kind.values == SPECIAL_KINDS.index("grazing")]
    assert "rock" in note


def test_lanes_near_orbits_stay_only_if_orbits_are_stable():
    """The sweep knows nothing of multipliers or special points."""
    fixed = {"beta": 0.42898650763, "v": 0.98543234207, "delta": -0.005}
    family = follow_drill(along="gamma", at=0.7325685905, span=(0.3, 1.2), start="drive", cycles=1, **fixed)
    hyperbolic = family.isel(point=np.abs(family.multiplier_abs[:, 0].values - 1) > 0.03)
    count = hyperbolic.sizes["point"]
    points = {name: [value] * count for name, value in fixed.items()} | {"gamma": hyperbolic.gamma.values}
    points |= {f"start_{name}": hyperbolic[f"orbit_{name}"].values for name in ("x1", "x2", "v2")}
    points |= {"start_v1": [0.0] * count, "start_x2": points["start_x2"] + 1e-6}
    run = {"settle": 120.0, "end_early": False}
    lanes = vj.run_sweep({"scene": "vibro-impact", "points": points, "run": run, "unusual": True}, progress=False)
    stays = np.abs(lanes.period.values / hyperbolic.period.values - 1) < 1e-6
    stays &= (lanes.cycles.values == 1) & (lanes.impacts.values == hyperbolic.impacts.values)
    np.testing.assert_array_equal(stays, hyperbolic.stable.values == 1)
    assert stays.any()


ARGUMENTS = ("along=gamma", "at=0.45", "from=0.36", "to=0.5", "beta=0.4", "settle=30", "cycles=2")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with a family, the output of its command, and two families over a second parameter."""
    folder = tmp_path_factory.mktemp("follow")
    with (folder / "said.txt").open("w") as output, redirect_stdout(output):
        assert main(["follow", "vibro-impact", *ARGUMENTS, "-o", str(folder / "one.nc")]) == 0
    rest = [word for word in ARGUMENTS if "beta" not in word]
    assert main(["follow", "vibro-impact", *rest, "beta=0.38,0.4", "-o", str(folder / "two.nc"), "--quiet"]) == 0
    return folder


@pytest.fixture
def here(folder, monkeypatch):
    monkeypatch.chdir(folder)
    return folder


def test_command_writes_result_of_python(here):
    settings = {"along": "gamma", "at": 0.45, "span": (0.36, 0.5), "beta": 0.4, "settle": 30.0, "cycles": 2}
    expected, written = vj.follow("vibro-impact", progress=False, **settings), vj.open_dataset("one.nc")
    assert (here / "one.png").exists()
    assert set(written.variables) == set(expected.variables)
    for name in expected.variables:
        np.testing.assert_array_equal(written[name], expected[name], name)
    assert written.attrs["start"] == "drive" and written.attrs["span"].tolist() == [0.36, 0.5]
    lines = (here / "said.txt").read_text().splitlines()
    assert "on 2 branches over gamma 0.36 to 0.5" in lines[0]
    (doubling,) = (line for line in lines if line.startswith("period-doubling"))
    assert "1 on branch 0 at gamma 0.392500037; 2 on other branches" in doubling
    assert "branch 0 is stable for gamma 0.392500037 (period-doubling) to 0.5 (end)" in lines
    assert lines[-1] == f"{here}/one.nc; picture {here}/one.png"


def test_json_output(here, capsys):
    assert main(["follow", "vibro-impact", *ARGUMENTS, "-o", "one.nc", "--json"]) == 0  # the same result again
    facts = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert facts["scene"] == "vibro-impact" and facts["start"] == "drive" and facts["parameters"]["beta"] == 0.4
    assert (facts["dataset"], facts["picture"]) == ("one.nc", "one.png") and facts["branches"] == 2


def test_list_gives_as_many_families(here, capsys):
    two, single = vj.open_dataset("two.nc"), vj.open_dataset("one.nc")
    assert two["beta"].values.tolist() == [0.38, 0.4] and two["beta"].dims == ("family",)
    same = two.isel(point=np.flatnonzero(two["point_family"] == 1))
    np.testing.assert_allclose(same["gamma"], single["gamma"], rtol=1e-9)
    np.testing.assert_allclose(same["impact_velocity"], single["impact_velocity"], rtol=1e-7)
    text = "\n".join(family_lines(two))
    assert text.startswith("2 families, ") and "beta 0.4: 0.392500037 (period-doubling) to 0.5 (end)" in text
    assert main(["plot", "two.nc", "--where", "beta=0.4", "-o", "second.png"]) == 0


def test_family_is_drawn_over_returns_of_sweep(here, capsys):
    run = {"settle": 5.0, "observe": 3.0, "keep_returns": 6}
    sweep = {"scene": "vibro-impact", "grid": {"gamma": np.linspace(0.38, 0.48, 5).tolist()}, "run": run}
    vj.write_dataset(vj.run_sweep(sweep | {"parameters": {"beta": 0.4}}, progress=False), "returns.nc")
    (here / "returns.png").write_bytes(b"the picture of the sweep")
    assert main(["plot", "returns.nc", "--over", "one.nc"]) == 0
    assert (here / "returns-over-one.png").exists() and capsys.readouterr().out == "returns-over-one.png\n"
    assert (here / "returns.png").read_bytes() == b"the picture of the sweep"
    vj.write_dataset(vj.run_sweep(sweep | {"parameters": {"beta": 0.5}}, progress=False), "other.nc")
    for file, over, line in (
        ("other.nc", "one.nc", "the families are of beta = 0.4, the returns of 0.5"),
        ("returns.nc", "no.nc", "no such file"),
        ("one.nc", "one.nc", "laid over the returns of a sweep"),
    ):
        assert line in command_refusal(capsys, "plot", file, "--over", over)


BASE = {"along": "gamma", "at": "0.45", "from": "0.36", "to": "0.5"}
WRONG = {
    "vibro-impact along= at=": "along and at missing; write vibrojax follow SCENE along=NAME at=VALUE",
    "penetration": 'along: "gamma" is not a parameter of the scene; choose from',
    "vibro-impact along=rpm": '"rpm" is not a parameter of the scene; v follows from rpm and bit_radius',
    # gamma = 2 pi f sqrt(m1/k1), with m1 = 250 and k1 = 156250: 2 pi 3/25
    "rotary along=striker_frequency at=3.0": "give gamma, and follow along gamma; 3 Hz is gamma=0.753982",
    "vibro-impact along=k1 striker_frequency=3": "fixes gamma only at one k1, and k1 varies along the family",
    "vibro-impact gamma=0.4": "gamma: is the parameter of the continuation; say where it begins by at=0.4",
    "vibro-impact at=0.7": "at: 0.7 is not between from = 0.36 and to = 0.5",
    "vibro-impact beta=0.3,x": 'beta[1]: "x" is text',
    "vibro-impact beta=0.3,0.4 v=1,1.1,1.2": "lists of different lengths (beta 2, v 3)",
}


@pytest.mark.parametrize("words", WRONG)
def test_wrong_input_is_refused_in_one_line(here, capsys, words):
    """An argument without a value is left out."""
    scene, *changes = words.split()
    arguments = BASE | dict(change.split("=") for change in changes)
    given = [f"{name}={value}" for name, value in arguments.items() if value]
    line = command_refusal(capsys, "follow", scene, *given, "-o", "wrong.nc")
    assert line.startswith("follow: ") and WRONG[words] in line and not (here / "wrong.nc").exists()
