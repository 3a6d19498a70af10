"""Test studies: Sobol indices and factorial effects against closed forms, rules for lanes, the command and refusals."""

import json
from itertools import combinations

import numpy as np
import pytest
import xarray as xr
from refusals import refusal

from vibrojax.cli import main
from vibrojax.maps.bounds import MAX_VARIED
from vibrojax.settings.toml import read_source
from vibrojax.studies.effects import RULED, Studies, bars_and_interactions, read_study
from vibrojax.studies.effects_sampling import REASONS, Sampling, factorial_effects, factorial_signs, indices

STUDY = {
    "scene": "vibro-impact",
    "of": ["impact_energy", "share_single_impact"],
    "starts": ["stuck"],
    "samples": 16,
    "vary": {"v": [1.2, 1.8], "gamma": [0.7, 0.75], "c2": [240.0, 260.0]},
    "parameters": {"delta": 0.005},
    "run": {"settle": 10.0, "observe": 4.0, "end_early": False},
}


def test_indices_of_ishigami_function():
    """The variance is a²/8 + b pi⁴/5 + b² pi⁸/18 + 1/2 (Ishigami and Homma 1990)."""
    a, b, pi = 7.0, 0.1, np.pi
    own = Sampling(dict.fromkeys("abc", (-pi, pi)), 4096, seed=3)
    x = own.points()
    results = indices(own, np.sin(x[:, 0]) + a * np.sin(x[:, 1]) ** 2 + b * x[:, 2] ** 4 * np.sin(x[:, 0]))
    variance = a**2 / 8 + b * pi**4 / 5 + b**2 * pi**8 / 18 + 0.5
    first = np.array([(1 + b * pi**4 / 5) ** 2 / 2, a**2 / 8, 0.0]) / variance
    pair = 8 * b**2 * pi**8 / 225 / variance
    np.testing.assert_allclose(results["first_order"], first, atol=0.02)
    np.testing.assert_allclose(results["total_order"], first + [pair, 0.0, pair], atol=0.02)
    second = np.array([[np.nan, 0, pair], [0, np.nan, 0], [pair, 0, np.nan]])
    np.testing.assert_allclose(results["second_order"], second, atol=0.04)
    for name, exact in (("first_order", first), ("total_order", first + [pair, 0.0, pair])):
        error = results[f"{name}_conf"]
        assert (np.abs(results[name] - exact) <= 2 * error).all() and (error < 0.1).all()
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


def test_rare_changes_are_not_mistaken_for_certainty():
    """The corner a, b < s of the unit square has the total indices 1/(1 + s), also if no sample shows a change."""
    side, unseen = 0.15, 0
    for seed in range(8):
        own = Sampling({"a": (0.0, 1.0), "b": (0.0, 1.0)}, 64, seed)
        results = indices(own, 1.0 - (own.points() < side).all(axis=1))
        assert (np.abs(results["total_order"] - 1 / (1 + side)) <= results["total_order_conf"]).all()
        unseen += int((results["total_order"] == 0).any())
    assert unseen  # for some seeds


def test_command_writes_draws_and_explains(here, capsys):
    table = {**STUDY, "samples": 8}
    (here / "own.toml").write_text(read_source(table, "study").text)
    assert main(["study", "own.toml", "--quiet"]) == 0
    with xr.open_dataset("own-study.nc") as ds:
        assert ds.attrs["kind"] == "study" and ds.attrs["samples"] == 8
    assert (here / "own-study.png").read_bytes().startswith(b"\x89PNG") and not list(here.glob("*.chunks"))
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


@pytest.mark.parametrize(
    ("first", "total", "is_beyond", "second", "claim"),
    [(-0.08, 1.06, True, (0.7, 0.67), ""), (0.2, 0.96, False, (0.2, 0.05), "their interaction causes 10 ± 5 % of the")],
)
def test_text_says_that_shares_beyond_their_range_end_there(first, total, is_beyond, second, claim):
    """Few samples may estimate a share of the variance below 0 or above 1; the picture says the same. An interaction
    has at most the smaller of the total shares, 10 %, and is claimed beyond its uncertainty only."""
    table = {"first_order": first, "first_order_conf": 0.1, "total_order": total, "total_order_conf": 0.2, "effect": 1}
    values = {name: (("of", "parameter"), [[x, 0.1]]) for name, x in table.items()}
    pairs = zip(("second_order", "second_order_conf", "interaction"), (*second, np.nan), strict=True)
    values |= {name: (("of", "parameter", "other"), np.full((1, 2, 2), x)) for name, x in pairs}
    values |= {name: ("parameter", [1.0, 2.0]) for name in ("low", "high")}
    values |= dict.fromkeys(("mean", "std", *RULED, "sobol_reason"), ("of", [0]))
    about = {"of": ["impact_energy"], "parameter": ["v", "gamma"], "of_unit": ("of", ["J"])}
    about |= {"parameter_unit": ("parameter", ["1", "1"]), "parameter_long_name": ("parameter", ["v", "gamma"])}
    ds = xr.Dataset(values, about, {"kind": "study"})
    lines = "\n".join(Studies().summary(ds)[0].lines)
    shares = "100 ± 20 % of the variation, 0 %" if is_beyond else "96 ± 20 % of the variation, 20 %"
    assert ("chosen together" in lines) == bool(claim) and claim in lines
    assert f"causes {shares} on its own" in lines and ("shares beyond 0 and 100 %" in lines) == is_beyond
    assert ("Shares beyond 0 and 1" in bars_and_interactions(ds).note) == is_beyond


def test_invalid_studies_are_refused_in_one_line():
    for changes, line in (
        ({"of": []}, 'study: of: [] names no variable; write a list like of = ["'),
        ({"samples": 24}, "study: samples: 24 is not a power of two; give 16 or 32"),
        ({"vary": {"v": [1.5, 1.5]}}, "study: vary.v: [1.5, 1.5] is no interval; move one value to [parameters]"),
    ):
        assert line in refusal(read_study, {**STUDY, **changes})
