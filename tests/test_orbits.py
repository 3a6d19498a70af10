"""Tests of periodic orbits: against reference cases, the exact integrator and closed forms, and what is refused."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from exact import orbits as exact
from random_orbits import in_upper_half

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.errors import InputError
from vibrojax.io.dataset import open_dataset
from vibrojax.lanes.run import LaneRun
from vibrojax.maps.read import read_sweep
from vibrojax.periodic.orbit_stages import OrbitStage
from vibrojax.periodic.orbits import orbits_of
from vibrojax.studies.sweep import orbit_lines

CASES = json.loads((Path(__file__).parent / "data" / "orbit_cases.json").read_text())["orbits"]
ORBITS = {"orbits": True}
FOUND, NOT_REPEATING, NOT_CONVERGED, NEAR_GRAZING, ANOTHER, REFUSED = range(6)
MEASURED = {"impact_velocity": 1e-8, "stick_fraction": 1e-7, "reverse_fraction": 1e-8}
SMALL = {"scene": "vibro-impact", "grid": {"beta": [0.3, 0.4, 0.5], "gamma": [0.7, 0.75]}}
SOON = {"settle": 2.0, "observe": 0.5}


def multipliers(point):
    return point.multiplier_abs.values * np.exp(1j * point.multiplier_arg.values)


@pytest.fixture(scope="module")
def cases():
    # With several attractors, a lane at the default error may end on another one than the exact motion.
    points = {name: [case["point"][name] for case in CASES] for name in CASES[0]["point"]}
    return vj.run_sweep({"scene": "vibro-impact", "points": points, "run": ORBITS | {"error": 1e-6}}, progress=False)


@pytest.mark.parametrize("index", range(len(CASES)))
def test_reference_cases(cases, index):
    point, expected = cases.isel(point=index), CASES[index]["expected"]
    assert point.orbit_reason == FOUND and point.stable == 1
    assert point.orbit_residual < 1e-10
    assert point.cycles == point.orbit_cycles == CASES[index]["cycles"]
    assert abs(point.period.item() - expected["period"]) < 1e-9
    values = in_upper_half([complex(*x) for x in expected["multipliers"]])
    np.testing.assert_allclose(multipliers(point), values, atol=1e-6)
    assert point.impacts == expected["impacts"]
    for name, tolerance in MEASURED.items():
        assert abs(point[name].item() - expected[name]) < tolerance, name
    section = [point[f"orbit_{name}"].item() for name in ("x1", "x2", "v2")]
    # The section is a fixed point of the exact map. One of its returns is the reference's, which is good to some 4e-9.
    parameters = {name: x for name, x in CASES[index]["point"].items() if name != "start"}
    _, states = exact.returns("vibro-impact", parameters, section, (point.cycles.item() + 0.1) * expected["period"])
    np.testing.assert_allclose(states[-1], section, rtol=0, atol=1e-11)
    assert np.abs(states - expected["section"]).max(axis=1).min() < 1e-8


def test_stored_variables_and_attributes(cases):
    assert cases.multiplier_abs.dims == cases.multiplier_arg.dims == ("point", "multiplier")
    assert cases.stable.dtype == np.int8 and cases.stable.attrs["flag_values"].tolist() == [-1, 0, 1]
    assert (np.diff(cases.multiplier_abs.values) <= 0).all()
    assert ((cases.multiplier_arg >= 0) & (cases.multiplier_arg <= np.pi)).all()
    about = json.loads(cases.attrs["orbits"])
    assert about["states"] == ["x1", "x2", "v2"] and 0 < about["grazing_limit"] < 1e-3


def test_sticking_makes_a_multiplier_zero(cases):
    sticks = cases.stick_fraction.values > 0
    assert sticks.any() and not sticks.all()
    assert (cases.multiplier_abs.values[sticks, -1] < 1e-12).all()
    assert (cases.multiplier_abs.values[~sticks, -1] > 1e-3).all()


# Other scenes


def test_multipliers_of_rock():
    points, soft = {"beta": [0.3, 0.4], "gamma": [0.7, 0.75]}, {"threshold": [2e4, 2e4]}
    drill, one_way, coupled = (
        vj.run_sweep({"scene": scene, "points": points | rock, "starts": ["stuck"], "run": ORBITS}, progress=False)
        for scene, rock in (("vibro-impact", {}), ("drilling", soft), ("coupled-drilling", soft))
    )
    for ds in (one_way, coupled):
        assert (ds.orbit_reason == FOUND).all() and (ds.stable == 1).all()
        assert (ds.rate_of_penetration > 0).all()
    # One-way rock does not act back: the orbits are those of the drill without it.
    np.testing.assert_allclose(one_way.multiplier_abs, drill.multiplier_abs, atol=1e-9)
    np.testing.assert_allclose(one_way.period, drill.period, rtol=1e-12)
    # Coupled rock acts back, yields, and comes to rest before the next impact.
    assert coupled.sizes["multiplier"] == 5
    assert (coupled.multiplier_abs.values[..., 3:] < 1e-9).all()
    assert (np.abs(coupled.multiplier_abs.values[..., :3] - drill.multiplier_abs.values) > 1e-3).any()


@pytest.mark.long
def test_coupled_rock_matches_exact_motion():
    """Compare the multipliers of five states with central differences.

    The rock is damped so lightly that it still moves at the next impact. It yields in the second lane, which makes a
    multiplier zero.
    """
    points = {
        "beta": [0.4626, 0.58],
        "gamma": [0.67, 0.6341],
        "v": [1.349, 1.351],
        "zeta": [0.02357, 0.03134],
        "threshold": [13.81e3, 26.87e3],
        "k3": [9.912e6, 26.69e6],
    }
    sweep = {"scene": "coupled-drilling", "points": points, "starts": ["stuck"], "unusual": True}
    ds = vj.run_sweep(sweep | {"run": ORBITS | {"settle": 100.0}}, progress=False).squeeze("start")
    assert (ds.orbit_reason == FOUND).all() and (ds.cycles == 1).all()
    for index in range(2):
        lane, parameters = ds.isel(point=index), {name: column[index] for name, column in points.items()}
        section = np.array([lane[f"orbit_{name}"].item() for name in ("x1", "x2", "v2", "compression", "v3")])
        span = lane.period.item()
        np.testing.assert_allclose(
            exact.returns(lane.scene, parameters, section, 1.01 * span)[1][0], section, atol=1e-10
        )
        values = in_upper_half(exact.multipliers(lane.scene, parameters, section, span))
        np.testing.assert_allclose(multipliers(lane), values, atol=1e-6)
        assert (lane.rate_of_penetration > 0) == (index > 0)
        assert (lane.multiplier_abs[-1] < 1e-12) == (index > 0)


# Replaced features, and refused orbits


class KeepReturns:
    """A stage that adds nothing, so that the last section crossings stay among the features."""

    attribute, described = "kept", {}

    def __call__(self, inputs, features):
        return {}


def chosen():
    cases = [CASES[0], CASES[4], CASES[8]]
    points = {name: [case["point"][name] for case in cases] for name in CASES[0]["point"]}
    return read_sweep({"scene": "vibro-impact", "points": points, "run": ORBITS})


@pytest.fixture(scope="module")
def lanes():
    """Return lanes that repeat after one and two returns, and their features, which tests damage."""
    sweep = chosen()
    inputs = sweep.inputs()
    return inputs, LaneRun(inputs, sweep.plan, stages=[KeepReturns()]).chunk(inputs).features


def find_orbits(lanes, **damage):
    inputs, features = lanes
    stage = OrbitStage(inputs.scene, inputs.run, inputs.start_names)
    return stage(inputs, {name: x.copy() for name, x in features.items()} | damage)


def test_orbits_match_lanes(lanes):
    orbits = find_orbits(lanes)
    assert (orbits["orbit_reason"] == FOUND).all()
    np.testing.assert_allclose(orbits["period"], lanes[1]["period"], rtol=1e-6)


def test_other_orbit_is_refused(lanes):
    more_impacts = find_orbits(lanes, impacts=lanes[1]["impacts"] + 1)
    assert (more_impacts["orbit_reason"] == ANOTHER).all() and (more_impacts["stable"] == -1).all()
    assert np.isnan(more_impacts["multiplier_abs"]).all()
    assert "period" not in more_impacts  # nothing is replaced
    wrong_cycles = find_orbits(lanes, cycles=np.ones(3))  # the third lane repeats after two returns
    assert wrong_cycles["orbit_reason"][:2].tolist() == [FOUND, FOUND] and wrong_cycles["orbit_reason"][2] != FOUND
    displaced = find_orbits(lanes, return_x2=lanes[1]["return_x2"] + 0.3)
    assert not (displaced["orbit_reason"] == FOUND).any()


def test_shorter_repeat_is_reported(lanes):
    features = lanes[1]
    twice = find_orbits(lanes, cycles=features["cycles"] * 2, impacts=features["impacts"] * 2)
    once = find_orbits(lanes)
    assert (twice["orbit_reason"] == FOUND).all()
    assert twice["orbit_cycles"].tolist() == [1, 1, 2]
    np.testing.assert_allclose(twice["multiplier_abs"], once["multiplier_abs"] ** 2, atol=1e-9)


def test_irregular_and_failed_lanes_have_no_orbit():
    irregular = vj.run_sweep(
        {"scene": "vibro-impact", "grid": {"beta": [0.95], "gamma": [0.35, 0.7]}, "run": ORBITS | SOON},
        progress=False,
    )
    assert (irregular.orbit_reason == NOT_REPEATING).all() and (irregular.stable == -1).all()
    stiff = SMALL | {"parameters": {"k0": 1e30}, "run": ORBITS | SOON, "unusual": True}
    refused = vj.run_sweep(stiff, progress=False)
    assert (refused.status != 0).all() and (refused.orbit_reason == REFUSED).all() and (refused.stable == -1).all()


def test_margin_is_bounded_by_slowest_impact(cases):
    """An impact that just touches is a graze: its velocity, relative to a typical one, bounds the margin."""
    sweep = read_sweep({"scene": "vibro-impact", "points": {"beta": [case["point"]["beta"] for case in CASES]}})
    typical = []
    for index in range(len(CASES)):
        p = {name: float(parameter.default) for name, parameter in sweep.system.parameters().items()}
        p |= {name: x for name, x in CASES[index]["point"].items() if name in p}
        c = sweep.system.constants({name: np.array([x]) for name, x in p.items()})
        rate = sweep.system.flight_rate(c)
        typical.append(float((sweep.system.speed_scale(c) * c.drill.period * rate)[0]))
    bound = cases.impact_velocity_min.values / np.array(typical)
    assert (cases.grazing_margin.values <= bound * (1 + 1e-3)).all()
    assert (cases.grazing_margin.values > 0).all()


# Commands and files


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("orbits")
    table = 'scene = "vibro-impact"\n[grid]\nbeta = [0.3, 0.4]\ngamma = [0.7]\n[run]\n'
    (folder / "with.toml").write_text(table + "orbits = true\n")
    (folder / "without.toml").write_text(table)
    assert main(["sweep", str(folder / "with.toml"), "-o", str(folder / "with.nc"), "--quiet"]) == 0
    assert main(["sweep", str(folder / "without.toml"), "-o", str(folder / "without.nc"), "--quiet"]) == 0
    return folder


@pytest.mark.parametrize("given", ["without.toml", "without.nc", "with.nc"])
def test_command_gives_result_of_sweep(folder, given, capsys):
    out = folder / f"of-{given.replace('.', '-')}.nc"
    assert main(["orbits", str(folder / given), "-o", str(out)]) == 0
    assert "4 found of 4 lanes that repeat: 4 stable, 0 unstable" in capsys.readouterr().out
    expected, ds = open_dataset(folder / "with.nc"), open_dataset(out)
    # The picture shows orbits; that of the sweep shows regimes.
    pictures = [folder / f"{name}.png" for name in ("orbits", "sweep")]
    for path, variables in zip(pictures, (["stable", "multiplier_abs", "regime"], None), strict=True):
        vj.save_picture(ds, path, variables)
    same = [path.read_bytes() == out.with_suffix(".png").read_bytes() for path in pictures]
    assert same == [True, False]
    assert set(ds.data_vars) == set(expected.data_vars)
    for name in expected.data_vars:
        np.testing.assert_array_equal(ds[name], expected[name], name)


def test_info_reports_orbits(folder, capsys):
    assert main(["sweep", str(folder / "with.nc")]) == 2
    assert "with.nc: is a dataset, not a sweep; vibrojax info " in capsys.readouterr().err
    assert main(["info", str(folder / "with.nc")]) == 0
    assert "4 found of 4 lanes that repeat" in capsys.readouterr().out
    assert main(["info", str(folder / "with.nc"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["orbits"] == {"reason": {"found": 4}, "stable": {"stable": 4}}
    assert orbit_lines(open_dataset(folder / "without.nc")) == []


def test_orbits_in_python(folder):
    without = open_dataset(folder / "without.nc")
    ds = vj.orbits(without, progress=False)
    assert (ds.orbit_reason == FOUND).all()
    assert vj.orbits(ds) is ds
    with pytest.raises(InputError, match="not the dataset of a sweep"):
        vj.orbits(vj.simulate("rotary", duration=1.0, progress=False), progress=False)
    changed = without.assign_attrs(identity=json.dumps(json.loads(without.attrs["identity"]) | {"scene": "rotary"}))
    with pytest.raises(InputError, match="has changed"):
        vj.orbits(changed, progress=False)


@pytest.mark.parametrize(
    ("sweep", "says"),
    [
        (
            {
                "scene": "penetration",
                "parameters": {"pulse_shape": "sweep", "sweep_start": 1.0, "sweep_rate": 1.0, "bias": 0.0},
                "points": {"force": [5e3]},
                "run": ORBITS,
            },
            "without a section or pulses",
        ),
        (SMALL | {"run": ORBITS | {"method": "smoothed"}}, "not located"),
        (SMALL | {"run": {"orbits": 1}}, "neither true nor false"),
    ],
)
def test_wrong_settings_are_refused_in_one_line(sweep, says):
    with pytest.raises(InputError, match=says) as error:
        vj.run_sweep(sweep, progress=False)
    assert "\n" not in str(error.value)


def test_other_features_do_not_change():
    """Orbits change only the features that they replace, and add their own variables."""
    sweep = chosen()
    without = vj.run_sweep(replace(sweep, run=replace(sweep.run, orbits=False)), progress=False)
    with_orbits = vj.run_sweep(sweep, progress=False)
    for name in (
        "regime",
        "cycles",
        "impacts",
        "returns",
        "settling_time",
        "error_estimate",
        "drift_estimate",
        "status",
    ):
        np.testing.assert_array_equal(without[name], with_orbits[name], name)
    for name in ("period", "impact_velocity", "bit_amplitude", "drive_power"):
        np.testing.assert_allclose(without[name], with_orbits[name], rtol=1e-4)
    assert not {"stable", "orbit_reason"} & set(without.data_vars)


def test_orbits_are_carried_to_other_parameters():
    """Predictions by slopes and by the last step lead to the orbit of a lane there, on which nothing else depends."""
    tables = {"scene": "vibro-impact", "parameters": {"delta": 0.005}, "grid": {"beta": [0.36, 0.4, 0.44]}}
    sweep = read_sweep(tables | {"starts": ["stuck"], "run": ORBITS})
    values = sweep.lane_values(0, sweep.lanes)[0]
    [found] = orbits_of(sweep.system, vj.run_sweep(sweep, progress=False), values)
    here, there = found.of([0, 1]), found.of([1, 2])
    for by in ((), ("beta",)):
        carried, arrived = here.carry_to(there.parameters, within=0.2, least=1 / 64, by=by)
        assert arrived.all() and carried.same_as(there).all() and not carried.same_as(here).any()
        np.testing.assert_allclose(carried.states, there.refined().states, rtol=0, atol=1e-10)
        np.testing.assert_array_equal(carried.lane, here.lane)
    alone, _ = here.of([1]).carry_to(there.of([1]).parameters, within=0.2, least=1 / 64, by=("beta",))
    np.testing.assert_array_equal(alone.states, carried.states[1:])


def test_doubled_orbit_is_carried_back_to_half_its_period():
    """The period of the orbit doubles between the two points, where it loses its stability."""
    tables = {"scene": "vibro-impact", "parameters": {"delta": 0.005, "beta": 0.4}, "grid": {"gamma": [0.35, 0.3625]}}
    sweep = read_sweep(tables | {"starts": ["drive"], "run": ORBITS})
    values = sweep.lane_values(0, sweep.lanes)[0]
    two, four = orbits_of(sweep.system, vj.run_sweep(sweep, progress=False), values)
    assert (two.states.shape[1], four.states.shape[1]) == (2, 4)
    how = {"within": 0.05, "first": 1 / 4, "least": 1 / 256, "accept": lambda orbits: orbits.stable}
    back, arrived = four.carry_to(two.parameters, **how)
    assert arrived.all() and back.minimal_cycles().tolist() == [2] and back.same_as(two).all()
    last, arrived = two.carry_to(four.parameters, **how)
    assert not arrived.any() and 0.35 < last.parameters["gamma"] < 0.3625 and last.stable.all()
