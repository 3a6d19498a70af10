"""Test pictures: one per rule, and what their plots show; the axes, colours and layout that they share."""

import json
import re

import drawn
import matplotlib
import numpy as np
import pytest
import xarray as xr
from drawn import cells, check_texts, labels, lanes, one_family, plot_of, returns, run, sheet_of, square
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from refusals import refusal

import vibrojax as vj
from vibrojax.explorer.plots_view import items_of
from vibrojax.io.kinds import STRUCTURES
from vibrojax.io.variables import REGIMES
from vibrojax.pictures.axes import value_text
from vibrojax.pictures.branches import branches, stability, stable_intervals
from vibrojax.pictures.chart import chart
from vibrojax.pictures.colours import REGIME_COLOURS
from vibrojax.pictures.contents import Contents, returns_in
from vibrojax.pictures.draw import draw
from vibrojax.pictures.hole import pulses
from vibrojax.pictures.maps import regime_dots
from vibrojax.pictures.motion import states_over_time, trajectory
from vibrojax.pictures.plots import Area, Bars, Line, Points, Text
from vibrojax.pictures.returns import bifurcation
from vibrojax.pictures.style import NO_VALUE
from vibrojax.studies.analysis import analysis_named, analysis_of
from vibrojax.studies.attractors import attractor_colours


def bit_on_rock(count=400, pulses=20, **attributes):
    """Return a second of the bit on rock under pulses, with a hole that grows."""
    time = np.linspace(0.0, 1.0, count)
    force = 2e5 * (np.sin(2 * pulses * np.pi * time) > 0)
    depth = 1e-3 * time
    series = {"x3": depth + 1e-5 * force / 2e5, "x4": depth, "applied_force": force, "rock_force": 0.5 * force}
    return xr.Dataset({name: ("time", x) for name, x in series.items()}, {"time": time}, attributes)


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
SHARES |= {"share_stderr": (("gamma", "attractor"), 0.05 * np.ones((2, 2)))}
SHARES |= {"regime": (("gamma", "attractor"), [[3, 6]] * 2)}
SHARES |= {"impact_velocity": (("gamma", "attractor"), [[2.0, 1.0], [2.5, np.nan]], {"units": "m s-1"})}
SHARES |= {"lane_attractor": (("gamma", "start"), [[0, 0, 1], [0, 0, -1]])}
ATTRACTORS = xr.Dataset(SHARES, {"gamma": [0.6, 0.7]}, {"title": "Attractors", "parameters": json.dumps({"v": 1.5})})
OVER_TWO = ATTRACTORS.isel(gamma=[0, 1] * 3).assign_coords(gamma=np.arange(6.0)).expand_dims(beta=np.arange(6.0))
PUSHES = {f"push_{name}": ("sign", [np.nan, 1e-3]) for name in ("x1", "v1")} | {"period": 0.2, "regime": 3}
PUSHES |= {f"regime_{name}": ("sign", [0, 6]) for name in ("x1", "v1")} | {"bound_x1": 2e-3, "bound_v1": 3e-3}
PUSHES = xr.Dataset(PUSHES, {"sign": [-1, 1]}, {"title": "Pushes"})
SIDE = {"place": ("sample", [0, 1, 1]), "regime": ("sample", [3, 3, 6]), "impact_velocity": ("sample", [2.0, 2.1, 1.9])}
BOX = xr.Dataset(SIDE, {"beta": ("sample", [0.4, 0.39, 0.41])}, {"kind": "tolerance", "tolerance_beta": 0.01})
VALID = {"valid": ("lane", [1, 1]), "reason": ("lane", [0, 0]), "period": ("lane", [0.2, 0.2])}
OF_EACH = {"parameter_value": [0.4, 0.7], "d_period": [1.0, -2.0]}
VALID |= {name: (("lane", "parameter"), [x] * 2) for name, x in OF_EACH.items()}
SLOPES = xr.Dataset(VALID, {"parameter": ["beta", "gamma"]}, {"kind": "sensitivity"})
INDICES = {name: (("of", "parameter"), [[0.4, 0.6]]) for name in ("first_order", "total_order", "effect")}
INDICES |= {f"{name}_conf": (("of", "parameter"), [[0.1, 0.1]]) for name in ("first_order", "total_order")}
PAIRS = [[[np.nan, 0.2], [0.2, np.nan]]]
INDICES |= {name: (("of", "parameter", "other"), PAIRS) for name in ("second_order", "second_order_conf")}
INDICES |= {name: ("of", [1.0]) for name in ("mean", "std")} | {"sobol_reason": ("of", [0]), "of_unit": ("of", ["s"])}
EFFECTS = xr.Dataset(INDICES, {"of": ["period"], "parameter": ["beta", "gamma"]}, {"kind": "study"})
DRAWS = np.random.default_rng(0).normal([0.4, 0.7], 0.01, (50, 2))
ESTIMATED = {name: ("parameter", [0.4, 0.7]) for name in ("estimate", "estimate_low", "estimate_high", "low", "high")}
ESTIMATED |= {"estimate_stderr": ("parameter", [0.01, 0.01]), "posterior": (("draw", "parameter"), DRAWS)}
ESTIMATED |= {"direction": (("combination", "parameter"), np.eye(2)), "direction_error": ("combination", [0.01, 2.0])}
ESTIMATED |= {"parameter_unit": ("parameter", ["1", "1"]), "residual": (("observation", "of"), [[0.1], [-0.2]])}
ESTIMATED |= {name: (("observation", "of"), [[0.2], [0.3]]) for name in ("observed", "predicted")}
MEANS = {"flag_values": [0, 1], "flag_meanings": "identified at-bound"}
ESTIMATED |= {"reason": ("parameter", [0, 1], MEANS)}
ESTIMATES = xr.Dataset(ESTIMATED, {"parameter": ["beta", "gamma"], "of": ["period"]}, {"kind": "calibration"})
LOG = dict.fromkeys(("specific_energy", "rate_of_penetration", "weight_on_bit", "depth"), ("row", np.linspace(1, 2, 9)))
LOG |= {"founder_weight": 1.5, "slope_below": 1.0, "slope_above": 0.2, "founder_reason": 0}
LOG = xr.Dataset(LOG, attrs={"kind": "rig"})
CANDIDATES = {"objective": ("candidate", [2.0, 1.0]), "map_feasible": ("map", [1, 0, 1])}
CANDIDATES |= {name: ("candidate", [0.4, 0.5]) for name in ("beta", "gamma")}
CANDIDATES |= {f"map_{name}": ("map", [0.3, 0.4, 0.5]) for name in ("beta", "gamma")}
CANDIDATES |= {"map_objective": ("map", [1.0, np.nan, 2.0], {"units": "J", "long_name": "energy on the map"})}
CANDIDATES |= {"objective_worst": CANDIDATES["objective"]}
BEST = xr.Dataset(CANDIDATES, {"parameter": ["beta", "gamma"]}, {"kind": "design", "tolerance_beta": 0.01})
TIME = np.arange(32.0)
OSCILLATION = xr.Dataset({"x": ("time", np.sin(TIME)), "v": ("time", np.cos(TIME))}, {"time": TIME})

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
    "hysteresis": drawn.carried,
    "work_precision": lambda: STUDY,
    "bifurcation": lambda: returns({"gamma": np.linspace(0.3, 1.2, 20), "delta": [-0.005, 0.005]}),
    "law_lines": lambda: drawn.law({"k3": [1e8, 3e8], "force": [2e5, 2.5e5, 3e5]}),
    "many_starts": lambda: drawn.basin(drawn.sample(), drawn.LONG),
    "rates": lambda: drawn.rock({"k3": [1e8, 3e8], "force": [1e5, 2e5, 3e5], "frequency": np.linspace(10, 40, 9)}),
    "regime_grid": lambda: lanes(square(8, delta=[-0.005, 0.005])),
    "regime_lines": lambda: lanes({"gamma": np.linspace(0.3, 1.2, 20)}),
    "regime_dots": lambda: drawn.points(also_v=True),
    "rate_grid": lambda: drawn.rock({"force": np.linspace(1e5, 3e5, 9), "frequency": np.linspace(10.0, 40.0, 9)}),
    "design_picture": lambda: BEST,
    "elasticities": lambda: SLOPES,
    "bars_and_interactions": lambda: EFFECTS,
    "calibration_picture": lambda: ESTIMATES,
    "rig_picture": lambda: LOG,
}
FORCES = {"force": np.linspace(2e5, 3e5, 9), "k3": np.linspace(1e8, 5e8, 9), "zeta": [0.5, 1]}
OTHERS = {
    "map-of-many": lambda: lanes(square(3, v=[0.5, 1.0], delta=[-0.005, 0.0, 0.005])),
    "points": drawn.points,
    "phase-planes": lambda: drawn.basin(drawn.sample()),
    "rock-of-one": lambda: drawn.rock({}),
    "law-of-one": lambda: drawn.law({}),
    "law-of-many": lambda: drawn.law(FORCES),
    "several-families": drawn.several_families,
}


def first_rule(ds):
    return next((rule.draw.__name__ for rule in analysis_of(ds).pictures if rule.fits(Contents(ds))), None)


def test_every_rule_has_dataset():
    analyses = [analysis_named(kind) for kind in ("sweep", "fit", *STRUCTURES)]
    assert {rule.draw.__name__ for analysis in analyses for rule in analysis.pictures} == set(EXPECTED)


@pytest.mark.parametrize("name", EXPECTED | OTHERS)
def test_first_rule_that_fits_draws_texts_without_overlap(name):
    """No text leaves the picture or lies over another, under a long title and in the column of a journal."""
    if name in OTHERS:
        check_texts(vj.picture(OTHERS[name]()))
        return
    ds = EXPECTED[name]()
    assert first_rule(ds) == name
    whole = vj.picture(ds.assign_attrs(title=f"{ds.attrs.get('title', 'A drill')} " * 12))
    check_texts(whole)
    column = vj.picture(ds, width="85mm")
    assert column.get_figwidth() == pytest.approx(85 / 25.4)
    assert max(whole.get_figheight(), column.get_figheight()) <= 235 / 25.4
    check_texts(column)


def test_rules_depend_on_contents():
    assert first_rule(drawn.law({"group": np.arange(12)}).drop_vars("group")) == "law_lines"
    assert first_rule(xr.Dataset({"threshold": 1.0})) is None
    assert "nothing to draw" in refusal(vj.picture, xr.Dataset({"threshold": 1.0}))


def test_wrong_widths_and_names_are_refused(tmp_path):
    for width in ("wide", "3 m", "-85mm", 0, 1e9):
        with pytest.raises(vj.InputError, match=r"width: .* give one like 85mm or 170mm"):
            vj.picture(EXPECTED["regime_grid"](), width=width)
    for name in ("map.jpg", "map", "nowhere/map.png"):
        assert "map" in refusal(vj.save_picture, lanes(square(3)), tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_points_over_three_parameters_are_drawn_over_each():
    """Columns are the parameters, with the starts of the points; dots have the colours of the regimes."""
    ds = drawn.points(also_v=True)
    plots = regime_dots(ds).plots
    assert [plot.x.name for plot in plots] == 2 * ["beta", "gamma", "v", "start"]
    assert {len(plot.layers[0].x) for plot in plots if plot.x.name != "start"} == {40}
    assert set(plots[0].layers[0].colours) == {REGIME_COLOURS[flag] for flag in (2, 3, 6)}


def test_rates_in_a_column_have_panels_of_one_width_and_whole_lines():
    ds = EXPECTED["rates"]()
    slips = sheet_of(ds).plots[2]
    assert slips.y.name == "slip_per_impact"
    assert {layer.dash for layer in slips.layers if isinstance(layer, Line)} == {"-", ""}
    panels = vj.picture(ds, width="85mm").axes
    assert len({round(axes.get_position().width, 2) for axes in panels}) == 1
    assert panels[0].get_xlabel().startswith("pulses") and panels[1].get_xlabel() == "relief P/D"


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
    assert {"mass ratio m₂/m₁, β", "frequency ratio ω₂/ω₁, γ"} <= words
    assert {scale.label for scale in drawn.scales(sheet)} == {"impact velocity [m/s]", "period [s]"}
    assert len({(scale.norm.vmin, scale.norm.vmax) for scale in drawn.scales(sheet)}) == 2


def test_each_flag_has_its_colour_and_others_are_refused():
    for flag in range(8):
        _, shown = cells(sheet_of(lanes(square(4), regime=flag)))[0]
        assert to_hex(shown.colour_map(shown.norm(shown.values))[0, 0]).upper() == REGIME_COLOURS[flag]
    ds = lanes(square(4))
    ds["regime"].values[1, 2] = 9
    names = " ".join([*REGIMES, "hopping", "rattling"])
    ds["regime"].attrs |= {"flag_values": np.arange(10, dtype=np.int8), "flag_meanings": names}
    assert "regime: flag 9 (rattling) is not a regime with a colour" in refusal(vj.picture, ds)


def test_lanes_without_value_are_hatched():
    ds = lanes(square(6), ("drive",))
    ds["impact_velocity"][{"beta": 2, "gamma": 3, "start": 0}] = np.nan
    (_, shown), *_ = cells(sheet_of(ds), "viridis")
    assert np.argwhere(np.isnan(shown.values)).tolist() == [[2, 3]] and "no value" in labels(sheet_of(ds))
    figure = vj.picture(ds)
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


def test_many_starts_at_each_point_are_shares_and_dots():
    ds = drawn.basin(drawn.sample(64), drawn.LONG)
    sheet = sheet_of(ds)
    for (_, shown), flag in zip(cells(sheet, "viridis"), (3, 6), strict=True):
        assert np.allclose(shown.values, 100.0 * (ds["regime"] == flag).mean("start").transpose("beta", "gamma"))
    along = drawn.basin(drawn.sample(50), {"gamma": drawn.LONG["gamma"]}, keep=4)
    diagram, strip = sheet_of(along).plots
    dots = {(x, y) for x, ys in zip(along["gamma"].values, along["impact_velocity"].values, strict=True) for y in ys}
    assert set(zip(diagram.layers[0].x, diagram.layers[0].y, strict=True)) == dots  # coincident dots are drawn once
    single = (along["regime"] == 3).sum("start").values
    assert np.array_equal((strip.layers[0].values == 3).sum(axis=0), single)
    assert (strip.layers[0].values[0] == np.where(single > 0, 3, 6)).all()  # stacked from the bottom


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
    hollow = lanes({"gamma": np.linspace(0.3, 1.2, 11)}, ("drive",))
    hollow["cycles"] = (hollow["gamma"] < 0.5) & (hollow["start"] == "drive")
    (_, means), shown = (sheet_of(hollow).plots[0].layers, labels(sheet_of(hollow)))
    assert means.x.tolist() == hollow["gamma"].values[3:].tolist() and "mean: does not repeat" in shown


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
    assert "keep_returns" in refusal(bifurcation, lanes(square(4)))


def test_unusual_runs_are_drawn_or_refused():
    assert "impact begins" not in labels(trajectory(run(impacts=False)))
    broken, resting = run(duration=4.0), 0.0 * run(duration=4.0)[["x1", "v1", "x2", "v2"]]
    broken["x1"][5000:] = np.nan
    assert plot_of(trajectory(broken), ylabel="displacement").x.limits[1] == pytest.approx(2.4995)
    assert not any(isinstance(layer, Text) for layer in plot_of(trajectory(resting), title="spectrum").layers)
    draw(trajectory(resting)).draw_without_rendering()
    for ds, message in ((run().drop_vars("v2"), "v2"), (run().isel(time=slice(5)), "5 finite samples")):
        with pytest.raises(vj.InputError, match=message):
            trajectory(ds)


def test_states_jump_at_impacts_between_samples():
    """x = 1 - |t - 10.3| hits a stop at x = 1: the velocity jumps and the marker lies there, beside a section."""
    time = np.arange(32.0)
    meanings = {"flag_values": [0, 1], "flag_meanings": "impact section"}
    hits = {"event_time": ("event", [10.3, 11.2]), "event_kind": ("event", [0, 1], meanings)}
    states = {"x": ("time", 1.0 - np.abs(time - 10.3)), "v": ("time", np.sign(10.3 - time))}
    x_plot, v_plot, portrait = states_over_time(xr.Dataset(states | hits | {"period": 3.0}, {"time": time})).plots
    _, late = portrait.layers
    jump = np.flatnonzero(np.diff(np.round(late.y)))
    np.testing.assert_allclose([*x_plot.layers[1].y, *late.x[[jump, jump + 1]].ravel()], 1.0, rtol=1e-12)
    np.testing.assert_allclose(v_plot.layers[0].x[[jump, jump + 1]].ravel(), 10.3)
    assert np.ptp(late.x + np.abs(v_plot.layers[0].x - 10.3)) < 1e-12


def test_long_run_on_rock_shows_its_last_blows():
    whole, *panels = pulses(bit_on_rock(40_000, 400)).plots
    left, right = (plot.x.limits[0] for plot in panels[:2])
    assert whole.x.limits == (0.0, 1.0) and right - left == pytest.approx(8 / 400, abs=1e-4)
    assert not any(isinstance(layer, Area) and layer.step for plot in panels for layer in plot.layers)


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


def test_families_are_laid_over_returns_within_the_axis():
    *diagrams, _ = sheet_of(drawn.swept(), [one_family()]).plots
    for plot in diagrams:
        low, high = plot.x.limits
        for path in (path for paths in drawn.orbit_lines(plot) for path in paths):
            inside = np.asarray(path.x)[np.isfinite(path.y)]
            assert inside.size == 0 or low <= inside.min() <= inside.max() <= high
        marks = drawn.marks_of(plot)
        assert "period-doubling" in marks and "fold" not in marks  # 0.5 is outside the axis
    laid = bifurcation(drawn.swept(beta=[0.3, 0.4]), drawn.several_families((0.4, 0.5)))
    has_lines = {plot.at["beta"]: bool(drawn.orbit_lines(plot)[0]) for plot in laid.plots if plot.title}
    assert has_lines == {0.3: False, 0.4: True} and {"stable orbit", "period-doubling"} <= set(labels(laid))
    jumps = sheet_of(drawn.carried(), [one_family()])
    assert {"up", "down", "stable orbit", "unstable orbit"} <= set(labels(jumps))
    with pytest.raises(vj.InputError, match=r"delta = 0\.005, the returns of −0.005"):  # of another machine
        vj.picture(drawn.swept(), over=one_family().assign_attrs(parameters='{"delta": 0.005}'))


def test_studies_show_their_numbers():
    shares, pairs = sheet_of(EFFECTS).plots
    alone, total = (layer for layer in shares.layers if isinstance(layer, Bars))
    assert alone.width.tolist() == [0.4, 0.6] == total.width.tolist()
    assert np.argwhere(np.isfinite(pairs.layers[0].values)).tolist() == [[1, 0]]
    assert np.argwhere(np.isfinite(pairs.layers[1].values)).tolist() == [[1, 0]]  # pale: within its error
    assert [item["colours"] for item in items_of(pairs) if item["kind"] == "cells"][1] == ["#f2f2f2"]
    sides = sheet_of(PUSHES).plots[0]
    assert [layer.height[0] for layer in sides.layers if isinstance(layer, Bars)] == pytest.approx([2e-3, 1e-3])
    assert [layer.text for layer in sides.layers if isinstance(layer, Text)] == ["0.001"]
    plane_plot = sheet_of(BEST).plots[0]
    square_marks = next(layer for layer in plane_plot.layers if isinstance(layer, Points))
    assert square_marks.x.tolist() == [0.3, 0.5]
    assert {"best candidate", "other candidates", "map: not feasible"} <= set(labels(sheet_of(BEST)))
    [slopes] = sheet_of(SLOPES).plots
    assert slopes.scale.label == "elasticity" and [layer.text for layer in slopes.layers[1:]] == ["2.0", "−7.0"]
    drive, any_start = sheet_of(BORDERS).plots
    assert drive.title == "start drive: 40 %"
    assert labels(sheet_of(BORDERS)) == ["basin (the start leads elsewhere)"]
    assert any_start.layers[0].text.replace("\n", " ") == "no border: a single impact is stable everywhere"
    along = sheet_of(ATTRACTORS).plots[0]
    assert attractor_colours(ATTRACTORS) == [REGIME_COLOURS[flag].lower() for flag in (3, 6)]
    tops = [(layer.y + layer.height).tolist() for layer in along.layers if isinstance(layer, Bars)]
    assert tops == [pytest.approx([70.0, 100.0]), pytest.approx([100.0, 100.0])]
    assert "chart: the dataset holds no impacts over a grid" in refusal(chart, ATTRACTORS)
    times = STUDY.time_per_lane_second / 9  # the range of measured times is in the panel
    (plot,) = sheet_of(STUDY.assign(time_per_lane_second_min=times)).plots
    assert plot.x.limits[0] < 1e6 * float(times.min())


def test_rows_beyond_the_panel_of_a_fit_are_counted():
    """The fitted rows set the limits; the axis counts the failed ones above the panel and at its right."""
    data = {
        "relief": [0.5, 1.0, 1.5, 1.2, 1.0, 9.0, 1.2],
        "rate_of_penetration": [0.1, 0.2, 0.3, 0.25, 5.0, 0.2, 0.2],
        "status": [0, 0, 0, 0, 1, 1, 1],
    }
    fit = vj.fit_rop(xr.Dataset({name: ("frequency", values) for name, values in data.items()}), progress=False)
    (plot,) = sheet_of(fit).plots
    assert "η = P/D, the mean force over the threshold" in sheet_of(fit).note
    assert plot.x.label == "relief P/D\n2 rows outside the panel"
    assert {"data", "left out of the fit"} <= {*labels(sheet_of(fit))}


def test_a_fit_prints_its_coefficient_in_one_unit():
    relief, noise = np.linspace(0.3, 0.8, 9), 1e-3 * np.cos(np.arange(9.0))
    rate = np.array([[0.2], [0.4]]) * (relief - 0.2) + noise
    data = {"relief": (("k3", "frequency"), [relief, relief]), "rate_of_penetration": (("k3", "frequency"), rate)}
    sheet = sheet_of(vj.fit_rop(xr.Dataset(data, {"k3": [1e8, 3e8]}), along="frequency", progress=False))
    assert [plot.title.endswith(" m/s") and "mm" not in plot.title for plot in sheet.plots[:2]] == [True, True]
    assert {plot.y.limits[0] for plot in sheet.plots[:2]} == {0.0}
    assert "C [m/s]" in [plot.y.label for plot in sheet.plots]


def test_user_settings_are_ignored_and_texts_are_not_formulas():
    ds = lanes({"gamma": np.linspace(0.3, 1.2, 20)}).assign_attrs(title="a $x_1$ of $5")
    with matplotlib.rc_context({"axes.titlesize": 40, "xtick.labelsize": 30, "axes.facecolor": "red"}):
        before = dict(matplotlib.rcParams)
        figure = vj.picture(ds)
        assert dict(matplotlib.rcParams) == before
        assert {text.get_size() for axes in figure.axes for text in axes.get_xticklabels()} <= {8.0}
    assert to_hex(figure.axes[0].get_facecolor()) == "#ffffff" and figure.get_suptitle() == r"a \$x_1\$ of \$5"
    assert isinstance(figure, Figure) and figure._repr_png_().startswith(b"\x89PNG")


def test_picture_is_saved_the_same_in_format_of_suffix(tmp_path):
    """Names of clip paths in SVG differ with roundings of the layout, which differ from one figure to the next."""
    names = ("map.PNG", "map.svg", "map.pdf", "again.svg", "again.pdf")
    for name in names:
        vj.save_picture(OSCILLATION, tmp_path / name)
    contents = {name: re.sub(rb"\bp[0-9a-f]{10}\b", b"", (tmp_path / name).read_bytes()) for name in names}
    assert [contents[name][:4] for name in names[:3]] == [b"\x89PNG", b"<?xm", b"%PDF"]
    assert contents["map.svg"] == contents["again.svg"] and contents["map.pdf"] == contents["again.pdf"]
    assert {path.name for path in tmp_path.iterdir()} == {*names}
