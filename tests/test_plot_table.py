"""Test which picture is chosen for each kind of dataset, without drawing."""

import json

import numpy as np
import pytest
import test_plot as drills
import test_plot_families as families
import test_plot_rock as rocks
import test_plot_starts as starts
import xarray as xr

from vibrojax.io.kinds import STRUCTURES
from vibrojax.pictures.contents import Contents
from vibrojax.studies.analysis import analysis_named, analysis_of


def first_rule(ds):
    return next((rule.draw.__name__ for rule in analysis_of(ds).pictures if rule.fits(Contents(ds))), None)


def bit_on_rock(**attributes):
    states = {name: ("time", np.zeros(20)) for name in ("x3", "x4", "v3")}
    return xr.Dataset(states, {"time": np.arange(20.0)}, attributes)


SINE = {"pulse_shape": "sweep", "parameters": json.dumps({"sweep_rate": 300.0})}
STUDY = xr.Dataset({"error_worst": ("setting", np.ones(3))})
BORDERS = xr.Dataset(
    {"curve": ("vertex", [0]), "kind": ("curve", [0]), "region_area": ("region", [0.5])}, attrs={"axes": "gamma beta"}
)
LINE = {name: ("point", [0.4, 0.5]) for name in ("gamma", "beta", "period")} | {"point_curve": ("point", [0, 0])}
LINE |= {"kind": ("curve", [0], {"flag_meanings": "fold"}), "special": ("curve", [2]), "curve_note": ("curve", [""])}
LINE |= {"codim2_kind": ("codim2", ["cusp"]), "codim2_gamma": ("codim2", [0.4]), "codim2_beta": ("codim2", [0.4])}
CURVES = xr.Dataset(LINE, attrs={"kind": "curves", "axes": ["gamma", "beta"], "bounds": [0.3, 1.0, 0.1, 0.9]})
ATTRACTORS = xr.Dataset(
    {
        "share": (("gamma", "attractor"), [[1.0]]),
        "share_stderr": (("gamma", "attractor"), [[0.0]]),
        "regime": (("gamma", "attractor"), [[3]]),
        "lane_attractor": (("gamma", "start"), [[0]]),
    }
)
OVER_TWO = ATTRACTORS.isel(gamma=[0] * 6).expand_dims(beta=6).assign_coords(gamma=range(6), beta=range(6))
PUSHES = xr.Dataset({"push_x1": ("sign", [1e-3, -1e-3])}, {"sign": ["up", "down"]})
BOX = xr.Dataset({"place": ("sample", [0, 1]), "regime": ("sample", [3, 3])}, attrs={"kind": "tolerance"})
VALID = {"valid": ("parameter", [1, 1]), "reason": ("parameter", [0, 0]), "parameter_value": ("parameter", [0.4, 0.7])}
SLOPES = xr.Dataset(VALID, {"parameter": ["beta", "gamma"]}, {"kind": "sensitivity"})
INDICES = {name: (("of", "parameter"), [[0.4, 0.6]]) for name in ("first_order", "total_order", "effect")}
EFFECTS = xr.Dataset(INDICES, {"of": ["period"], "parameter": ["beta", "gamma"]}, {"kind": "study"})
ESTIMATED = {"estimate": ("parameter", [0.4]), "posterior": (("draw", "parameter"), [[0.4]])}
ESTIMATED |= {"direction": (("combination", "parameter"), [[1.0]]), "residual": (("observation", "of"), [[0.1]])}
ESTIMATES = xr.Dataset(ESTIMATED, attrs={"kind": "calibration"})
LOG = {"specific_energy": ("row", [1e8]), "founder_weight": ((), 1e5), "founder_reason": ((), 0)}
LOG = xr.Dataset(LOG, attrs={"kind": "rig"})
CANDIDATES = {"objective": ("candidate", [1.0]), "parameter": ["gamma"]}
BEST = xr.Dataset(CANDIDATES, attrs={"kind": "design"})
OSCILLATION = xr.Dataset({"x": ("time", np.sin(np.arange(32.0)))}, {"time": np.arange(32.0)})

EXPECTED = {
    "response": lambda: bit_on_rock(**SINE),
    "pulses": bit_on_rock,
    "trajectory": drills.KINDS["trajectory"],
    "states_over_time": lambda: OSCILLATION,
    "families": families.one_family,
    "border_curves": lambda: BORDERS,
    "curves_picture": lambda: CURVES,
    "share_map": lambda: OVER_TWO,
    "attractor_shares": lambda: ATTRACTORS,
    "smallest_pushes": lambda: PUSHES,
    "extremes_picture": lambda: BOX,
    "hysteresis": families.carried,
    "work_precision": lambda: STUDY,
    "bifurcation": drills.KINDS["bifurcation"],
    "law_map": rocks.KINDS["law-map"],
    "law_lines": rocks.KINDS["law"],
    "many_starts": lambda: starts.basin(starts.sample(), starts.LONG),
    "rates": rocks.KINDS["lines"],
    "regime_grid": drills.KINDS["map"],
    "regime_lines": drills.KINDS["line"],
    "regime_bars": drills.KINDS["counts"],
    "rate_grid": rocks.KINDS["map"],
    "design_picture": lambda: BEST,
    "elasticities": lambda: SLOPES,
    "bars_and_interactions": lambda: EFFECTS,
    "calibration_picture": lambda: ESTIMATES,
    "rig_picture": lambda: LOG,
}


def test_every_rule_has_dataset():
    analyses = [analysis_named(kind) for kind in ("sweep", "fit", *STRUCTURES)]
    assert {rule.draw.__name__ for analysis in analyses for rule in analysis.pictures} == set(EXPECTED)


@pytest.mark.parametrize("name", EXPECTED)
def test_first_matching_rule(name):
    assert first_rule(EXPECTED[name]()) == name


def test_drill_is_mapped_by_regime_where_lines_are_too_many():
    assert first_rule(rocks.KINDS["drill-lines"]()) == "rates"
    assert first_rule(rocks.KINDS["drill-map"]()) == "regime_grid"


def test_fit_of_points_is_drawn_as_lines():
    fit = rocks.law({"point": np.arange(12.0)})
    along = {name: ("point", np.linspace(1.0, 2.0, 12)) for name in ("force", "k3")}
    assert first_rule(fit.assign_coords(along)) == "law_lines"


def test_no_rule_matches_unrelated_dataset():
    assert first_rule(xr.Dataset({"threshold": 1.0})) is None
