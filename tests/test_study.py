"""Test studies: Sobol indices and factorial effects against closed forms, rules for lanes, the command and refusals."""

import json
from itertools import combinations

import numpy as np
import pytest
import xarray as xr

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.errors import InputError
from vibrojax.maps.bounds import MAX_VARIED
from vibrojax.settings.toml import read_source
from vibrojax.studies import effects_sampling as samples
from vibrojax.studies.effects import SCHEMA, Studies, read_study, study_of, values_of
from vibrojax.studies.effects_sampling import (
    REASONS,
    Sampling,
    factorial_effects,
    factorial_signs,
    indices,
)

STUDY = {
    "scene": "vibro-impact",
    "of": ["impact_energy", "share_single_impact"],
    "starts": ["stuck"],
    "samples": 16,
    "vary": {"v": [1.2, 1.8], "gamma": [0.7, 0.75], "c2": [240.0, 260.0]},
    "parameters": {"delta": 0.005},
    "run": {"settle": 10.0, "observe": 4.0, "end_early": False},
}


def ishigami(x, a=7.0, b=0.1):
    return np.sin(x[:, 0]) + a * np.sin(x[:, 1]) ** 2 + b * x[:, 2] ** 4 * np.sin(x[:, 0])


@pytest.fixture(scope="module")
def finished_study():
    """Return the specification, the lanes and the dataset of a study of a drill."""
    spec = read_study(STUDY)
    lanes = vj.run_sweep(spec.sweep, progress=False)
    return spec, lanes, study_of(spec, lanes)


def test_indices_of_ishigami_function():
    """The variance is a²/8 + b pi⁴/5 + b² pi⁸/18 + 1/2 (Ishigami and Homma 1990)."""
    a, b, pi = 7.0, 0.1, np.pi
    own = Sampling(dict.fromkeys("abc", (-pi, pi)), 4096, seed=3)
    results = indices(own, ishigami(own.points(), a, b))
    variance = a**2 / 8 + b * pi**4 / 5 + b**2 * pi**8 / 18 + 0.5
    first = np.array([(1 + b * pi**4 / 5) ** 2 / 2, a**2 / 8, 0.0]) / variance
    pair = 8 * b**2 * pi**8 / 225 / variance
    np.testing.assert_allclose(results["first_order"], first, atol=0.02)
    np.testing.assert_allclose(results["total_order"], first + [pair, 0.0, pair], atol=0.02)
    second = np.array([[np.nan, 0, pair], [0, np.nan, 0], [pair, 0, np.nan]])
    np.testing.assert_allclose(results["second_order"], second, atol=0.04)
    for name, exact in (("first_order", first), ("total_order", first + [pair, 0.0, pair])):
        assert (np.abs(results[name] - exact) <= 2 * results[f"{name}_conf"]).all() and (
            results[f"{name}_conf"] < 0.1
        ).all()
    np.testing.assert_allclose([results["mean"], results["std"] ** 2], [a / 2, variance], rtol=0.02)


@pytest.mark.parametrize("parameters", range(1, MAX_VARIED + 1))
def test_effects_of_design_are_not_confounded(parameters):
    """Main effects and interactions are orthogonal, and those of a bilinear function are recovered exactly."""
    signs, pairs = factorial_signs(parameters), list(combinations(range(parameters), 2))
    columns = np.column_stack([np.ones(len(signs)), *signs.T, *(signs[:, i] * signs[:, j] for i, j in pairs)])
    np.testing.assert_allclose(columns.T @ columns, len(signs) * np.eye(columns.shape[1]))
    if parameters > 1:
        values = 3.0 + 0.5 * signs[:, 0] + 2.0 * signs[:, 1] - 0.25 * signs[:, 0] * signs[:, 1]
        values[-1] = np.nan if parameters > 2 else values[-1]
        effect, interaction, left_out = factorial_effects(signs, values)
        np.testing.assert_allclose(effect, [1.0, 4.0, *np.zeros(parameters - 2)], atol=1e-12)
        assert interaction[0, 1] == pytest.approx(-0.5) and left_out == (parameters > 2)


def test_samples_with_missing_value_are_left_out_entirely():
    """The indices use the remaining base samples alone. Too few samples or a constant quantity give no indices."""
    own = Sampling({"a": (0.0, 1.0), "b": (0.0, 2.0)}, 64)
    values = own.points() @ [1.0, 1.0]
    complete = indices(own, values)
    np.testing.assert_allclose(complete["total_order"], [0.2, 0.8], atol=0.05)
    incomplete = values.copy()
    incomplete[own.group * 3 + 1] = np.nan
    results = indices(own, incomplete)
    assert results["left_out"] == 1 and results["corners_left_out"] == 0 and np.isfinite(results["total_order"]).all()
    for x, reason in ((np.full(len(values), np.nan), "too-few-samples"), (np.full(len(values), 2.0), "constant")):
        results = indices(own, x)
        assert REASONS[int(results["sobol_reason"])] == reason and np.isnan(results["first_order"]).all()


def test_study_summarises_its_lanes(finished_study):
    _, lanes, ds = finished_study
    size = len(STUDY["vary"])
    assert lanes.sizes["point"] == STUDY["samples"] * (2 * size + 2) + 2**size
    assert ds.attrs["kind"] == "study" and ds.first_order.dims == ("of", "parameter")
    assert ds.second_order.dims == ds.interaction.dims == ("of", "parameter", "other")
    assert {str(name) for name in ds.data_vars} == set(SCHEMA)
    corners = lanes.isel(point=slice(-(2**size), None), start=0)
    energy, high = corners.impact_energy.values, corners.v.values == 1.8
    exact = energy[high].mean() - energy[~high].mean()
    assert float(ds.effect.sel(of="impact_energy", parameter="v")) == pytest.approx(exact)
    sobol = lanes.regime.values.ravel()[: -(2**size)]
    assert float(ds.share_single_impact) == pytest.approx((sobol == 3).mean())
    assert float(ds.regime_share.sum()) == pytest.approx(1.0)
    flat = ds.assign(effect=ds.effect * 1e-18)
    assert any("hardly changes it on average" in line for line in Studies().summary(flat)[0].lines)
    lines = Studies().summary(ds)[0].lines
    assert any(line.strip().startswith("v (drive speed) causes") and "from 1.2 to 1.8 m/s" in line for line in lines)


def test_lanes_of_other_regimes_follow_rules(finished_study):
    """Lanes: impact-free, at rest, irregular, failed, and without a value for another reason."""
    _, lanes, _ = finished_study
    lanes = lanes.isel(point=slice(0, 5)).copy(deep=True)
    edits = {
        "regime": [2, 1, 6, 7, 3],
        "cycles": [1, 0, 0, 0, 1],
        "impacts": [0.0, np.nan, 0.5, np.nan, 1.0],
        "period": [0.2, np.nan, 0.25, np.nan, 0.2],
        "impact_energy": [np.nan, np.nan, 100.0, np.nan, np.nan],
        "impact_power": [0.0, np.nan, np.nan, np.nan, np.nan],
        "status": [0, 0, 0, 1, 0],
    }
    for name, values in edits.items():
        lanes[name] = (lanes[name].dims, np.array(values, lanes[name].dtype)[:, None])
    expected = {
        "impact_energy": [0.0, 0.0, 100.0, np.nan, np.nan],
        "impact_power": [0.0, 0.0, 200.0, np.nan, np.nan],
        "period": [0.2, np.nan, 0.25, np.nan, 0.2],
        "share_single_impact": [0.0, 0.0, 0.0, np.nan, 1.0],
    }
    for name, values in expected.items():
        results, zeros, averaged = values_of(lanes, name)
        np.testing.assert_allclose(results.ravel(), values)
        zero = [True, True, False, False, False] if name.startswith("impact") else [False] * 5
        assert zeros.ravel().tolist() == zero and averaged.ravel()[2] == (name != "share_single_impact")


def test_command_writes_draws_and_explains(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    table = {**STUDY, "samples": 8}
    (tmp_path / "own.toml").write_text(read_source(table, "study").text)
    assert main(["study", "own.toml", "--quiet"]) == 0
    with xr.open_dataset("own-study.nc") as ds:
        assert ds.attrs["kind"] == "study" and ds.attrs["samples"] == 8
    assert (tmp_path / "own-study.png").read_bytes().startswith(b"\x89PNG") and not list(tmp_path.glob("*.chunks"))
    assert main(["study", "own.toml"]) == 0
    out = capsys.readouterr().out
    assert "is there already" in out and "impact energy:" in out
    for command, line in {
        ("plot", "own-study.nc", "--variable", "effect"): '"effect" has no picture of its own, since a study is drawn',
        ("borders", "own-study.nc"): "not the dataset of a sweep (its kind is study)",
    }.items():
        assert main(list(command)) == 2 and line in capsys.readouterr().err
    assert main(["info", "own-study.nc", "--json"]) == 0
    assert {"v", "gamma"} <= set(json.loads(capsys.readouterr().out)["study"]["impact_energy"]["parameters"])


REFUSED = [
    ({"of": []}, 'study: of: [] names no variable; write a list like of = ["'),
    ({"of": ["impact_energi"]}, 'study: of[0]: scene "vibro-impact" has no variable "impact_energi"; did you mean'),
    ({"of": ["regime"]}, 'has no variable "regime"'),
    ({"samples": 24}, "study: samples: 24 is not a power of two; give 16 or 32"),
    ({"seed": -1}, "study: seed: -1 does not fit"),
    ({"vary": {}}, "study: vary: empty, so nothing varies; write one like"),
    ({"vary": {"v": [1.5, 1.5]}}, "study: vary.v: [1.5, 1.5] is no interval; move one value to [parameters]"),
    ({"vary": {"gama": [0.6, 0.8]}}, 'study: vary.gama: scene "vibro-impact" has no such parameter; did you mean'),
    ({"vary": {"v": [1.2, 1.5], "rpm": [100.0, 200.0]}}, "study: vary.rpm: v is given as well"),
    ({"vary": {"v": [1.2]}}, "study: vary.v: [1.2] is not a pair"),
    ({"vary": {"v": [1.5, 1.2]}}, "study: vary.v: [1.5, 1.2] is no interval; the least value comes first"),
    ({"vary": {"m1": [-1.0, 2.0]}}, "study: vary.m1[0]: is -1; it must be above 0 kg"),
    ({"vary": {"delta": [0.0, 0.001]}}, "study: vary.delta: is in [parameters] as well"),
    ({"vary": {f"x{k}": [0.0, 1.0] for k in range(13)}}, "study: vary: 13 parameters vary; give at most 12"),
    ({"starts": ["stuk"]}, 'study: starts[0]: "stuk" is unknown; did you mean "stuck"?'),
    ({"run": {"carry": "v"}}, "study: run.carry: points have no axis"),
    ({"sample": 8}, 'study: sample: unknown key; did you mean "samples"?'),
    ({"scene": "vibro"}, "study: scene: "),
]


@pytest.mark.parametrize(("changes", "line"), REFUSED)
def test_invalid_studies_are_refused_in_one_line(changes, line):
    with pytest.raises(InputError) as caught:
        read_study({**STUDY, **changes})
    assert line in str(caught.value) and "\n" not in str(caught.value)


def test_missing_keys_and_packages_are_named(monkeypatch, capsys):
    for key in ("scene", "of", "vary"):
        with pytest.raises(InputError, match=f"^study: {key}:? missing"):
            read_study({name: value for name, value in STUDY.items() if name != key})
    assert main(["study", "dril"]) == 2
    assert 'no such bundled study or file; did you mean "drill"?' in capsys.readouterr().err
    monkeypatch.setattr("importlib.import_module", lambda name: (_ for _ in ()).throw(ImportError(name)))
    with pytest.raises(InputError, match=r"SALib, .* is missing; install it with: pip install"):
        samples.salib("sample")


def test_bundled_study_is_valid():
    spec = read_study("drill")
    assert spec.of and spec.sweep.lanes == spec.sampling.samples * (2 * len(spec.sampling.bounds) + 2) + 2 ** len(
        spec.sampling.bounds
    )
