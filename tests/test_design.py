"""Test designs against finer maps, repeated simulations and slopes; also the chart, the command, and refusals."""

import json

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.measures.labels import REGIMES
from vibrojax.studies import design_chart as chart
from vibrojax.studies import design_evaluation as evaluation
from vibrojax.studies import design_orbit_search as orbit_search
from vibrojax.studies import design_robustness as robustness
from vibrojax.studies import design_run as run
from vibrojax.studies import design_search as search
from vibrojax.studies.design_analysis import Designs
from vibrojax.studies.design_chart import A4, chart_page
from vibrojax.studies.design_evaluation import Simulator, coarse_map, ranked
from vibrojax.studies.design_fronts import front_limits, without_limit
from vibrojax.studies.design_orbits import scene_parameters
from vibrojax.studies.design_robustness import DRAWS, MAX_CORNERS, box_samples, search_offsets
from vibrojax.studies.design_search import Candidate
from vibrojax.studies.design_spec import read_design

FORCE, WIDTH = 165e3, 0.004
RUN = {"settle": 25.0, "observe": 6.0}
DESIGN = {
    "scene": "vibro-impact",
    "maximise": "impact_power",
    "starts": ["stuck"],
    "parameters": {"beta": 0.4, "delta": 0.005},
    "vary": {"gamma": [0.7, 0.9]},
    "tolerance": {"gamma": WIDTH},
    "subject": {"regime": "single-impact", "peak_impact_force": {"most": FORCE}},
    "front": {"against": "peak_impact_force", "points": 3, "from": 0.99 * FORCE, "to": 1.01 * FORCE},
    "run": RUN,
}


def lanes(gamma, **parameters):
    fixed = DESIGN["parameters"] | parameters
    sweep = {"scene": "vibro-impact", "starts": ["stuck"], "parameters": fixed, "points": {"gamma": list(gamma)}}
    return vj.run_sweep(sweep | {"run": RUN | {"orbits": True}}, progress=False).isel(start=0)


@pytest.fixture(scope="module", autouse=True)
def few_seeds():
    """Search from two points, since the designs here have one parameter."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "SEEDS", 1)
        yield


@pytest.fixture(scope="module")
def designed(few_seeds):
    return vj.design(DESIGN, progress=False)


def test_no_cell_of_finer_map_is_better(designed):
    gamma = np.linspace(0.7, 0.9, 331)
    shifts = np.array([0.0, -WIDTH, WIDTH])
    ds = lanes((gamma[:, None] + shifts).ravel())
    held = (ds.regime.values == REGIMES.index("single-impact")) & (ds.peak_impact_force.values <= FORCE)
    power = ds.impact_power.values.reshape(-1, 3)[held.reshape(-1, 3).all(axis=1), 0]
    assert designed.objective[0] >= power.max() * (1 - 1e-3) and (designed.feasible == 1).all()
    assert (np.diff(designed.objective) <= 0).all()
    assert float(designed.objective[0]) >= float(designed.map_objective.max()) * 0.9


def test_draws_within_tolerance_satisfy_constraints(designed):
    rng = np.random.default_rng(5)
    for candidate in range(designed.sizes["candidate"]):
        ds = lanes(float(designed.gamma[candidate]) + WIDTH * rng.uniform(-1, 1, 100))
        assert (ds.regime == REGIMES.index("single-impact")).all() and float(ds.peak_impact_force.max()) <= FORCE
        worst = float(designed.peak_impact_force_worst[candidate])
        assert float(ds.peak_impact_force.max()) <= worst * (1 + 1e-6) <= FORCE
        assert float(ds.impact_power.min()) >= float(designed.objective_worst[candidate]) * (1 - 1e-6)


def test_worst_values_are_those_of_samples_and_irregular_motions_come_first(designed):
    assert (designed.irregular_share == 0).all()
    for name in ("objective_worst", "peak_impact_force_worst", "feasible", "slack"):
        assert "samples of the tolerances" in designed[name].attrs["long_name"], name
    first = Designs().summary(designed.assign(irregular_share=designed.irregular_share + 0.1))[0].lines[0]
    assert first.startswith("irregular motions within the tolerances (10 %")


def test_gradient_and_multiplier_are_slopes(designed):
    best, step = designed.isel(candidate=0), 1e-5
    ds = lanes(float(best.gamma) + step * np.array([1.0, -1.0]))
    assert float(best.gradient[0]) == pytest.approx(float(-ds.impact_power.diff("point")[0]) / (2 * step), rel=1e-5)
    assert best.binds.sel(limit="peak_impact_force most") == 1 and float(best.unexplained) < 1e-6
    below, same, above = designed.front_objective.values
    assert same == pytest.approx(float(best.objective), rel=3e-4)  # several times the smallest gain of the search
    relaxation = float(best.relaxation.sel(limit="peak_impact_force most"))
    assert above - below == pytest.approx(0.02 * FORCE * relaxation, rel=0.1)


def test_points_of_front_match_simulations(designed):
    assert (designed.front_feasible == 1).all() and (np.diff(designed.front_objective) > 0).all()
    ds = lanes(designed.front_gamma.values)
    np.testing.assert_allclose(ds.impact_power, designed.front_objective, rtol=1e-6)
    np.testing.assert_allclose(ds.peak_impact_force, designed.front_peak_impact_force, rtol=1e-6)
    [part] = Designs().summary(designed)
    assert "front against peak_impact_force: 3 of 3 points feasible" in part.lines[-1]
    assert list(part.facts["design"]["subject"]) == ["peak_impact_force"]
    for end in (-WIDTH, WIDTH):
        assert (lanes(designed.front_gamma.values + end).peak_impact_force.values <= designed.front_limit.values).all()


def test_front_spans_smallest_limit_of_map_to_optimum():
    spec = read_design({**DESIGN, "front": {"against": "peak_impact_force", "points": 3}})
    coarse = coarse_map(Simulator(spec))
    best = ranked(spec, coarse, without_limit(spec))[0]
    optimum = Candidate(coarse.unit[best], np.zeros((1, 1)), spec.constraints, 0.1, coarse.assessments[best])
    forces = [a.lanes.values["peak_impact_force"].max() for a in coarse.assessments if a.lanes.in_regime.all()]
    limits = front_limits(spec, coarse, [optimum])
    assert limits[0] == pytest.approx(0.98 * min(forces) + 0.02 * limits[-1])
    assert limits[-1] == forces[best] and np.ptp(np.diff(limits)) == pytest.approx(0, abs=1e-6)


def test_chart_fits_one_page(designed, monkeypatch):
    monkeypatch.setattr(chart, "CELLS", 8)
    ds = chart.charted(designed, read_design(DESIGN), progress=False)
    assert tuple(chart_page(ds).get_size_inches()) == A4
    compared = ds.isel(compared=1)
    assert float(compared.compared_impact_power) == pytest.approx(float(designed.objective[0]), rel=1e-3)
    assert float(compared.compared_gamma) == float(designed.gamma[0]) and float(compared.compared_beta) == 0.4
    robust = ds.chart_region == chart.REGIONS.index("robust")
    assert ds.chart_impact_energy.where(robust).isnull().equals(~robust.rename(None)) or robust.sum() == 0


def test_command_writes_dataset_and_picture(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(
        'scene = "vibro-impact"\nmaximise = "impact_power"\nstarts = ["stuck"]\nparameters = { delta = 0.005 }\n'
        'vary = { gamma = [0.7, 0.75] }\nsubject = { regime = "single-impact", peak_impact_force = { most = 1e6 } }\n'
        "run = { settle = 25, observe = 6 }\n"
    )
    assert main(["design", "mine.toml", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["design"]["at"]["gamma"] == pytest.approx(0.7) and "gamma least" in facts["design"]["binds"]
    assert (tmp_path / "mine-design.nc").is_file() and (tmp_path / "mine-design.png").is_file()
    assert main(["info", "mine-design.nc"]) == 0
    assert "binds: bound gamma least" in capsys.readouterr().out
    assert main(["design", "mine.toml"]) == 0
    assert "is there already" in capsys.readouterr().out


SINGLE = {"regime": "single-impact"}
PULSES = {"scene": "penetration", "maximise": "rate_of_penetration", "parameters": {"frequency": 10.0}, "starts": None}
WHOLE = {"share": {"least": 1.0}}
GRANITE = {"parameters": {"rock": "granite", "beta": 0.4, "delta": 0.005}}


@pytest.mark.parametrize(
    ("change", "line"),
    {
        "force": ({"subject": {"peak_impact_force": {"most": 1e3}}}, ": most 1000 N cannot be met; nearest: 16"),
        "regime": ({"subject": {"regime": "impact-free"}}, "nearest: 0 of 1 lane at gamma = 0.7 (single-impact)"),
        "other limits": (
            {"subject": {"impact_velocity": {"least": 8.0}, "peak_impact_force": {"most": 150e3}}},
            "impact_velocity: least 8 m s-1 cannot be met with the other limits; nearest: 2.",
        ),
        "tolerance": (
            {"subject": {"peak_impact_force": {"most": 1e3}}, "tolerance": {"delta": 1e-4}},
            "cannot be met within the tolerances; nearest: ",
        ),
        "share": (
            {"subject": {**WHOLE, "impact_energy": {"least": 5e3}}},
            "share: least 1, most 1 cannot be met; nearest: 0 at gamma = 0.7; there impact_energy is 3",
        ),
        "objective": (
            {"scene": "drilling", "maximise": "rate_of_penetration", "subject": SINGLE} | GRANITE,
            "design: maximise: rate_of_penetration is 0 wherever the requirements hold; it is 0 on the whole map",
        ),
        "limited objective": (
            PULSES | {"vary": {"force": [100e3, 300e3]}, "subject": {"mean_force": {"most": 5e3}}},
            "is 0 wherever the requirements hold; nearest above 0: 0.00",
        ),
        "pulses": (
            PULSES | {"vary": {"force": [50e3, 100e3]}, "subject": {"rate_of_penetration": {"least": 0.1}}},
            "rate_of_penetration: least 0.1 m s-1 cannot be met; nearest: 0 m s-1 at force = ",
        ),
    }.values(),
)  # fmt: skip
def test_infeasible_requirements_are_refused_in_one_line(change, line, monkeypatch):
    monkeypatch.setitem(evaluation.AXIS_POINTS, 1, 5)
    monkeypatch.setattr(search, "MAX_ITERATIONS", 0)
    monkeypatch.setattr(robustness, "MAX_REPAIRS", 0)
    table = {key: x for key, x in DESIGN.items() if key not in ("tolerance", "front")}
    table |= {"vary": {"gamma": [0.7, 0.72]}} | change
    if table["scene"] != "penetration":  # other tests cover the search from the points of the map
        monkeypatch.setattr(orbit_search, "orbit_path", lambda simulator, candidate: [])
    with pytest.raises(vj.InputError, match=r"^design: (subject|maximise)") as error:
        vj.design({key: x for key, x in table.items() if x is not None}, progress=False)
    assert line in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("change", "line"),
    {
        "vary": ({"vary": {}}, "vary: empty, so nothing varies"),
        "unbounded": ({"vary": {"gamma": [0.5, np.inf]}}, "vary.gamma[1]: is inf; a finite number is needed"),
        "order": ({"vary": {"gamma": [0.9, 0.5]}}, "is no interval; the least value comes first"),
        "both": ({"vary": {"beta": [0.3, 0.5]}}, "vary.beta: is in [parameters] as well"),
        "name": ({"vary": {"gama": [0.3, 0.5]}}, 'did you mean "gamma"?'),
        "ends": ({"subject": {"period": {"least": 2.0, "most": 1.0}}}, "contradictory: least 2 is above most 1"),
        "empty": ({"subject": {"period": {}}}, "subject.period: a table is not a limit"),
        "variable": ({"subject": {"perod": {"most": 1.0}}}, 'did you mean "period"?'),
        "regime": ({"subject": {"regime": "single"}}, 'subject.regime: "single" is unknown'),
        "share": ({"subject": {"share": {"least": 2.0}}}, "is not a range of shares"),
        "wide": ({"tolerance": {"gamma": 0.8}}, "tolerance.gamma: 0.8 is too wide"),
        "maximise": ({"maximise": "power"}, 'maximise: "power" is unknown'),
        "flag": ({"maximise": "regime"}, 'maximise: "regime" is unknown'),
        "twice": ({"vary": {"v": [1.0, 2.0], "rpm": [100.0, 200.0]}}, "design: vary.rpm: v is given as well"),
        "run": ({"run": {"settle": -1}}, "design: run.settle: is -1"),
        "front": ({"front": {"against": "impact_power"}}, "is what is maximised"),
        "key": ({"minimise": "period"}, "minimise: unknown key"),
    }.values(),
)
def test_bad_input_is_refused_in_one_line(change, line):
    with pytest.raises(vj.InputError) as error:
        read_design(DESIGN | change)
    assert line in str(error.value) and "\n" not in str(error.value)


def test_samples_of_tolerance_box():
    spec = read_design({**DESIGN, "tolerance": {name: 1e-3 for name in ("gamma", "beta", "v", "mu")}})
    samples, few = box_samples(spec), search_offsets(spec)
    assert samples.shape == (1 + 16 + DRAWS, 4) and (samples[0] == 0).all() and np.abs(samples).max() > 1
    assert len(few) <= 1 + MAX_CORNERS and (np.abs(few[1:]) == 1).all()
    columns = spec.columns(np.array([[0.5]]), np.array([[1.0, -1.0, 0.0, 0.0]]))
    assert columns["gamma"][0] == pytest.approx(0.8 + 1e-3) and columns["beta"][0] == pytest.approx(0.399)


def test_derivatives_of_substituted_parameters():
    """The substitutions are v = 2 pi rpm/60 bit_radius and k1 = m1 (2 pi f)²."""
    vary = {"rpm": [100.0, 200.0], "bit_frequency": [3.0, 5.0]}
    spec = read_design({**DESIGN, "vary": vary, "tolerance": {}, "parameters": {"bit_radius": 0.1}})
    values, chain = scene_parameters(spec, np.array([[0.5, 0.5]]))
    assert values["v"][0] == pytest.approx(2 * np.pi / 60 * 150 * 0.1)
    assert chain["v"][0].tolist() == pytest.approx([2 * np.pi / 60 * 0.1 * 100, 0.0])
    assert chain["k1"][0].tolist() == pytest.approx([0.0, 250 * 2 * (2 * np.pi) ** 2 * 4.0 * 2.0])
