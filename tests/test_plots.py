"""Test pictures: one per rule, and what their plots show; the axes, colours and layout that they share."""

import json
import subprocess
import sys
from dataclasses import replace
from itertools import combinations, pairwise

import matplotlib
import numpy as np
import pytest
import xarray as xr
from drawn import (
    END,
    FLAGS,
    FORMS,
    LONG,
    MEANINGS,
    SPECIAL,
    UNITS,
    basin,
    carried,
    cells,
    drill,
    labels,
    lanes,
    law,
    line,
    marks_of,
    one_family,
    orbit_lines,
    plane,
    plot_of,
    points,
    returns,
    rock,
    rock_points,
    run,
    sample,
    scales,
    several_families,
    sheet_of,
    square,
    swept,
)
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm, to_hex, to_rgb
from matplotlib.figure import Figure
from read_off import check_texts, texts

import vibrojax as vj
from vibrojax.errors import InputError, counted
from vibrojax.io.kinds import STRUCTURES
from vibrojax.pictures.axes import certified_text, label, point_text, scale, share_text, short, value_text
from vibrojax.pictures.branches import branches, places, smooth, stability, stable_intervals
from vibrojax.pictures.chart import chart
from vibrojax.pictures.colours import REGIME_COLOURS
from vibrojax.pictures.contents import Contents, returns_in
from vibrojax.pictures.draw import draw
from vibrojax.pictures.lines import rates
from vibrojax.pictures.maps import contours
from vibrojax.pictures.motion import pulses, response, trajectory
from vibrojax.pictures.plots import Area, Axis, Bars, Line, Plot, Points, Sheet, Text, as_sheet, resolved
from vibrojax.pictures.returns import bifurcation
from vibrojax.pictures.sheet import PAGE
from vibrojax.pictures.style import NO_VALUE, nested_line
from vibrojax.studies.analysis import analysis_named, analysis_of
from vibrojax.studies.choose import picture, save_picture
from vibrojax.studies.family_analysis import family_lines

# One picture per rule.


def bit_on_rock(count=400, **attributes):
    """Return a run of the bit on rock with twenty pulses per second, and a hole that grows."""
    time = np.linspace(0.0, 1.0, count)
    force = 2e5 * (np.sin(40 * np.pi * time) > 0)
    depth = 1e-3 * time
    series = {"x3": depth + 1e-5 * force / 2e5, "x4": depth, "applied_force": force, "rock_force": 0.5 * force}
    return xr.Dataset({name: ("time", x) for name, x in series.items()}, {"time": time}, attributes)


def matrix(count=4, size=5):
    return np.linspace(0.1, 0.9, count * size).reshape(count, size)


SINE = {"pulse_shape": "sweep", "parameters": json.dumps({"sweep_rate": 40.0})}
METHODS = {
    name: ("setting", [text] * 4) for name, text in (("scene", "drill"), ("method", "located"), ("varied", "tolerance"))
}
METHODS |= {"precision": ("setting", ["float64"] * 2 + ["float32"] * 2), "lanes": ("setting", [3] * 4)}
METHODS |= {name: ("setting", [1e-6, 1e-5, 1e-4, 1e-3]) for name in ("time_per_lane_second", "value", "error_median")}
METHODS |= {f"time_per_lane_second_{end}": ("setting", [1e-6, 1e-5, 1e-4, 1e-3]) for end in ("min", "max")}
METHODS |= {"error_worst": ("setting", [1e-3, 1e-5, 1e-7, 1e-9]), "status": ("setting", [0, 0, 0, 1])}
STUDY = xr.Dataset(METHODS | {"on_front": ("setting", [1, 1, 0, 1]), "reference_spread": ("setting", [1e-12] * 4)})
STUDY = STUDY.assign_attrs(title="Speed against error")
PATH = {"gamma": ("vertex", [0.6, 0.7]), "beta": ("vertex", [0.3, 0.4]), "curve": ("vertex", [0, 0])}
KIND = ("curve", [1], {"flag_values": [0, 1], "flag_meanings": "fold basin"})
BORDERS = xr.Dataset(
    PATH | {"kind": KIND, "region_area": ("region", [0.4, 1.0])},
    {"start": ("curve", ["drive"]), "region_start": ("region", ["drive", "any"])},
    {"axes": ["gamma", "beta"], "kind": "borders"},
)
LINE = {name: ("point", [0.4, 0.5]) for name in ("gamma", "beta", "period")} | {"point_curve": ("point", [0, 0])}
LINE |= {"kind": ("curve", [0], {"flag_values": [0], "flag_meanings": "fold"}), "special": ("curve", [2])}
LINE |= {"codim2_kind": ("codim2", ["cusp"]), "codim2_gamma": ("codim2", [0.4]), "codim2_beta": ("codim2", [0.4])}
CURVES = xr.Dataset(LINE | {"curve_note": ("curve", [""])}, attrs={"kind": "curves", "axes": ["gamma", "beta"]})
CURVES = CURVES.assign_attrs(bounds=[0.3, 1.0, 0.1, 0.9])
SHARES = {"share": (("gamma", "attractor"), [[0.7, 0.3], [1.0, 0.0]]), "unassigned": ("gamma", [0, 1])}
SHARES |= {
    "share_stderr": (("gamma", "attractor"), 0.05 * np.ones((2, 2))),
    "regime": (("gamma", "attractor"), [[3, 6]] * 2),
}
SHARES |= {"impact_velocity": (("gamma", "attractor"), [[2.0, 1.0], [2.5, np.nan]], {"units": "m s-1"})}
SHARES |= {"lane_attractor": (("gamma", "start"), [[0, 0, 1], [0, 0, -1]])}
ATTRACTORS = xr.Dataset(SHARES, {"gamma": [0.6, 0.7]}, {"title": "Attractors", "parameters": json.dumps({"v": 1.5})})
OVER_TWO = ATTRACTORS.isel(gamma=[0, 1] * 3).assign_coords(gamma=np.arange(6.0)).expand_dims(beta=np.arange(6.0))
PUSHES = {f"push_{name}": ("sign", [np.nan, 1e-3]) for name in ("x1", "v1")} | {"period": 0.2, "regime": 3}
PUSHES |= {f"regime_{name}": ("sign", [0, 6]) for name in ("x1", "v1")} | {"bound_x1": 2e-3, "bound_v1": 3e-3}
PUSHES = xr.Dataset(PUSHES, {"sign": [-1, 1]}, {"title": "Pushes"})
SIDE = {"place": ("sample", [0, 1, 1]), "regime": ("sample", [3, 3, 6]), "impact_velocity": ("sample", [2.0, 2.1, 1.9])}
BOX = xr.Dataset(SIDE, {"beta": ("sample", [0.4, 0.39, 0.41])}, {"kind": "tolerance", "tolerance_beta": 0.01})
VALID = {
    "valid": ("lane", [1, 1]),
    "parameter_value": (("lane", "parameter"), [[0.4, 0.7]] * 2),
    "reason": ("lane", [0, 0]),
}
VALID |= {"period": ("lane", [0.2, 0.2]), "d_period": (("lane", "parameter"), [[0.1, -0.2]] * 2)}
SLOPES = xr.Dataset(VALID, {"parameter": ["beta", "gamma"]}, {"kind": "sensitivity"})
INDICES = {name: (("of", "parameter"), [[0.4, 0.6]]) for name in ("first_order", "total_order", "effect")}
INDICES |= {f"{name}_conf": (("of", "parameter"), [[0.1, 0.1]]) for name in ("first_order", "total_order")}
PAIRS = [[[np.nan, 0.2], [0.2, np.nan]]]
INDICES |= {name: (("of", "parameter", "other"), PAIRS) for name in ("second_order", "second_order_conf")}
INDICES |= {name: ("of", [1.0]) for name in ("mean", "std")} | {"sobol_reason": ("of", [0]), "of_unit": ("of", ["s"])}
EFFECTS = xr.Dataset(INDICES, {"of": ["period"], "parameter": ["beta", "gamma"]}, {"kind": "study"})
DRAWS = np.random.default_rng(0).normal([0.4, 0.7], 0.01, (50, 2))
ESTIMATED = {name: ("parameter", [0.4, 0.7]) for name in ("estimate", "estimate_low", "estimate_high", "low")}
ESTIMATED |= {"estimate_stderr": ("parameter", [0.01, 0.01]), "posterior": (("draw", "parameter"), DRAWS)}
ESTIMATED |= {"direction": (("combination", "parameter"), np.eye(2)), "direction_error": ("combination", [0.01, 2.0])}
ESTIMATED |= {"parameter_unit": ("parameter", ["1", "1"]), "residual": (("observation", "of"), [[0.1], [-0.2]])}
MEANS = {"flag_values": [0, 1], "flag_meanings": "identified at-bound"}
ESTIMATED |= {"reason": ("parameter", [0, 1], MEANS)}
ESTIMATES = xr.Dataset(ESTIMATED, {"parameter": ["beta", "gamma"], "of": ["period"]}, {"kind": "calibration"})
LOG = {
    name: ("row", np.linspace(1.0, 2.0, 9))
    for name in ("specific_energy", "rate_of_penetration", "weight_on_bit", "depth")
}
LOG = xr.Dataset(
    LOG | {"founder_weight": 1.5, "slope_below": 1.0, "slope_above": 0.2, "founder_reason": 0}, attrs={"kind": "rig"}
)
CANDIDATES = {"objective": ("candidate", [2.0, 1.0]), "map_feasible": ("map", [1, 0, 1])}
CANDIDATES |= {name: ("candidate", [0.4, 0.5]) for name in ("beta", "gamma")}
CANDIDATES |= {f"map_{name}": ("map", [0.3, 0.4, 0.5]) for name in ("beta", "gamma")}
CANDIDATES |= {"map_objective": ("map", [1.0, np.nan, 2.0], {"units": "J", "long_name": "energy on the map"})}
BEST = xr.Dataset(CANDIDATES, {"parameter": ["beta", "gamma"]}, {"kind": "design", "tolerance_beta": 0.01})
OSCILLATION = xr.Dataset(
    {"x": ("time", np.sin(np.arange(32.0))), "v": ("time", np.cos(np.arange(32.0)))}, {"time": np.arange(32.0)}
)

EXPECTED = {
    "response": lambda: bit_on_rock(**SINE),
    "pulses": bit_on_rock,
    "trajectory": run,
    "states_over_time": lambda: OSCILLATION,
    "families": one_family,
    "border_curves": lambda: BORDERS,
    "curves_picture": lambda: CURVES,
    "share_map": lambda: OVER_TWO,
    "attractor_shares": lambda: ATTRACTORS,
    "smallest_pushes": lambda: PUSHES,
    "extremes_picture": lambda: BOX,
    "hysteresis": carried,
    "work_precision": lambda: STUDY,
    "bifurcation": lambda: returns({"gamma": np.linspace(0.3, 1.2, 20), "delta": [-0.005, 0.005]}),
    "law_map": lambda: law({"force": np.linspace(2e5, 3e5, 9), "k3": np.linspace(1e8, 5e8, 9), "zeta": [0.5, 1.0]}),
    "law_lines": lambda: law({"k3": [1e8, 3e8], "force": [2e5, 2.5e5, 3e5]}),
    "many_starts": lambda: basin(sample(), LONG),
    "rates": lambda: rock({"k3": [1e8, 3e8], "force": np.linspace(1e5, 3e5, 7), "frequency": np.linspace(10, 40, 9)}),
    "regime_grid": lambda: lanes(square(8, delta=[-0.005, 0.005])),
    "regime_lines": lambda: lanes({"gamma": np.linspace(0.3, 1.2, 20)}),
    "regime_bars": lambda: points(also_v=True),
    "rate_grid": lambda: rock({"force": np.linspace(1e5, 3e5, 9), "frequency": np.linspace(10.0, 40.0, 9)}),
    "design_picture": lambda: BEST,
    "elasticities": lambda: SLOPES,
    "bars_and_interactions": lambda: EFFECTS,
    "calibration_picture": lambda: ESTIMATES,
    "rig_picture": lambda: LOG,
}
OTHERS = {
    "map-of-many": lambda: lanes(square(3, v=np.linspace(0.5, 2, 4), delta=[-0.005, 0.0, 0.005])),
    "points": points,
    "phase-planes": lambda: basin(sample()),
    "drill-lines": lambda: drill({"k3": [1e8, 3e8], "delta": np.linspace(-0.005, 0.012, 9)}),
    "drill-map": lambda: drill({"beta": np.linspace(0.2, 0.9, 9), "gamma": np.linspace(0.5, 0.9, 9)}),
    "rock-points": rock_points,
    "rock-of-one": lambda: rock({}),
    "law-of-one": lambda: law({}),
    "families": several_families,
}


def first_rule(ds):
    return next((rule.draw.__name__ for rule in analysis_of(ds).pictures if rule.fits(Contents(ds))), None)


def test_every_rule_has_dataset():
    analyses = [analysis_named(kind) for kind in ("sweep", "fit", *STRUCTURES)]
    assert {rule.draw.__name__ for analysis in analyses for rule in analysis.pictures} == set(EXPECTED)


@pytest.mark.parametrize("name", EXPECTED)
def test_first_rule_that_fits_draws_texts_without_overlap(name):
    ds = EXPECTED[name]()
    assert first_rule(ds) == name
    check_texts(picture(ds.assign_attrs(title=f"{ds.attrs.get('title', 'A drill')} " * 12)))


@pytest.mark.parametrize("name", OTHERS)
def test_other_contents_are_drawn_without_overlap(name):
    check_texts(picture(OTHERS[name]()))


def test_rules_depend_on_contents():
    assert first_rule(drill({"beta": np.linspace(0.2, 0.9, 9), "gamma": np.linspace(0.5, 0.9, 9)})) == "regime_grid"
    assert first_rule(law({"group": np.arange(12)}).drop_vars("group")) == "law_lines"
    assert first_rule(xr.Dataset({"threshold": 1.0})) is None
    with pytest.raises(InputError, match="nothing to draw"):
        picture(xr.Dataset({"threshold": 1.0}))


# Maps.


def test_maps_show_lanes_named_in_their_titles():
    ds = lanes(square(7, delta=[-0.005, 0.005]))
    sheet = sheet_of(ds)
    shown = dict(cells(sheet))
    assert list(shown) == [f"Δ = {gap} mm, start: {start}" for gap in ("−5", "5") for start in ("drive", "stuck")]
    for gap, start in ((-0.005, "drive"), (0.005, "stuck")):
        title = f"Δ = {value_text(ds['delta'], gap)[4:]}, start: {start}"
        assert np.array_equal(shown[title].values, ds["regime"].sel(delta=gap, start=start).transpose("beta", "gamma"))
    assert [len(cells(sheet, name)) for name in (None, "viridis", "cividis")] == [4, 4, 4]
    assert sheet.plots[0].at == {"delta": -0.005, "start": "drive"}
    words = {plot.x.label for plot in sheet.plots} | {plot.y.label for plot in sheet.plots}
    assert {"mass ratio m2/m1, β", "frequency ratio w2/w1, γ"} <= words
    assert {scale.label for scale in scales(sheet)} == {"impact velocity [m/s]", "period [s]"}
    assert len({(scale.norm.vmin, scale.norm.vmax) for scale in scales(sheet)}) == 2


@pytest.mark.parametrize("flag", range(8))
def test_flag_has_same_colour_in_every_map(flag):
    _, shown = cells(sheet_of(lanes(square(4), regime=flag)))[0]
    assert to_hex(shown.colour_map(shown.norm(shown.values))[0, 0]).upper() == REGIME_COLOURS[flag]


def test_flag_without_colour_is_refused_by_name():
    ds = lanes(square(4))
    ds["regime"].values[1, 2] = 9
    ds["regime"].attrs |= {"flag_values": np.arange(10, dtype=np.int8), "flag_meanings": f"{MEANINGS} hopping rattling"}
    with pytest.raises(InputError, match=r"regime: flag 9 \(rattling\) is not a regime with a colour") as refused:
        picture(ds)
    assert "\n" not in str(refused.value)


def linear(srgb):
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def lab(rgb):
    """Convert linear RGB to CIELAB (D65)."""
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = to_xyz @ np.clip(rgb, 0, 1) / [0.9505, 1.0, 1.089]
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def test_flag_colours_differ_for_colour_blind_readers():
    # Machado, Oliveira, Fernandes 2009 (doi 10.1109/TVCG.2009.113), severity 1: protan, deutan, tritan.
    without = [
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
    ]
    for eye in (np.eye(3), *map(np.array, without)):
        seen = [lab(eye @ linear(np.array(to_rgb(colour)))) for colour in REGIME_COLOURS.values()]
        assert min(np.linalg.norm(a - b) for a, b in combinations(seen, 2)) > 25
    greys = REGIME_COLOURS[0], REGIME_COLOURS[1], NO_VALUE["facecolor"], NO_VALUE["edgecolor"]
    undecided, equilibrium, ground, stroke = (lab(linear(np.array(to_rgb(grey))))[0] for grey in greys)
    assert undecided - equilibrium > 30 and ground - undecided > 12 and ground - stroke > 30


def test_legend_lists_regimes_with_shares_and_region_over_beta_and_gamma():
    ds = lanes(square(4), ("drive",))
    ds["regime"].values[:] = 3
    ds["regime"].values[0, 0], ds["regime"].values[1] = 6, 7
    shares = ["single-impact  69 % of lanes", "irregular  6 % of lanes", "failed  25 % of lanes"]
    sheet = sheet_of(ds)
    assert labels(sheet)[:3] == shares and labels(sheet)[-1] == "source's best region"
    region = next(layer for layer in sheet.plots[0].layers if isinstance(layer, Line))
    assert (min(region.x), max(region.x), min(region.y), max(region.y)) == (0.6, 0.8, 0.25, 0.6)
    other = sheet_of(lanes({"v": np.linspace(0.5, 2, 5), "gamma": np.linspace(0.3, 1.2, 5)}))
    assert "source's best region" not in labels(other)


def test_lanes_without_value_are_hatched():
    ds = lanes(square(6), ("drive",))
    ds["impact_velocity"][{"beta": 2, "gamma": 3, "start": 0}] = np.nan
    (_, shown), *_ = cells(sheet_of(ds), "viridis")
    assert np.argwhere(np.isnan(shown.values)).tolist() == [[2, 3]] and "no value" in labels(sheet_of(ds))
    figure = picture(ds)
    hatched = [axes.patch.get_hatch() for axes in figure.axes if axes.collections and not hasattr(axes, "_colorbar")]
    assert hatched[1] == NO_VALUE["hatch"] and shown.colour_map.get_bad()[3] == 0.0
    assert hatched[0] is None


def test_cells_end_halfway_and_geometric_axes_are_logarithmic():
    ds = lanes({"v": [0.5, 1.0, 2.0, 4.0], "delta": [-0.004, 0.0, 0.002]}, ("drive",))
    plot = sheet_of(ds.isel(v=[2, 0, 3, 1])).plots[0]
    shown = plot.layers[0]
    assert np.allclose(shown.x, 0.5 * 2.0 ** np.arange(-0.5, 4)) and np.allclose(shown.y, [-6, -2, 1, 3])  # mm
    assert plot.x.log and not plot.y.log and plot.x.limits == pytest.approx((shown.x[0], shown.x[-1]))
    assert np.array_equal(shown.values, ds["regime"].isel(start=0).transpose("delta", "v"))


def test_excess_panels_and_fixed_values_are_in_note():
    sheet = sheet_of(lanes(square(3, v=np.linspace(0.5, 2, 4), delta=[-0.005, 0.0, 0.005])))
    assert len(cells(sheet)) == 12 and "v = 0.5, 2 m/s (2 of 4 values)" in sheet.note
    ds = lanes(square(4, delta=[-0.005]), ("drive",)).assign_attrs(parameters=json.dumps({"v": 1.5, "k0": 5e7}))
    sheet = sheet_of(ds)
    assert sheet.note == "Δ = −5 mm, start: drive, v = 1.5 m/s" and not any(plot.title for plot in sheet.plots)
    bare = sheet_of(lanes(square(4, delta=[-0.005, 0.005]), attrs=False))
    assert bare.plots[0].title == "delta = −0.005, start: drive" and bare.plots[0].x.label == "gamma"


def test_contour_labels_keep_their_distance():
    x = np.linspace(0.0, 1.0, 60)
    z = 30.0 * np.exp(-((x[:, None] - 0.5) ** 2 + (x - 0.5) ** 2) / 0.02)
    taken: list[tuple[float, float]] = []
    layers = contours(x, x, z, np.arange(1.0, 30.0).tolist(), taken)
    marks = [layer for layer in layers if isinstance(layer, Text)]
    assert 3 <= len(marks) == len(taken) < 29 == sum(isinstance(layer, Line) for layer in layers)
    assert all(abs(a.x - b.x) > 0.11 or abs(a.y - b.y) > 0.06 for a, b in combinations(marks, 2))
    radius = [np.hypot(mark.x - 0.5, mark.y - 0.5) for mark in marks]
    level = [30.0 * np.exp(-(r**2) / 0.02) for r in radius]
    assert level == pytest.approx([float(mark.text) for mark in marks], rel=0.03)


def test_rates_are_white_without_penetration_and_have_contours_of_relief():
    ds = rock({"force": np.linspace(1e5, 3e5, 9), "frequency": np.linspace(10.0, 40.0, 9)})
    sheet = sheet_of(ds)
    rate, slip, force = (plot for plot in sheet.plots)
    nothing = rate.layers[1]
    assert np.array_equal(nothing.values == 0, ds["rate_of_penetration"].transpose("force", "frequency") == 0)
    assert to_hex(nothing.colour_map(nothing.norm(0.0))) == "#ffffff" and "no penetration" in labels(sheet)
    relief = [layer for layer in rate.layers if isinstance(layer, Line)]
    factor = ds["relief"] / (ds["force"] * ds["frequency"])
    for path in relief:
        inside = np.isfinite(path.x)
        levels = float(factor.mean()) * 1e3 * np.asarray(path.y)[inside] * np.asarray(path.x)[inside]
        assert np.ptp(levels) < 0.05 * levels.mean()
    assert (
        "equal relief P/D" in labels(sheet) and len(force.layers) == 1 and slip.layers[0].colour_map.name == "viridis"
    )
    decades = rock({"force": np.geomspace(170e3, 3e6, 9), "frequency": np.geomspace(1.0, 400.0, 9)})
    assert isinstance(scales(sheet_of(decades))[0].norm, LogNorm)


def test_border_of_single_impacts_lies_between_regimes():
    sheet = sheet_of(drill({"beta": np.linspace(0.2, 0.9, 9), "gamma": np.linspace(0.5, 0.9, 9)}, ("drive",)))
    rate = next(plot for plot in sheet.plots if plot.scale is not None and plot.scale.of_rate)
    border = next(
        layer for layer in rate.layers if isinstance(layer, Line) and layer.label == "border of single impact"
    )
    assert np.asarray(border.y)[np.isfinite(border.y)] == pytest.approx(0.2 + 4.5 * 0.7 / 8)


def test_points_are_scattered_by_start_or_counted():
    ds = points()
    sheet = sheet_of(ds)
    assert [plot.title for plot in sheet.plots[:: len(sheet.plots) // 2]] == ["start: drive", "start: stuck"]
    dots, here = sheet.plots[0].layers[0], ds["start"].values == "drive"
    assert np.array_equal(np.stack([dots.x, dots.y]), np.stack([ds["gamma"], ds["beta"]])[:, here])
    assert [colour.upper() for colour in dots.colours] == [
        REGIME_COLOURS[flag] for flag in ds["regime"].values[here].tolist()
    ]
    counted_lanes = points(also_v=True)
    for plot in sheet_of(counted_lanes).plots:
        flags = counted_lanes["regime"].values[counted_lanes["start"].values == plot.title.removeprefix("start: ")]
        assert plot.layers[0].width.tolist() == [np.count_nonzero(flags == flag) for flag in (2, 3, 6)]


# Many starts.


def test_plane_of_starts_is_map_over_states():
    ds = basin(plane(), named=("drive",))
    sheet = sheet_of(ds.isel(start=np.random.default_rng(5).permutation(ds.sizes["start"])))
    (_, shown), *_ = cells(sheet)
    x2 = np.unique(ds["start_x2"][:-1])
    assert np.array_equal(shown.values, np.broadcast_to(np.where(x2 > 0, 3, 6), (10, 12)))
    assert (sheet.plots[0].x.label, sheet.plots[0].y.label) == ("start, x₂(0) [mm]", "start, x₂′(0) [m/s]")
    assert "x₁′(0) = −1.5 m/s" in sheet.note and "Not shown: the start drive (irregular)" in sheet.note
    several = sheet_of(basin(plane(), {"gamma": [0.5, 0.7, 0.9]}))
    assert [(title, int((shown.values == 3).sum())) for title, shown in cells(several)] == [
        ("γ = 0.5", 60), ("γ = 0.7", 60), ("γ = 0.9", 0),
    ]  # fmt: skip


def test_line_and_sample_of_starts():
    ds = basin(line())
    curve = sheet_of(ds).plots[0].layers[0]
    assert np.allclose(curve.x, 1e3 * ds["start_x2"]) and np.allclose(curve.y, ds["impact_velocity"])
    assert cells(sheet_of(basin(line(), {"gamma": LONG["gamma"]})))[0][1].values.shape == (40, 7)
    scattered = sheet_of(basin(sample()))
    striker = plot_of(scattered, ylabel="x₂′").layers[0]
    colours = [REGIME_COLOURS[3 if x > 0 else 6].lower() for x in striker.x]
    assert striker.colours == colours
    together = sheet_of(basin(sample()).drop_vars([f"start_{name}" for name in UNITS]))
    assert together.plots[0].title == "100 starts together"


def test_many_starts_at_each_point_are_shares_and_dots():
    ds = basin(sample(64), LONG)
    sheet = sheet_of(ds)
    for (_, shown), flag in zip(cells(sheet, "viridis"), (3, 6), strict=True):
        assert np.allclose(shown.values, 100.0 * (ds["regime"] == flag).mean("start").transpose("beta", "gamma"))
    along = basin(sample(50), {"gamma": LONG["gamma"]}, keep=4)
    diagram, strip = sheet_of(along).plots
    expected = {
        (x, y) for x, ys in zip(along["gamma"].values, along["impact_velocity"].values, strict=True) for y in ys
    }
    assert set(zip(diagram.layers[0].x, diagram.layers[0].y, strict=True)) == expected  # coincident dots are drawn once
    single = (along["regime"] == 3).sum("start").values
    assert np.array_equal((strip.layers[0].values == 3).sum(axis=0), single)
    assert (strip.layers[0].values[0] == np.where(single > 0, 3, 6)).all()  # stacked from the bottom


SHAPES = [(576,), (2, 100), (40, 9), (3, 11, 64), (12, 11, 8), (11, 7, 13, 2), (7, 7, 7, 7, 9)]


@pytest.mark.parametrize("shape", SHAPES)
def test_sweep_of_any_shape_fits_on_page(shape):
    *sizes, starts = shape
    grid = {
        name: np.linspace(0.3, 0.9, size) for name, size in zip(("gamma", "beta", "delta", "v"), sizes, strict=False)
    }
    for kind in (sample, line):
        sheet = sheet_of(basin(kind(starts), grid))
        assert sheet.size[0] <= PAGE[0] and sheet.size[1] <= PAGE[1] and len(sheet.plots) <= 60
        if np.prod(shape) > 4000:
            assert "Too many panels" in sheet.note or "starts" in sheet.note


# One axis.


@pytest.mark.parametrize("count", [2, 3, 4])
def test_coincident_lines_are_all_visible(count):
    first, *others = (nested_line(position, count) for position in range(count))
    assert first["dash"] == "-" and all(first["width"] > 1.5 * other["width"] for other in others)
    phase = np.linspace(0.0, 1.0, 1000, endpoint=False)
    drawn = []
    for offset, (on, off) in (other["dash"] for other in others):
        assert (on + off) == pytest.approx(2.6 * count)
        drawn.append((phase * (on + off) + offset) % (on + off) < on)
    # At most one of the others is drawn at a time, and the first shows in the gaps.
    assert np.sum(drawn, axis=0).max() == 1 and not np.any(drawn, axis=0).all()
    assert np.all(np.diff([nested_line(position, count)["size"] for position in range(count)]) < -0.2)


def test_one_axis_gives_line_per_start_above_regimes():
    ds = lanes({"gamma": np.linspace(0.3, 1.2, 11), "delta": [-0.005, 0.005]})
    sheet = sheet_of(ds)
    velocity, period, strip = (plot for plot in sheet.plots if plot.at["delta"] == -0.005)
    for curve, start in zip(velocity.layers, ("drive", "stuck"), strict=True):
        assert np.array_equal(curve.y, ds["impact_velocity"].sel(delta=-0.005, start=start), equal_nan=True)
        assert not curve.clip
    assert velocity.title == "Δ = −5 mm" and period.y.label == "period\n[s]"
    assert [text for _, text in strip.y.ticks] == ["drive", "stuck"]
    assert np.array_equal(strip.layers[0].values, ds["regime"].sel(delta=-0.005).transpose("start", "gamma"))
    assert {"start: drive", "start: stuck"} <= set(labels(sheet))


def test_diagram_of_each_start_is_over_those_of_others():
    ds = returns({"gamma": np.linspace(0.3, 1.2, 15)}, keep=6)
    ds["return_impact_velocity"][{"gamma": 3}] = np.nan
    assert returns_in(ds) == "return_impact_velocity"
    *diagrams, strip = bifurcation(ds).plots
    for start, plot in zip(("drive", "stuck"), diagrams, strict=True):
        grey, own = plot.layers
        assert plot.title == f"start: {start}" and np.isfinite(grey.y).sum() == np.isfinite(own.y).sum() == 14 * 6
        assert np.array_equal(own.y[:6], ds["return_impact_velocity"].sel(start=start)[0])
        assert own.order > grey.order and grey.sizes > 1.4 * own.sizes and not own.clip
    assert strip.layers[0].values.shape == (2, 15)
    with pytest.raises(InputError, match="keep_returns"):
        bifurcation(lanes(square(4)))


def test_rates_have_a_line_per_value_and_marks_of_motions():
    ds = rock({"k3": [1e8, 3e8], "force": np.linspace(1e5, 3e5, 7), "frequency": np.linspace(10, 40, 9)})
    sheet = sheet_of(ds)
    rate = next(plot for plot in sheet.plots if plot.at["k3"] == 3e8 and plot.y.name == "rate_of_penetration")
    curves = [layer for layer in rate.layers if layer.dash]
    assert np.allclose([curve.y for curve in curves], 1e3 * ds["rate_of_penetration"].sel(k3=3e8))
    hollow = [layer for layer in rate.layers if layer.face == "white"]
    assert sum(len(layer.x) for layer in hollow) == int((ds["rate_of_penetration"].sel(k3=3e8) == 0).sum()) > 0
    assert rate.y.limits[1] == pytest.approx(1.05 * 1e3 * float(ds["rate_of_penetration"].max()))  # of all rows
    assert {"A = 300 kN", "no penetration"} <= set(labels(sheet)) and {plot.x.name for plot in sheet.plots} == {
        "frequency",
        "relief",
    }
    jump = sheet_of(drill({"delta": np.linspace(-0.005, 0.012, 9)}, ("drive",))).plots[0]
    assert np.isnan(jump.layers[0].y).sum() == 1  # not joined to the other motion
    assert {layer.marker for layer in jump.layers[1:]} == {"o", "x"}
    dry = rates(ds.assign(rate_of_penetration=0.0 * ds["rate_of_penetration"]))
    resolved_plot = resolved(dry.plots)[0]
    assert resolved_plot.y.ticks == [(0.0, "0")] and resolved_plot.layers[-1].text == "no penetration"


def test_axis_without_spread_is_widened_and_groups_share_limits():
    flat, steep = (Plot([Line([0.0, 1.0], ends)], y=Axis(group="y")) for ends in ([0.25, 0.25], [0.2, 0.3]))
    assert resolved([flat])[0].y.limits == pytest.approx((0.225, 0.275))
    assert [plot.y.limits for plot in resolved([flat, steep])] == [pytest.approx((0.195, 0.305))] * 2
    through = Plot([Line([-np.inf, np.inf], [2.0, 2.0]), Line([1.0, 10.0], [1.0, np.nan])], Axis(log=True))
    (shown,) = resolved([through])
    assert shown.y.limits == pytest.approx((0.95, 2.05)) and shown.x.limits == pytest.approx((0.9, 1.1), rel=0.02)
    assert as_sheet([flat] * 4).plots[3].place == (1, 0)


# Motions.


def test_run_has_history_portraits_and_spectrum():
    ds = run()
    sheet = trajectory(ds)
    displacement, bit = plot_of(sheet, ylabel="displacement"), plot_of(sheet, title="bit")
    assert displacement.x.limits == pytest.approx((11.9995 - 1.5, 11.9995))
    assert plot_of(sheet, ylabel="whole run").x.limits[0] == 0.0
    assert {"bit", "striker", "bit sticks", "impact begins", "gap Δ = −6 mm", "impact force J"} <= set(labels(sheet))
    assert sheet.note == "β = 0.4, γ = 0.75, v = 1.5 m/s, Δ = −6 mm, start: drive"
    hits = next(layer for layer in bit.layers if layer.marker)
    assert len(hits.x) == 7  # in the last 1.5 s, at 4.4 Hz
    thick = max(bit.layers, key=lambda layer: layer.width)
    assert np.array_equal(np.isfinite(thick.y), ds["stuck"].where(ds["time"] >= 11.9995 - 1.5, drop=True) == 1)
    spectrum = plot_of(sheet, title="spectrum")
    assert [layer.text for layer in spectrum.layers if isinstance(layer, Text)] == ["4.4 Hz"]
    assert spectrum.x.limits[1] == pytest.approx(5 * 4.4, rel=1e-3)
    assert spectrum.layers[0].y.max() == pytest.approx(50 * (1 - 0.6 * np.exp(-9)), rel=0.1)  # mm, between two bins


def test_unusual_runs_are_drawn_or_refused():
    assert "impact begins" not in labels(trajectory(run(impacts=False)))
    bare = trajectory(run(duration=1.2).drop_attrs()[["x1", "v1", "x2", "v2"]])
    assert plot_of(bare, title="bit").y.label == "velocity x₁′ [m/s]"
    broken, resting = run(duration=4.0), run(duration=4.0)
    broken["x1"][5000:] = np.nan
    assert plot_of(trajectory(broken), ylabel="displacement").x.limits[1] == pytest.approx(2.4995)
    for name in ("x1", "v1", "x2", "v2"):
        resting[name][:] = 0.0
    assert not any(isinstance(layer, Text) for layer in plot_of(trajectory(resting), title="spectrum").layers)
    draw(trajectory(resting)).draw_without_rendering()
    for ds, message in ((run().drop_vars("v2"), "v2"), (run().isel(time=slice(5)), "5 finite samples")):
        with pytest.raises(InputError, match=message):
            trajectory(ds)


def test_more_pulses_than_pixels_become_band_between_extremes():
    few, many = bit_on_rock(), bit_on_rock(120_000)
    time = np.linspace(0.0, 10.0, 120_000)
    many = many.assign_coords(time=time).assign(applied_force=("time", 1e5 * (np.sin(4000 * np.pi * time / 10) > 0)))
    many["applied_force"][time > 5.0] *= 2.0  # the band follows this change
    given = [next(layer for layer in pulses(ds).plots[2].layers if layer.label == "given I") for ds in (few, many)]
    assert np.array_equal(given[0].y, 1e-3 * few["applied_force"]) and isinstance(given[1], Area)
    for low, high, top in ((1.0, 4.0, 100.0), (6.0, 9.0, 200.0)):
        part = (given[1].x > low) & (given[1].x < high)
        assert (given[1].low[part].min(), given[1].high[part].max()) == (0.0, top)
    assert len(given[1].x) < 3000 and "Bands: from the least to the greatest" in pulses(many).note
    assert not any(isinstance(layer, Area) and layer.step for layer in pulses(many).plots[3].layers)  # the last blows


def test_response_has_amplitudes_over_frequency():
    sheet = response(bit_on_rock(4000, **SINE))
    assert [plot.y.label.split("\n")[0] for plot in sheet.plots] == [
        "amplitude of",
        "amplitude of",
        "depth of the hole",
    ]
    depth = sheet.plots[2].layers[-1]
    assert np.all(np.diff(depth.x) > 0) and depth.y[-1] == pytest.approx(1.0, rel=0.1)  # mm
    with pytest.raises(InputError, match="not a swept sine"):
        response(bit_on_rock())


# Families.


def test_branches_have_stability_and_special_points():
    ds = one_family()
    first, second = branches(ds)
    (down,), (doubled,) = (stable_intervals(ds, branch) for branch in (first, second))
    assert (down.low, down.high, down.low_kind, down.high_kind) == (0.5, 0.9, "fold", "period-doubling")
    assert (doubled.low, doubled.high, doubled.low_kind, doubled.high_kind) == (0.9, 1.0, "period-doubling", "end")
    for side in (0, 1):  # the located point may lie on either side of the change
        ds["stable"][{"point": first.points[ds["gamma"].values[first.points] == 0.9]}] = side
        changes = ds["gamma"].values[first.points][1:-1][np.diff(stability(ds, first)) != 0]
        assert changes.tolist() == [0.9, 0.5]
    sheets = one_family(high=0.8).isel(point=slice(0, 19))
    sheets["gamma"][{"point": 0}] = 0.8
    first = next(branches(sheets))
    indices = places(sheets, first)
    at_end = sheets["special_value"].values[first.special] == 0.8
    ends = indices[at_end & (sheets["special_kind"].values[first.special] == END)]
    assert len(set(ends.tolist())) == 2


def test_family_has_lines_by_stability_and_marks_at_orbits():
    sheet = sheet_of(one_family())
    plot = plot_of(sheet, ylabel="x₁")
    solid, dashed = orbit_lines(plot)

    def ends(lines):
        known = np.concatenate([np.asarray(line.x)[np.isfinite(line.y)] for line in lines])
        return known.min(), known.max()

    assert ends(dashed) == (0.5, 1.0)
    assert ends([line for line in solid if line.colour == "#00598C"]) == pytest.approx((0.5, 0.9))
    assert ends([line for line in solid if line.colour == "#D1570A"]) == pytest.approx((0.9, 1.0))
    marks = marks_of(plot)
    assert {kind: len(where) for kind, where in marks.items()} == {"end": 3, "period-doubling": 1, "fold": 1}
    assert marks["fold"] == [pytest.approx((0.5, -35.0))] and marks["period-doubling"] == [pytest.approx((0.9, -63.0))]
    velocity = orbit_lines(plot_of(sheet, ylabel="impact velocity"))[0]
    last = sorted(float(line.y[-1]) for line in velocity if line.colour == "#D1570A")
    assert (
        last == pytest.approx([2.4 - np.sqrt(0.1), 2.4 + np.sqrt(0.1)])
        and "the least and the greatest blow" in sheet.note
    )
    ds = one_family()
    inner = ds.isel(point=(ds.branch.values == 0) & (ds.gamma.values <= 0.9) & (ds.stable.values == 1))
    x, y = (np.concatenate([getattr(line, name) for line in velocity]) for name in "xy")
    assert np.hypot(x[:, None] - inner.gamma.values, y[:, None] - inner.impact_velocity.values).min(axis=0).max() < 1e-9
    names = {"fold  1", "period-doubling  1", "end  3", "stable", "unstable", "repeats after one return"}
    assert names | {"repeats after 2 returns"} <= set(labels(sheet))


def test_smoothing_is_monotone_and_keeps_corners():
    x, step = np.linspace(0.0, 1.0, 7), np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0])
    ((along, up),) = smooth(x, step, np.array([], int))
    assert along.size > x.size and up.min() >= 0.0 and up.max() <= 1.0 and (np.diff(up) >= 0).all()
    left, right = smooth(x, np.abs(x - 0.5), np.array([3]))
    assert np.allclose(left[1], 0.5 - left[0]) and np.allclose(right[1], right[0] - 0.5)


def test_multipliers_are_in_plane_with_their_conjugates():
    sheet = sheet_of(one_family())
    moduli, plane_plot = plot_of(sheet, ylabel="largest modulus"), plot_of(sheet, title="multipliers")
    assert moduli.y.log and moduli.layers[0].y == [1.0, 1.0] and plane_plot.square
    shown = [layer for layer in plane_plot.layers if isinstance(layer, Points)]
    places_shown = {
        (round(float(x), 9) + 0.0, round(float(y), 9) + 0.0)
        for dots in shown
        for x, y in zip(dots.x, dots.y, strict=True)
    }
    assert places_shown == {(0.0, 0.5), (0.0, -0.5), (0.25, 0.0), (0.0, 3.0), (0.0, -3.0)}
    assert "The plane leaves out 10 of 19" in sheet.note and "largest modulus is drawn" not in sheet.note
    ds = one_family()
    ds["multiplier_abs"][{"point": 2, "multiplier": 0}] = 500.0
    assert "The largest modulus is drawn from 0.01 to 100" in sheet_of(ds).note


def test_kinds_of_special_points_and_families_look_different():
    drawn = {}
    for kinds in (np.arange(5), np.arange(2, 7)):
        ds = one_family().assign(special_kind=("special", kinds.astype(np.int8), FLAGS))
        drawn |= marks_of(plot_of(sheet_of(ds), ylabel="x₁"))
    assert set(drawn) == set(SPECIAL.split())
    several = sheet_of(several_families())
    assert len({line.colour for line in orbit_lines(plot_of(several, ylabel="x₁"))[0]}) == 3
    assert {"β = 0.3", "β = 0.4", "β = 0.5"} <= set(labels(several))


def test_families_are_laid_over_returns_within_the_axis():
    *diagrams, _ = sheet_of(swept(), [one_family()]).plots
    for plot in diagrams:
        low, high = plot.x.limits
        for path in (path for paths in orbit_lines(plot) for path in paths):
            inside = np.asarray(path.x)[np.isfinite(path.y)]
            assert inside.size == 0 or low <= inside.min() <= inside.max() <= high
        assert "period-doubling" in marks_of(plot) and "fold" not in marks_of(plot)  # 0.5 is outside the axis
    laid = bifurcation(swept(beta=[0.3, 0.4]), several_families((0.4, 0.5)))
    drawn = {plot.at["beta"]: bool(orbit_lines(plot)[0]) for plot in laid.plots if plot.title}
    assert drawn == {0.3: False, 0.4: True} and {"stable orbit", "period-doubling"} <= set(labels(laid))
    jumps = sheet_of(carried(), [one_family()])
    assert {"up", "down", "stable orbit", "unstable orbit"} <= set(labels(jumps))
    ds = one_family().assign(
        period=("point", 0.2 + 0.01 * one_family()["gamma"].values, {"units": "s", "long_name": "period"})
    )
    path, *_ = orbit_lines(plot_of(sheet_of(carried(keep=False), [ds]), ylabel="period"))[0]
    shown = np.isfinite(path.y)
    assert shown.any() and np.allclose(path.y[shown], 0.2 + 0.01 * path.x[shown], atol=1e-4)


@pytest.mark.parametrize(
    ("over", "message"),
    [
        (lambda: swept(), "over: no families of orbits"),
        (lambda: one_family().assign_attrs(along="orbit_x1"), "along orbit_x1, and the returns over gamma"),
        (lambda: one_family().assign_attrs(friction="coulomb"), "of friction coulomb, the returns of stribeck"),
        (lambda: one_family().assign_attrs(parameters='{"delta": 0.005}'), "delta = 0.005, the returns of −0.005"),
        (lambda: several_families((0.3, 0.5)), "the families are of beta = 0.3, 0.5, the returns of 0.4"),
    ],
)
def test_families_of_different_machine_are_refused(over, message):
    with pytest.raises(InputError, match=message) as error:
        picture(swept(), over=over())
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("values", "branch", "text"),
    [
        ([0.123456789012], [0], "1 on branch 0 at gamma 0.123456789"),
        ([0.5, 0.6, 0.7], [0, 1, 2], "1 on branch 0 at gamma 0.5; 2 on other branches"),
        ([0.1, 0.2, 0.3, 0.4, 0.5], [0] * 5, "5 on branch 0 at gamma 0.1, 0.2, 0.3, 0.4 (and 1 more up to 0.5)"),
    ],
)
def test_summary_lists_special_points(values, branch, text):
    """Counts and values belong to the same branch. The kinds follow each file's own flag meanings."""
    for meanings in (SPECIAL, " ".join(reversed(SPECIAL.split()))):
        kind = np.full(len(values), meanings.split().index("stick"), np.int8)
        ds = one_family().drop_dims("special")
        ds["special_kind"] = ("special", kind, FLAGS | {"flag_meanings": meanings})
        ds["special_value"], ds["special_branch"] = ("special", values), ("special", np.array(branch))
        ds["special_note"] = ("special", np.full(len(values), ""))
        (stick,) = (line for line in family_lines(ds) if line.startswith("stick"))
        assert stick.removeprefix("stick").strip() == text


# Laws and studies.


def test_law_has_coefficients_with_errors_and_evidence():
    fit = law({"force": [2e5, 2.5e5, 3e5]})
    coefficient, evidence = sheet_of(fit).plots
    seen = (layer for layer in coefficient.layers if layer.marker not in ("", "_") and np.isfinite(layer.y).any())
    lines = {layer.marker: layer for layer in seen}
    assert set(lines) == {"o", "D"}  # onset and line, which the data do not reject
    onset = 1e3 * fit["C"].sel(form="onset")[2].item()
    assert np.isnan(lines["o"].y[:2]).all() and lines["o"].y[2] == pytest.approx(onset)
    spans = [layer for layer in coefficient.layers if layer.marker == "_" and layer.colour == lines["o"].colour]
    assert np.allclose(spans[0].y[6:8], onset * np.array([0.95, 1.05]))
    above = {layer.marker: layer.y.tolist() for layer in evidence.layers if isinstance(layer, Line)}
    assert above["D"] == [0.0, 0.0, 30.0] and above["v"] == [3.0, 3.0, 30.0] and above["o"] == [30.0, 30.0, 0.0]
    best, shown = (layer for _, layer in cells(sheet_of(EXPECTED["law_map"]()), "forms")[:1] for _ in (0, 1))
    names = np.array(FORMS)[best.values.astype(int)]
    assert set(names[:, -1]) == {"onset"} and set(names[:, 0]) == {"line"} and best is shown


@pytest.mark.parametrize("columns", [("rpm",), ("rpm", "bit")])
def test_fit_shows_data_and_curves_of_groups(tmp_path, columns):
    rows = [",".join([*columns, "relief", "rate_of_penetration"])]
    for group in range(8):
        for eta in np.linspace(0.6, 3.0, 12):
            rate = 2e-5 * (80 + 40 * group) * max(np.log(eta / 1.1), 0.0)
            rows.append(
                ",".join([str(80 + 40 * group), "AB"[group % 2]][: len(columns)] + [f"{eta:.4f}", f"{rate:.8f}"])
            )
    (tmp_path / "rig.csv").write_text("\n".join(rows) + "\n")
    fit = vj.fit_rop(tmp_path / "rig.csv", by=columns, progress=False)
    sheet = sheet_of(fit)
    assert len(sheet.above.plots) == 6 and "Data and curves of 6 of 8 groups" in sheet.note
    plot = sheet.above.plots[0]
    assert plot.title.split("\n")[0] == ("rpm = 80" if len(columns) == 1 else "rpm = 80, bit: A")
    assert ("C = 1.6 ± " in plot.title) == (len(columns) > 1)  # without an axis of the groups, on which C is drawn
    (curve,) = (layer for layer in plot.layers if isinstance(layer, Line) and layer.colour == "#004488")
    group = fit.isel(group=0).sel(form="onset")
    assert np.allclose(curve.y, 1e3 * float(group["C"]) * np.log(curve.x / float(group["eta0"])), atol=1e-6)
    data, censored = (layer for layer in plot.layers if isinstance(layer, Line) and not layer.dash)
    assert len(data.x) + len(censored.x) == 12 and censored.face == "white" and not np.any(censored.y)
    assert {"data", "no penetration (censored)", "onset\nC ln(η/η₀)"} <= set(labels(sheet))


def test_studies_show_their_numbers():
    shares, pairs = sheet_of(EFFECTS).plots
    alone, total = (layer for layer in shares.layers if isinstance(layer, Bars))
    assert alone.width.tolist() == [0.4, 0.6] == total.width.tolist()
    assert np.argwhere(np.isfinite(pairs.layers[0].values)).tolist() == [[1, 0]]
    sides = sheet_of(PUSHES).plots[0]
    assert [layer.height[0] for layer in sides.layers if isinstance(layer, Bars)] == pytest.approx([2e-3, 1e-3])
    assert [layer.text for layer in sides.layers if isinstance(layer, Text)] == ["returns", "0.001"]
    plane_plot = sheet_of(BEST).plots[0]
    square_marks = next(layer for layer in plane_plot.layers if isinstance(layer, Points))
    assert square_marks.x.tolist() == [0.3, 0.5] and {"best candidate", "others", "map: not feasible"} <= set(
        labels(sheet_of(BEST))
    )
    texts_shown = [layer.text for layer in sheet_of(SLOPES).plots[0].layers[1:]]
    assert texts_shown == ["0.20", "−0.70"]
    drive, any_start = sheet_of(BORDERS).plots
    assert drive.title == "start drive: 40 % of the plane" and labels(sheet_of(BORDERS)) == ["basin"]
    assert any_start.layers[0].text.replace("\n", " ") == "no border: a single impact is stable everywhere"
    along = sheet_of(ATTRACTORS).plots[0]
    tops = [layer.high.tolist() for layer in along.layers if isinstance(layer, Area)]
    assert tops == [pytest.approx([70.0, 100.0]), pytest.approx([100.0, 100.0])]
    with pytest.raises(InputError, match="chart: the dataset holds no impacts over a grid"):
        chart(ATTRACTORS)


# Words of axes and notes.


@pytest.mark.parametrize(
    ("counts", "text"),
    [
        ({"within": 34, "estimated": 35, "still_settling": 1, "sensitive": 1},
         "34 of 35 lanes that repeat are known to 0.0001, 1 is still settling, 1 is sensitive to rounding"),
        ({"within": 1, "estimated": 1, "still_settling": 0}, "1 of 1 lane that repeats is known to 0.0001"),
        ({"within": 0, "estimated": 3, "still_settling": 2},
         "0 of 3 lanes that repeat are known to 0.0001, 2 are still settling"),
    ],
)  # fmt: skip
def test_count_agrees_with_noun(counts, text):
    ds = xr.Dataset(attrs={"certified": json.dumps(counts | {"error": 1e-4})})
    assert certified_text(ds) == text
    assert [counted(n, "point") for n in (0, 1, 2)] == ["0 points", "1 point", "2 points"]


def test_shares_are_not_rounded_up_and_starts_have_no_quotes():
    assert share_text(1 - 1e-15) == "100 %" and share_text(0.995) == ">99 %"
    assert short('"drive"') == "drive" and short("[0.0, 0.125]") == "[0, 0.125]"
    assert point_text(xr.Dataset(attrs={"start": '"drive"'})) == "start: drive"


@pytest.mark.parametrize(
    ("name", "long_name", "symbol", "unit", "shown"),
    [
        ("frequency", "pulses per second", "f", "s-1", "Hz"),
        ("sweep_rate", "rate of the swept sine's frequency", "r", "s-2", "Hz/s"),
        ("decay", "rate of decay", "κ", "s-1", "1/s"),
        ("frequency", "frequency of the imbalance", "w", "s-1", "1/s"),  # the unit does not say whether it is angular
        ("w", "angular frequency of the imbalance", "w", "s-1", "rad/s"),
        ("omega", "forcing", "", "s-1", "rad/s"),
        ("forcing", "forcing", "Ω", "rad s-1", "rad/s"),
        ("forcing", "angular acceleration", "α", "s-2", "rad/s²"),
    ],
)
def test_hertz_is_used_only_for_frequencies(name, long_name, symbol, unit, shown):
    attrs = {"long_name": long_name, "units": unit} | ({"symbol": symbol} if symbol else {})
    data = xr.DataArray([10.0], dims=name, name=name, attrs=attrs)
    assert label(data).replace("\n", " ").endswith(f" [{shown}]")
    assert value_text(data, 10.0).endswith(f" = 10 {shown}")
    assert scale(data)[0] == 1.0  # values are not converted, so none can be off by 2 pi


@pytest.mark.parametrize(
    ("scene", "differing", "text"),
    [
        ("penetration", [], "f = 20 Hz"),
        ("penetration", [{"symbol": "f", "units": "s-1"}], "f = 20 Hz"),
        ("own", [], ""),  # at its default, in an unknown unit
        ("own", [{"symbol": "w", "units": "rad s-1"}], "w = 20 rad/s"),
    ],
)
def test_notes_use_unit_of_custom_scene_frequency(scene, differing, text):
    records = [{"name": "frequency", "value": 20.0, "default": 10.0} | record for record in differing]
    attrs = {"scene": scene, "parameters": '{"frequency": 20.0}', "differing": json.dumps(records)}
    assert point_text(xr.Dataset(attrs=attrs)) == text


def test_note_lists_values_that_differ_from_defaults():
    changed = [
        {"name": "k0", "symbol": "k₀", "units": "N m-1", "value": 2e7, "default": 5e7},
        {"name": "delta", "symbol": "Δ", "units": "m", "value": -0.006, "default": -0.005},
    ]
    ds = run().assign_attrs(differing=json.dumps(changed), friction="coulomb")
    assert point_text(ds) == "β = 0.4, γ = 0.75, v = 1.5 m/s, Δ = −6 mm, k₀ = 20 MN/m, friction: coulomb, start: drive"


# Figures and files.


def test_notes_and_titles_stay_within_page():
    words = "Attractors 2, 3, 4 pass the section outside the picture; twenty lanes of 400 end in none. "
    sheet = replace(bifurcation(returns({"gamma": np.linspace(0.3, 1.2, 15)}, keep=4)), size=(6.6, 4.4))
    for length in range(0, len(words), 15):
        figure = draw(replace(sheet, note=" ".join([(2 * words)[length : length + len(words)]] * 2)))
        for dpi in (72, 100, 150):  # a notebook draws the picture later, with its own settings
            figure.set_dpi(dpi)
            (note,) = (text for text in figure.texts if text.get_text() == figure.get_supxlabel())
            assert note.get_window_extent(FigureCanvasAgg(figure).get_renderer()).x1 <= figure.bbox.x1
    title = "Impact velocity at each return over the frequency ratio"
    assert draw(replace(sheet, size=(7.6, 4.4), title=title)).get_suptitle() == title
    for long in ("word " * 900, "w" * 900):
        figure = draw(replace(sheet, title=long))
        assert figure.get_suptitle().endswith("…") and figure.get_suptitle().count("\n") <= 2
        whole = figure.bbox.padded(1)
        assert all(whole.x0 <= box.x0 and box.x1 <= whole.x1 for _, box in texts(figure))


def test_tick_labels_of_colour_bars_do_not_overlap():
    ds = points(12)
    ds["period"].values[:] = np.linspace(0.2143, 0.2328, 12)
    figure = picture(ds.isel(point=ds["start"].values == "drive"))
    figure.draw_without_rendering()
    (bar,) = (axes for axes in figure.axes if axes.get_xlabel().startswith("period"))
    low, high = bar.get_xlim()
    marks = [tick.label1 for tick in bar.xaxis.get_major_ticks() if low <= tick.get_loc() <= high]
    boxes = sorted((text.get_window_extent() for text in marks), key=lambda box: box.x0)
    assert all(left.x1 + 4 < right.x0 for left, right in pairwise(boxes))


def test_user_settings_are_ignored_and_texts_are_not_formulas():
    ds = lanes({"gamma": np.linspace(0.3, 1.2, 20)}).assign_attrs(title="a $x_1$ of $5")
    with matplotlib.rc_context({"axes.titlesize": 40, "xtick.labelsize": 30, "axes.facecolor": "red"}):
        before = dict(matplotlib.rcParams)
        figure = picture(ds)
        assert dict(matplotlib.rcParams) == before
        assert {text.get_size() for axes in figure.axes for text in axes.get_xticklabels()} <= {8.0}
    assert to_hex(figure.axes[0].get_facecolor()) == "#ffffff" and figure.get_suptitle() == r"a \$x_1\$ of \$5"
    assert isinstance(figure, Figure) and figure._repr_png_().startswith(b"\x89PNG")


def test_figure_of_own_rule_is_returned_as_it_is():
    figure = Figure()
    assert draw(figure) is figure
    assert len(draw([Plot([Line([0.0, 1.0], [0.0, 1.0])])] * 4).axes) == 4


def test_pyplot_is_not_imported():
    code = "import sys, vibrojax.studies.choose; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize(("suffix", "begins"), [(".PNG", b"\x89PNG"), (".pdf", b"%PDF"), (".svg", b"<?xml")])
def test_picture_is_saved_the_same_in_format_of_suffix(tmp_path, suffix, begins):
    path = tmp_path / f"map{suffix}"
    contents = []
    for _ in range(2):
        save_picture(lanes(square(3)), path)
        contents.append(path.read_bytes())
    assert contents[0] == contents[1] and contents[0].startswith(begins) and list(tmp_path.iterdir()) == [path]


def test_failed_save_keeps_existing_picture(tmp_path, monkeypatch):
    path = tmp_path / "map.png"
    save_picture(lanes(square(3)), path)
    old = path.read_bytes()

    def fail_with_full_disk(self, name, **_):
        open(name, "wb").close()
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Figure, "savefig", fail_with_full_disk)
    with pytest.raises(InputError, match="No space left"):
        save_picture(lanes(square(3)), path)
    assert path.read_bytes() == old and list(tmp_path.iterdir()) == [path]
    for name in ("map.jpg", "map", "nowhere/map.png"):
        with pytest.raises(InputError, match="map"):
            save_picture(lanes(square(3)), tmp_path / name)


def test_sheet_without_layers_is_drawn():
    draw(Sheet([Plot([])])).draw_without_rendering()
