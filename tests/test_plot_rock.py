"""Test the pictures of scenes with rock by their artists and labels, not by pixels."""

import json

import numpy as np
import pytest
import xarray as xr
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import LogNorm, to_hex
from read_off import axis_labels, check_texts, legend, meshes, note, panel, titles

import vibrojax as vj
from vibrojax.errors import InputError
from vibrojax.pictures.choose import picture
from vibrojax.pictures.hole import pulses, response
from vibrojax.pictures.rates import rates

AXES = {
    "k3": ("stiffness of the rock", "k₃", "N m-1"),
    "threshold": ("force at which the rock yields", "D", "N"),
    "zeta": ("damping ratio", "ζ", "1"),
    "force": ("greatest force of a pulse", "A", "N"),
    "frequency": ("pulses per second", "f", "s-1"),
    "beta": ("mass ratio m2/m1", "β", "1"),
    "gamma": ("frequency ratio w2/w1", "γ", "1"),
    "delta": ("gap between striker and bit (negative: preload)", "Δ", "m"),
}
VALUES = {"rate_of_penetration": "m s-1", "relief": "1", "mean_force": "N", "slip_per_impact": "m"}
MEANINGS = "undecided equilibrium impact-free single-impact multi-impact subharmonic irregular failed"
FORMS = ["literal", "percent", "onset", "line", "power"]


def axis(name, values):
    return (
        (name, values, dict(zip(("long_name", "symbol", "units"), AXES[name], strict=True))) if name in AXES else values
    )


def rock(grid, **fixed):
    """Return a penetration sweep with slips that grow from an onset and rates proportional to the frequency."""
    inputs = {"force": 2e5, "frequency": 20.0, "threshold": 15e4, "k3": 3e8, "zeta": 1.1} | fixed
    mesh = dict(zip(grid, np.meshgrid(*grid.values(), indexing="ij"), strict=True)) if grid else {}
    inputs = {name: mesh.get(name, value) for name, value in inputs.items()}
    slip = np.maximum(inputs["force"] - 1.1 * inputs["threshold"], 0.0) / inputs["k3"] / inputs["zeta"]
    force = inputs["force"] * 4e-3 * inputs["frequency"]
    results = [slip * inputs["frequency"], force / inputs["threshold"], force, slip]
    shape = tuple(len(values) for values in grid.values())
    variables = {
        name: (tuple(grid), np.broadcast_to(values, shape).copy(), {"units": unit, "long_name": name})
        for (name, unit), values in zip(VALUES.items(), results, strict=True)
    }
    coordinates = {name: axis(name, np.asarray(values)) for name, values in grid.items()}
    parameters = {name: value for name, value in fixed.items()} | {"pulse_width": 4e-3}
    return xr.Dataset(
        variables, coordinates, {"title": "a rock", "scene": "penetration", "parameters": json.dumps(parameters)}
    )


def drill(grid, starts=("drive", "stuck")):
    """Return a drilling sweep with single impacts up to a gap that depends on the start, and no penetration beyond."""
    shape = (*(len(values) for values in grid.values()), len(starts))
    mesh = dict(zip([*grid, "start"], np.meshgrid(*grid.values(), range(len(starts)), indexing="ij"), strict=True))
    gap, k3, beta = (mesh.get(name, x) for name, x in (("delta", -0.005), ("k3", 1e8), ("beta", 0.4)))
    single = (gap < 0.004 * mesh["start"] + 0.001) & (beta < 0.6)
    rate = np.where(single, 1e-3 + 0.05 * (gap + 0.005) + 1e-13 * k3, 0.0)
    ds = rock({})
    variables = {
        "regime": np.where(single, 3, 6).astype(np.int8),
        "rate_of_penetration": rate,
        "relief": np.where(single, 0.05 + gap, 0.004),
        "peak_impact_force": np.where(single, 1e5, 3e4) + 1e6 * gap,
        "impact_velocity": np.where(single, 2.0, 0.5),
    }
    units = VALUES | {"peak_impact_force": "N", "impact_velocity": "m s-1"}
    ds = xr.Dataset(
        coords={name: axis(name, np.asarray(values)) for name, values in grid.items()} | {"start": list(starts)}
    )
    for name, values in variables.items():
        ds[name] = ((*grid, "start"), np.broadcast_to(values, shape).copy(), {"units": units.get(name, "1")})
    ds["regime"].attrs |= {"flag_values": np.arange(8, dtype=np.int8), "flag_meanings": MEANINGS}
    return ds.assign_attrs(title="a drill", scene="drilling")


def points(count=30, names=("force", "k3")):
    draw = np.random.default_rng(2)
    span = {"force": (15e4, 3e5), "k3": (1e8, 5e8), "frequency": (10.0, 40.0)}
    ds = rock({"point": np.arange(count)})
    for name in names:
        ds = ds.assign_coords({name: ("point", *axis(name, draw.uniform(*span[name], count))[1:])})
    ds["rate_of_penetration"].values[:] = draw.uniform(0, 0.05, count)
    return ds


def law(grid):
    """Return a fit with C proportional to the force. The form "line" is best, except "onset" at the largest force."""
    shape = tuple(len(values) for values in grid.values())
    mesh = dict(zip(grid, np.meshgrid(*grid.values(), indexing="ij"), strict=True)) if grid else {}
    force = np.broadcast_to(mesh.get("force", np.asarray(2e5)), shape)
    C = np.stack([-1e-7 * force, 5e-8 * force, 1.5e-7 * force, 5e-7 * force, 6e-7 * force], axis=-1)
    aic = np.stack([0 * force - x for x in (80.0, 90.0, 110.0, 300.0, 297.0)], axis=-1)
    aic[force > 2.9e5, 2] = -400.0
    dims = (*grid, "form")
    attributes = {"units": "m s-1", "long_name": "coefficient"}
    variables = {
        "C": (dims, C, attributes),
        "C_stderr": (dims, 0.05 * np.abs(C), attributes),
        "aic": (dims, aic, {"units": "1"}),
    }
    coordinates = {name: axis(name, np.asarray(values)) for name, values in grid.items()} | {"form": FORMS}
    formulas = "literal: C ln(eta); percent: C ln(100 eta); onset: C ln(eta/eta0); line: C (eta - eta0)"
    return xr.Dataset(variables, coordinates, {"title": "a law", "along": "frequency", "formulas": formulas})


@pytest.fixture(scope="module")
def swept():
    grid = {"force": [15e4, 2e5, 3e5], "frequency": [10.0, 20.0, 30.0, 40.0]}
    run = {"settle": 0.3, "observe": 0.3}
    return vj.run_sweep({"scene": "penetration", "grid": grid, "run": run}, progress=False)


@pytest.fixture(scope="module")
def pulse_run():
    given = {"k3": 100e6, "zeta": 0.5, "force": 300e3, "frequency": 40.0, "duration": 0.2}
    return vj.simulate("penetration", **given, progress=False)


@pytest.fixture(scope="module")
def swept_sine_run():
    given = {"force": 70e3, "bias": 60e3, "sweep_start": 20.0, "sweep_rate": 300.0, "duration": 1.0, "zeta": 0.3}
    return vj.simulate("penetration", pulse_shape="sweep", **given, progress=False)


@pytest.fixture(scope="module")
def drilling_run():
    return vj.simulate("drilling", beta=0.55, duration=3.0, progress=False)


def curves(axes):
    """Return the points of the lines of `axes` by label, without the gaps between motions."""
    named = {line.get_label(): line.get_xydata() for line in axes.lines if not line.get_label().startswith("_")}
    return {name: np.asarray(xy)[np.isfinite(xy[:, 0])] for name, xy in named.items()}


def mark_positions(axes, kind):
    """Return the positions of the marks of one kind, in order along the axis."""
    positions = [line.get_xydata() for line in axes.lines if line.get_label() == f"_{kind}"]
    return np.concatenate(positions) if positions else np.empty((0, 2))


# Lines.


def test_pulse_sweep_is_drawn_with_its_values(swept):
    figure = picture(swept)
    over, relief, slip = figure.axes
    for force in swept["force"].values:
        lane, name = swept.sel(force=force), f"A = {force / 1e3:g} kN"
        rate = 1e3 * lane["rate_of_penetration"].values
        assert np.array_equal(curves(over)[name], np.column_stack([lane["frequency"], rate]))
        assert np.array_equal(curves(relief)[name], np.column_stack([lane["relief"], rate]))
        assert np.allclose(curves(slip)[name][:, 1], 1e3 * lane["slip_per_impact"])
    assert axis_labels(figure) == {
        "pulses per second, f [Hz]",
        "rate of penetration [mm/s]",
        "relief P/D",
        "slip per blow [mm]",
    }
    assert {"D = 150 kN", "w = 4 ms"} <= set(note(figure).split(", "))


def test_lanes_without_penetration_are_hollow_and_in_legend(swept):
    none = swept["rate_of_penetration"].values == 0
    assert none[0].all() and not none[2].any()  # 150 kN never penetrates, 300 kN always does
    figure = picture(swept)
    hollow = mark_positions(figure.axes[0], "none")
    assert len(hollow) == none.sum() and (hollow[:, 1] == 0).all()
    assert "no penetration" in legend(figure)
    assert "no penetration" not in legend(picture(swept.isel(force=[2])))


def test_zero_is_only_tick_without_penetration():
    ds = rock({"force": np.linspace(3e4, 6e4, 4), "frequency": [10.0, 20.0]})
    for name in ("rate_of_penetration", "slip_per_impact"):
        ds[name] = 0.0 * ds[name].fillna(0.0)
    figure = picture(ds)
    figure.draw_without_rendering()
    rate = figure.axes[0]
    assert [text.get_text() for text in rate.get_yticklabels()] == ["0"]
    assert [text.get_text() for text in rate.texts] == ["no penetration"]
    wide = rock({"force": np.linspace(3e4, 6e4, 10), "frequency": np.linspace(10.0, 30.0, 10)})
    wide["rate_of_penetration"] = 0.0 * wide["rate_of_penetration"].fillna(0.0)
    bars = [axes for axes in picture(wide).axes if axes.get_xlabel().startswith("rate of penetration")]
    assert [list(bar.get_xticks()) for bar in bars] == [[]]


def test_further_axes_become_at_most_four_rows_with_note():
    grid = {"k3": np.linspace(1e8, 5e8, 6), "force": np.linspace(1e5, 4e5, 7), "frequency": np.linspace(10, 40, 8)}
    figure = rates(rock(grid))
    assert titles(figure) == [f"k₃ = {k} MN/m" for k in (100, 260, 340, 500)]
    assert "k₃ = 100, 260, 340, 500 MN/m (4 of 6 values)" in note(figure)
    assert legend(figure) == [*(f"A = {force} kN" for force in range(100, 401, 50)), "no penetration"]
    row = figure.axes[3:6]
    lane = rock(grid).isel(k3=2).sel(force=3e5)
    assert np.allclose(curves(row[0])["A = 300 kN"][:, 1], 1e3 * lane["rate_of_penetration"])


def test_relief_panel_is_omitted_where_relief_is_constant():
    figure = rates(rock({"frequency": [10.0, 20.0], "k3": np.linspace(5e7, 5e8, 9)}))
    assert "relief P/D" not in axis_labels(figure)
    assert len(figure.axes) == 2


def test_all_rows_include_largest_value_and_zero():
    ds = rock({"zeta": [1.5, 0.5], "force": [2e5, 3e5], "frequency": np.linspace(10, 40, 5)})
    low, high = rates(ds).axes[0].get_ylim()
    assert low < 0 < 1e3 * float(ds["rate_of_penetration"].max()) < high


def test_single_impacts_are_marked_and_not_joined_to_other_motion():
    ds = drill({"k3": [1e8, 3e8], "delta": np.linspace(-0.005, 0.012, 9)})
    figure = picture(ds)
    assert titles(figure) == ["start: drive", "start: stuck"]
    assert {"k₃ = 100 MN/m", "k₃ = 300 MN/m", "single impact", "other motion"} == set(legend(figure))
    over = figure.axes[0]
    lanes = ds.sel(start="drive")
    single = lanes["regime"].values == 3
    assert len(mark_positions(over, "single")) == single.sum() and len(mark_positions(over, "other")) == (~single).sum()
    joined = next(line for line in over.lines if line.get_label() == "k₃ = 300 MN/m").get_ydata()
    assert np.flatnonzero(np.isnan(joined)).tolist() == [int(single[1].sum())]
    assert np.array_equal(curves(over)["k₃ = 300 MN/m"][:, 1], 1e3 * lanes["rate_of_penetration"].sel(k3=3e8))
    assert "peak impact force [kN]" in axis_labels(figure)


def test_starts_become_lines_where_nothing_else_varies():
    figure = rates(drill({"delta": np.linspace(-0.005, 0.012, 7)}))
    assert set(curves(figure.axes[0])) == {"start: drive", "start: stuck"}


def test_named_rocks_become_lines_or_ticks():
    names = np.array(["sandstone", "limestone", "granite"])
    ds = rock({"threshold": [61.9e3, 140.3e3, 204.5e3], "frequency": [10.0, 20.0, 40.0]}, force=3e5)
    ds = ds.rename(threshold="rock").assign_coords(rock=("rock", names))
    figure = rates(ds)
    assert list(curves(figure.axes[0])) == names.tolist()
    figure = rates(ds.isel(frequency=1))
    assert [text.get_text() for text in figure.axes[0].get_xticklabels()] == names.tolist()
    assert np.allclose(mark_positions(figure.axes[0], "single")[:, 1], 1e3 * ds["rate_of_penetration"][:, 1])


# Maps.


def test_two_long_axes_give_maps_with_contours_of_relief():
    ds = rock({"force": np.linspace(1e5, 3e5, 10), "frequency": np.linspace(10, 40, 9)}, threshold=15e4)
    figure = picture(ds)
    for colours, name in (("plasma", "rate_of_penetration"), ("viridis", "slip_per_impact"), ("cividis", "mean_force")):
        (mesh,) = meshes(figure, colours)
        factor = 1e-3 if name == "mean_force" else 1e3
        assert np.allclose(mesh.get_array(), factor * ds[name].transpose("force", "frequency"))
    assert {"rate of penetration [mm/s]", "slip per blow [mm]", "mean force P [kN]"} <= axis_labels(figure)
    assert {"no penetration", "equal relief P/D"} == set(legend(figure))
    levels = [float(text.get_text()) for text in figure.axes[0].texts]
    assert levels and all(0.027 < level < 0.32 for level in levels)


def test_cells_without_penetration_are_white_and_without_value_grey():
    ds = rock({"force": np.linspace(1e5, 3e5, 10), "frequency": np.linspace(10, 40, 9)})
    ds["rate_of_penetration"][{"force": 9, "frequency": 3}] = np.nan
    figure = picture(ds)
    (nothing, *_) = meshes(figure, "nothing")
    assert np.array_equal(~nothing.get_array().mask, (ds["rate_of_penetration"] == 0).values)
    assert to_hex(nothing.get_cmap()(0)) == "#ffffff"
    (mesh,) = meshes(figure, "plasma")
    assert np.argwhere(mesh.get_array().mask).tolist() == [[9, 3]]
    assert {"no penetration", "no value"} <= set(legend(figure))


def test_relief_has_own_map_where_threshold_varies():
    ds = rock({"threshold": np.linspace(5e4, 25e4, 9), "frequency": np.linspace(10, 40, 10)})
    figure = picture(ds)
    shown = {mesh.get_array().max() for mesh in meshes(figure, "cividis")}
    assert np.allclose(sorted(shown), [float(ds["relief"].max()), 1e-3 * float(ds["mean_force"].max())])


def test_constant_quantities_are_in_note():
    ds = rock({"k3": np.linspace(1e8, 5e8, 9), "zeta": np.linspace(0.5, 1.5, 9)})
    figure = picture(ds)
    assert "P = 16 kN, P/D = 0.10667" in note(figure)
    assert not meshes(figure, "cividis")


def test_many_facets_show_only_rate_on_nine_panels():
    axes = {"zeta": np.linspace(0.5, 1.5, 9), "force": np.linspace(15e4, 35e4, 9)}
    ds = rock(axes | {"k3": np.linspace(1e8, 5e8, 4), "threshold": [1e5, 15e4, 2e5]})
    figure = picture(ds)
    assert len(meshes(figure, "plasma")) == 9 and not meshes(figure, "viridis")
    assert "(3 of 4 values)" in note(figure)
    assert titles(figure)[0] == "k₃ = 100 MN/m, D = 100 kN"


def test_colours_are_logarithmic_only_for_rates_over_decades():
    ds = rock({"force": np.linspace(2e5, 3e5, 10), "frequency": np.linspace(10, 40, 9)})
    assert not isinstance(meshes(picture(ds), "plasma")[0].norm, LogNorm)
    ds["rate_of_penetration"].values[:] = np.geomspace(1e-6, 1e-1, 90).reshape(10, 9)
    assert isinstance(meshes(picture(ds), "plasma")[0].norm, LogNorm)


def test_border_of_single_impacts_lies_between_regimes():
    ds = drill({"beta": np.linspace(0.2, 0.9, 9), "gamma": np.linspace(0.5, 0.9, 9)}, starts=("drive",))
    figure = picture(ds)
    (rate,) = meshes(figure, "plasma")
    border = next(collection for collection in rate.axes.collections if isinstance(collection, LineCollection))
    between = (ds["beta"][ds["beta"] < 0.6].max() + ds["beta"][ds["beta"] >= 0.6].min()) / 2
    assert np.allclose([segment[:, 1] for segment in border.get_segments()], between)
    assert "border of single impact" in legend(figure)
    assert np.allclose(rate.get_array(), 1e3 * ds["rate_of_penetration"].isel(start=0))


# Lists of points.


def test_points_are_drawn_over_parameter_with_most_values_and_not_joined():
    ds = points()
    ds["k3"][:] = np.repeat([1e8, 3e8, 5e8], 10)
    over = picture(ds).axes[0]
    lanes = ds.isel(point=slice(10, 20)).sortby("force")
    expected = np.column_stack([1e-3 * lanes["force"], 1e3 * lanes["rate_of_penetration"]])
    shown = curves(over)["k₃ = 300 MN/m"]
    assert np.allclose(shown[np.argsort(shown[:, 0])], expected)
    assert {line.get_linestyle() for line in over.lines} == {"None"}


def test_points_over_two_parameters_with_many_values_are_scattered():
    ds = points()
    ds["rate_of_penetration"][:3], ds["rate_of_penetration"][3] = 0.0, np.nan
    figure = picture(ds)
    assert {"greatest force of a pulse,\nA [kN]", "stiffness of the rock, k₃ [MN/m]"} <= axis_labels(figure)
    grey, white, known = (
        collection for collection in figure.axes[0].collections if isinstance(collection, PathCollection)
    )
    positions = np.column_stack([1e-3 * ds["force"], 1e-6 * ds["k3"]])
    assert np.array_equal(grey.get_offsets(), positions[3:4]) and np.array_equal(white.get_offsets(), positions[:3])
    assert np.array_equal(known.get_offsets(), positions[4:])
    assert np.array_equal(known.get_array(), 1e3 * ds["rate_of_penetration"][4:])
    assert {"no penetration", "no value"} == set(legend(figure))


def test_drill_points_over_two_parameters_are_scattered_with_rate():
    ds = drill({"delta": np.linspace(-0.005, 0.012, 20)}, starts=("drive",)).isel(start=0, drop=True)
    ds = ds.rename(delta="point").assign_coords(point=np.arange(20))
    draw = np.random.default_rng(4)
    ds = ds.assign_coords(beta=("point", draw.uniform(0.1, 1, 20)), gamma=("point", draw.uniform(0.3, 1, 20)))
    figure = picture(ds)
    dots = [array for axes in figure.axes for array in axes.collections if isinstance(array, PathCollection)]
    shown = [array.get_array() for array in dots if array.get_array() is not None]
    rate = ds["rate_of_penetration"].values
    assert any(np.array_equal(array, 1e3 * rate[rate > 0]) for array in shown)
    assert "rate of penetration [mm/s]" in axis_labels(figure)


# Trajectories.


def test_hole_has_steps_and_last_two_blows_are_enlarged(pulse_run):
    figure = picture(pulse_run)
    hole, force, late, _ = figure.axes
    assert np.array_equal(curves(hole)["hole x₄"], np.column_stack([pulse_run["time"], 1e3 * pulse_run["x4"]]))
    assert np.array_equal(curves(hole)["bit x₃"][:, 1], 1e3 * pulse_run["x3"])
    assert np.array_equal(curves(force)["given I"][:, 1], 1e-3 * pulse_run["applied_force"])
    assert np.array_equal(curves(force)["rock N"][:, 1], 1e-3 * pulse_run["rock_force"])
    assert {"hole x₄", "bit x₃", "threshold D = 150 kN", "given I", "rock N"} <= set(legend(figure))
    start, end = late.get_xlim()
    assert end == pytest.approx(0.2) and start == pytest.approx(0.15 - 0.08 * 0.025, abs=1e-3)
    assert f"{1e3 * float(pulse_run['x4'][-1]):.3g} mm in 0.2 s" in note(figure)


def test_swept_sine_shows_amplitudes_and_slip_range_over_frequency(swept_sine_run):
    figure = picture(swept_sine_run)
    displacement, velocity, depth = figure.axes
    frequency, amplitude = displacement.lines[0].get_xydata().T
    assert frequency[0] == pytest.approx(25.9, rel=0.01) and frequency[-1] == pytest.approx(320, rel=0.03)
    # The last whole cycle, from its samples.
    cycle = (swept_sine_run["time"] > 1 - 2 / frequency[-1]) & (swept_sine_run["time"] < 1 - 0.9 / frequency[-1])
    last = (swept_sine_run["x3"] - swept_sine_run["x4"]).values[cycle]
    assert amplitude[-1] == pytest.approx(1e3 * np.ptp(last) / 2, rel=0.05)
    assert velocity.lines[0].get_ydata()[-1] == pytest.approx(
        1e3 * np.ptp(swept_sine_run["v3"].values[cycle]) / 2, rel=0.05
    )
    assert depth.lines[0].get_ydata()[-1] == pytest.approx(1e3 * float(swept_sine_run["x4"][-1]), rel=1e-6)
    (span,) = displacement.patches
    growing = np.flatnonzero(np.diff(swept_sine_run["x4"].values) > 0)
    first, last = (20 + 300 * float(swept_sine_run["time"][index]) for index in growing[[0, -1]])
    assert span.get_x() == pytest.approx(first, rel=0.15) and span.get_x() + span.get_width() == pytest.approx(
        last, rel=0.05
    )
    assert {"frequency of the force [Hz]", "depth of the hole\nx₄ [mm]"} <= axis_labels(figure)


def test_sine_of_constant_frequency_is_drawn_over_time(swept_sine_run):
    given = json.loads(swept_sine_run.attrs["parameters"]) | {"sweep_rate": 0.0}
    still = swept_sine_run.assign_attrs(parameters=json.dumps(given))
    assert "time [s]" in axis_labels(picture(still))
    with pytest.raises(InputError, match="not a swept sine"):
        response(still)


def test_drilling_run_shows_hole_and_last_impact(drilling_run):
    figure = picture(drilling_run)
    depth = [axes for axes in figure.axes if axes.get_ylabel().startswith("depth")]
    assert len(depth) == 2
    start, end = panel(figure, ylabel="displacement").get_xlim()
    assert depth[0].get_xlim() == (start, end)
    hole = curves(depth[0])["hole x₄"]
    assert np.array_equal(hole[:, 1], 1e3 * drilling_run["x4"].values[-len(hole) :])
    begun = drilling_run["event_time"].values[drilling_run["event_kind"].values == 3]
    left, right = depth[1].get_xlim()
    assert left < begun[begun < end][-1] < right
    assert {"hole x₄", "bit x₃", "impact begins"} <= set(legend(figure))


@pytest.mark.parametrize("missing", ["x4", "time"])
def test_invalid_rock_trajectory_is_refused(pulse_run, missing):
    short = pulse_run.drop_vars("x4") if missing == "x4" else pulse_run.isel(time=slice(5))
    with pytest.raises(InputError, match="x4" if missing == "x4" else "5 finite samples"):
        pulses(short)


# Fits.


def test_fit_over_one_axis_has_error_bars_and_aic_above_best_form():
    fit = law({"force": [2e5, 2.5e5, 3e5]})
    figure = picture(fit)
    coefficient, excess = figure.axes
    bars = {container.get_label(): container for container in coefficient.containers}
    assert set(bars) == {"onset", "literal", "percent"}
    line, _, (segments,) = bars["onset"]
    assert np.allclose(line.get_ydata(), 1e3 * fit["C"].sel(form="onset"))
    heights = [np.ptp(segment[:, 1]) for segment in segments.get_segments()]
    assert np.allclose(heights, 2e3 * fit["C_stderr"].sel(form="onset"))
    shown = {line.get_label(): line.get_ydata() for line in excess.lines if line.get_label() in FORMS}
    assert set(shown) == set(FORMS)
    assert np.allclose(shown["onset"], [190, 190, 0]) and np.allclose(shown["line"], [0, 0, 100])
    assert {"onset\nC ln(η/η₀)", "as good as the best"} <= set(legend(figure))
    assert "Fitted along frequency" in note(figure)
    assert {"C [mm/s]", "AIC above the best form", "greatest force of a pulse,\nA [kN]"} == axis_labels(figure)


def test_fit_of_one_group_is_drawn_over_forms():
    figure = picture(law({}))
    assert [text.get_text() for text in figure.axes[1].get_xticklabels()] == FORMS
    assert [text.get_text() for text in figure.axes[0].get_xticklabels()] == ["onset", "literal", "percent"]


def test_groups_without_coefficient_are_counted():
    fit = law({"force": [2e5, 2.5e5, 3e5]})
    fit["C"][{"force": 0}] = np.nan
    assert "Groups without a C, of 3: 1" in note(picture(fit))
    fit["C"][{"force": 1, "form": 2}] = np.nan
    assert "Groups without a C, of 3: onset: 2, literal: 1, percent: 1" in note(picture(fit))


def test_fit_over_long_axes_maps_best_form_and_coefficient():
    fit = law({"force": np.linspace(2e5, 3e5, 9), "k3": np.linspace(1e8, 5e8, 9), "zeta": [0.5, 1.0]})
    figure = picture(fit)
    assert titles(figure) == ["ζ = 0.5", "ζ = 1"]
    best, c = meshes(figure, "forms")[0], meshes(figure, "viridis")[0]
    x = next(axes.get_xlabel() for axes in figure.axes if axes.get_xlabel())
    values = fit["C"].sel(form="onset", zeta=0.5).transpose(*(("k3", "force") if "force" in x else ("force", "k3")))
    assert np.allclose(c.get_array(), 1e3 * values)
    expected = xr.where(values["force"] > 2.9e5, FORMS.index("onset"), FORMS.index("line"))
    assert np.array_equal(best.get_array(), expected.broadcast_like(values).transpose(*values.dims))
    assert {"onset  11 % of groups", "line  89 % of groups"} <= set(legend(figure))
    assert note(figure).replace("\n", " ").endswith("Standard error of C: 5 %")


def test_first_of_equally_good_forms_is_shown():
    fit = law({"force": np.linspace(2e5, 2.8e5, 9), "k3": np.linspace(1e8, 5e8, 9)})
    fit["aic"][{"form": 4}] = -301.0  # the form "line" has -300
    assert (meshes(picture(fit), "forms")[0].get_array() == FORMS.index("line")).all()


def test_varying_error_of_coefficient_has_own_map():
    fit = law({"force": np.linspace(2e5, 3e5, 9), "k3": np.linspace(1e8, 5e8, 9)})
    fit["C_stderr"] *= xr.DataArray(np.linspace(1, 4, 9), dims="k3")
    assert "standard error of C [%]" in axis_labels(picture(fit))


# All kinds.

LONG = np.linspace(10.0, 40.0, 9)
KINDS = {
    "lines": lambda: rock({"k3": [1e8, 3e8], "force": np.linspace(1e5, 3e5, 7), "frequency": LONG}),
    "line": lambda: rock({"frequency": LONG}),
    "one": lambda: rock({}),
    "map": lambda: rock({"force": np.linspace(1e5, 3e5, 9), "frequency": LONG}),
    "square": lambda: rock({"threshold": np.linspace(5e4, 25e4, 9), "frequency": LONG}),
    "map-rows": lambda: rock({"force": [2e5, 3e5], "threshold": np.linspace(5e4, 25e4, 9), "frequency": LONG}),
    "map-many": lambda: rock({"zeta": np.linspace(0.5, 2, 8), "k3": np.linspace(1e8, 5e8, 9), "frequency": LONG}),
    "drill-lines": lambda: drill({"k3": [1e8, 3e8], "delta": np.linspace(-0.005, 0.012, 9)}),
    "drill-map": lambda: drill({"beta": np.linspace(0.2, 0.9, 9), "gamma": np.linspace(0.5, 0.9, 9)}),
    "points": points,
    "points-of-many": lambda: points(names=("force", "k3", "frequency")),
    "law": lambda: law({"k3": [1e8, 3e8], "force": [2e5, 2.5e5, 3e5]}),
    "law-of-one": lambda: law({}),
    "law-map": lambda: law({"force": np.linspace(2e5, 3e5, 9), "k3": np.linspace(1e8, 5e8, 9), "zeta": [0.5, 1.0]}),
}
RUNS = ("pulse_run", "swept_sine_run", "drilling_run")


def one_value(ds):
    """Return parts of a dataset with one value of every axis, and with one value of one axis and two of the others."""
    dims = [name for name in ds.dims if name != "form"]
    sizes = [dict.fromkeys(dims, 1), *(dict.fromkeys(dims, 2) | {name: 1} for name in dims)]
    return [ds.isel({name: slice(size) for name, size in chosen.items()}) for chosen in sizes]


DEGENERATE = {
    "failed": lambda ds: [ds.map(lambda data: data * np.nan if data.dtype.kind == "f" else data, keep_attrs=True)],
    "no-penetration": lambda ds: [
        ds.assign({name: 0.0 * ds[name] for name in {"rate_of_penetration", "slip_per_impact"} & set(ds)})
    ],
    "one-value": one_value,
}


@pytest.mark.parametrize("kind", KINDS)
def test_texts_lie_within_figure_without_overlap(kind):
    check_texts(picture(KINDS[kind]().assign_attrs(title="Rate of penetration of a drill " * 12)))


@pytest.mark.parametrize("run", RUNS)
def test_texts_of_trajectories_lie_within_figure_without_overlap(run, request):
    check_texts(picture(request.getfixturevalue(run)))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("case", DEGENERATE)
def test_degenerate_datasets_are_drawn(kind, case):
    for ds in DEGENERATE[case](KINDS[kind]()):
        figure = picture(ds)
        figure.draw_without_rendering()
        assert "nan" not in note(figure)


def test_dataset_without_attributes_is_labelled_by_variable_names():
    ds = KINDS["lines"]().drop_attrs()
    assert {"frequency", "rate of penetration"} <= axis_labels(picture(ds))
    picture(KINDS["law"]().drop_attrs())
