"""Test designs against finer maps, repeated simulations and slopes; also the command, refusals and mutated designs."""

import json

import numpy as np
import pytest
from refusals import refusal

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.measures.labels import REGIMES
from vibrojax.settings.toml import bundled_names
from vibrojax.studies.design_requirements import Assessment, infeasibility, read_design

FORCE, WIDTH, WIDE = 165e3, 0.004, 0.03
RUN = {"settle": 15.0, "observe": 4.0}
DESIGN = {
    "scene": "vibro-impact",
    "maximise": "impact_power",
    "starts": ["stuck"],
    "parameters": {"beta": 0.4, "delta": 0.005},
    "vary": {"gamma": [0.71, 0.79]},
    "tolerance": {"gamma": WIDTH},
    "subject": {"regime": "single-impact", "peak_impact_force": {"most": FORCE}},
    "front": {"against": "peak_impact_force", "points": 3, "from": 0.99 * FORCE, "to": 1.01 * FORCE},
    "run": RUN,
}
FREE = {key: x for key, x in DESIGN.items() if key not in ("tolerance", "front")}


def lanes(**columns):
    fixed = {name: x for name, x in DESIGN["parameters"].items() if name not in columns}
    points = {name: np.ravel(x).tolist() for name, x in columns.items()}
    sweep = {"scene": "vibro-impact", "starts": ["stuck"], "parameters": fixed, "points": points}
    return vj.run_sweep(sweep | {"run": RUN | {"orbits": True}}, progress=False).isel(start=0)


@pytest.fixture(scope="module")
def designed():
    return vj.design(DESIGN, progress=False)


def test_no_cell_of_finer_map_is_better(designed):
    gamma = np.linspace(0.71, 0.79, 133)
    ds = lanes(gamma=gamma[:, None] + np.array([0.0, -WIDTH, WIDTH]))
    held = (ds.regime.values == REGIMES.index("single-impact")) & (ds.peak_impact_force.values <= FORCE)
    power = ds.impact_power.values.reshape(-1, 3)[held.reshape(-1, 3).all(axis=1), 0]
    assert designed.objective[0] >= power.max() * (1 - 1e-3) and (designed.feasible == 1).all()
    assert (np.diff(designed.objective) <= 0).all()


def test_draws_within_tolerance_keep_limits_and_worst_values(designed):
    rng = np.random.default_rng(5)
    for candidate in range(designed.sizes["candidate"]):
        best = designed.isel(candidate=candidate)
        ds = lanes(gamma=float(best.gamma) + WIDTH * rng.uniform(-1, 1, 100))
        assert (ds.regime == REGIMES.index("single-impact")).all() and best.irregular_share == 0
        assert float(ds.peak_impact_force.max()) <= float(best.peak_impact_force_worst) * (1 + 1e-6) <= FORCE
        assert float(ds.impact_power.min()) >= float(best.objective_worst) * (1 - 1e-6)


@pytest.mark.long
def test_robust_design_has_best_worst_case_of_fine_scan():
    """A sliding minimum over the tolerance gives the worst case at every point of the scan."""
    change = {"robust": True, "tolerance": {"gamma": WIDE}, "subject": {"regime": "single-impact"}}
    best = vj.design(FREE | change | {"vary": {"gamma": [0.64, 0.9]}}, progress=False).isel(candidate=0)
    ds = lanes(gamma=np.linspace(0.61, 0.93, 641))
    power = np.where(ds.regime.values == REGIMES.index("single-impact"), ds.impact_power.values, -np.inf)
    worst = np.lib.stride_tricks.sliding_window_view(power, 126).min(axis=1)  # the box of the draws is slightly larger
    assert float(best.objective_worst) >= worst.max() * (1 - 1e-3)
    own = lanes(gamma=float(best.gamma) + np.linspace(-WIDE, WIDE, 41)).impact_power.values
    assert own.min() >= float(best.objective_worst) * (1 - 1e-6) and float(best.objective) >= own.min()


def test_gradient_is_slope_of_lanes():
    """A natural frequency stands for the stiffness k1 = m1 (2 pi f)²."""
    change = {"vary": {"bit_frequency": [6.8, 7.4]}, "subject": {"regime": "single-impact"}}
    best = vj.design(FREE | change, progress=False).isel(candidate=0)
    step = 1e-5 * float(best.bit_frequency)
    power = lanes(bit_frequency=float(best.bit_frequency) + step * np.array([-1.0, 1.0])).impact_power.values
    assert float(best.gradient[0]) == pytest.approx(np.diff(power)[0] / (2 * step), rel=1e-4)
    assert best.bit_frequency.attrs["units"] == "Hz"


def test_limit_of_whole_numbers_on_front_is_not_tightened():
    """At most two impacts are two, and at most so much force is a little less."""
    for name, limit, is_tightened in (("impacts", 2.0, False), ("peak_impact_force", FORCE, True)):
        *_, last = read_design(DESIGN | {"front": {"against": name}}).within(limit).constraints
        assert (last.variable, last.limit, last.margin > 0) == (name, limit, is_tightened)


def test_points_of_front_match_simulations(designed):
    assert (designed.front_feasible == 1).all() and (np.diff(designed.front_objective) > 0).all()
    assert float(designed.front_objective[1]) == pytest.approx(float(designed.objective[0]), rel=3e-4)
    ds = lanes(gamma=designed.front_gamma)
    np.testing.assert_allclose(ds.impact_power, designed.front_objective, rtol=1e-6)
    np.testing.assert_allclose(ds.peak_impact_force, designed.front_peak_impact_force, rtol=1e-6)
    for end in (-WIDTH, WIDTH):
        assert (lanes(gamma=designed.front_gamma + end).peak_impact_force <= designed.front_limit.values).all()


BUNDLED = {"energy": 713.0, "rate-in-sandstone": 2.956e-3, "power-at-120-kn": 639.9}


@pytest.mark.long
@pytest.mark.parametrize("name", BUNDLED)
def test_bundled_designs_are_as_good_as_by_other_searches(name):
    """The values are those of a search by patterns and trust regions, which was independent of this one."""
    assert name in bundled_names("design")
    best = vj.design(name, progress=False).isel(candidate=0)
    assert best.feasible == 1 and float(best.objective) >= BUNDLED[name]


def test_refusal_says_whether_tolerances_or_a_start_are_in_the_way():
    """The force is above its limit at one end of the tolerance, or one start never reaches the regime."""
    spec = read_design(FREE | {"starts": ["stuck", "drive"], "tolerance": {"gamma": WIDTH}})
    single, free = (REGIMES.index(name) for name in ("single-impact", "impact-free"))

    def refused(force, regimes):
        shape = (2, 2)
        lanes = {"impact_power": np.ones(shape), "peak_impact_force": np.array(force), "regime": np.array(regimes)}
        point = Assessment(spec, np.array([0.5]), np.array([[0.0], [1.0]]), lanes)
        return str(infeasibility(spec, [Assessment(spec, point.unit, point.offsets[:1], point.nominal)], [point]))

    line = refused([[1e5, 1e5], [2e5, 1e5]], np.full((2, 2), single))
    assert "peak_impact_force: most 165000 N cannot be met within the tolerances, although it can be without" in line
    assert line.endswith("nearest: 200000 N at gamma = 0.754 in the tolerance box of gamma = 0.75")
    line = refused(np.full((2, 2), 1e5), np.tile([single, free], (2, 1)))
    assert "single-impact from every start cannot be met at any nominal point, even without the tolerances" in line
    assert line.endswith('1 of 2 lanes at gamma = 0.75 (impact-free); no nominal point is good from start "drive"')


NARROW = {"vary": {"gamma": [0.7, 0.72]}, "tolerance": {}, "front": None}


NEAREST = "impact-free from every start cannot be met; nearest: 0 of 1 lane at gamma = 0.7 (single-impact)"


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (NARROW | {"subject": {"regime": "impact-free"}}, NEAREST),
        ({"maximise": "power"}, "did you mean impact_power or drive_power?"),
        ({"maximise": "rate_of_penetration"}, "scenes with one: coupled-drilling, drilling, penetration"),
        ({"tolerance": {"gamma": 0.8}}, "tolerance.gamma: 0.8 is too wide"),
        ({"vary": {"bit_frequency": [6.8, 7.4]}, "tolerance": {"k1": 1.0}}, "k1: follows from other"),
        ({"front": {"against": "impact_power"}}, "is what is maximised"),
        ({"robust": True, "tolerance": {}}, "design: robust: there is no [tolerance] to be robust to"),
    ],
)
def test_bad_and_infeasible_designs_are_refused_in_one_line(change, line):
    given = {name: x for name, x in (DESIGN | change).items() if x is not None}
    text = refusal(vj.design, given, progress=False)
    assert text.startswith("design: ") and line in text


def test_command_writes_dataset_and_picture(here, capsys):
    (here / "mine.toml").write_text(
        'scene = "vibro-impact"\nmaximise = "impact_power"\nstarts = ["stuck"]\nparameters = { delta = 0.005 }\n'
        'vary = { gamma = [0.7, 0.75] }\nsubject = { regime = "single-impact", peak_impact_force = { most = 1e6 } }\n'
        "run = { settle = 25, observe = 6 }\nrobust = true\ntolerance = { gamma = 1e-4 }\n"
    )
    assert main(["design", "mine.toml", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["design"]["at"]["gamma"] == pytest.approx(0.7)
    assert list(facts["design"]["subject"]) == ["peak_impact_force"]
    assert (here / "mine-design.png").is_file() and main(["info", "mine-design.nc"]) == 0
