"""Test the pictures of sweeps and runs by their artists and labels, not by pixels."""

import json
import subprocess
import sys
from itertools import combinations, pairwise

import matplotlib
import numpy as np
import pytest
import xarray as xr
from matplotlib.collections import PathCollection, QuadMesh
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from read_off import axis_labels, check_texts, legend, meshes, note, outlines, panel, titles

from vibrojax.errors import InputError, counted
from vibrojax.pictures.axes import certified_text, label, point_text, scale, share_text, short, value_text
from vibrojax.pictures.choose import picture, save_picture
from vibrojax.pictures.colours import REGIME_COLOURS
from vibrojax.pictures.returns import bifurcation
from vibrojax.pictures.style import NO_VALUE, nested_line
from vibrojax.pictures.time_history import trajectory

MEANINGS = "undecided equilibrium impact-free single-impact multi-impact subharmonic irregular failed"
COORDINATES = {
    "beta": ("mass ratio m2/m1", "β", "1"),
    "gamma": ("frequency ratio w2/w1", "γ", "1"),
    "v": ("drive speed", "v", "m s-1"),
    "delta": ("gap between striker and bit (negative: preload)", "Δ", "m"),
}
VALUES = {"impact_velocity": ("impact velocity", "m s-1"), "period": ("mean time between returns", "s")}


def lanes(grid, starts=("drive", "stuck"), attrs=True, regime=None):
    """Return a sweep dataset with patches of regimes, impact velocity and period over `grid` and the starts."""
    values = {name: np.asarray(axis, float) for name, axis in grid.items()}
    along = np.meshgrid(*values.values(), np.arange(len(starts)), indexing="ij")
    mesh = dict(zip([*values, "start"], along, strict=True))
    beta, gamma, v = (mesh.get(name, default) for name, default in (("beta", 0.4), ("gamma", 0.75), ("v", 1.5)))
    far = np.hypot((beta - 0.5) / 0.45, (gamma - 0.72) / 0.3) + 25 * mesh.get("delta", -0.005) - 0.3 * mesh["start"]
    ripple = 0.12 * np.sin(17 * beta + 23 * gamma + 2 * v)
    flags = np.digitize(far + ripple, [0.9, 1.3, 1.6, 2.2])
    regimes = np.array([3, 4, 5, 6, 2])[flags] + 0 * mesh["start"]
    regimes = np.where(beta > 1.12 - 0.05 * gamma, 0, regimes) if regime is None else np.full(regimes.shape, regime)
    period = 0.25 - 0.02 * gamma / (0.5 + beta) + 0 * far
    velocity = np.where(regimes == 2, np.nan, 1.2 * v + 2.6 * np.exp(-(far**2)) + 0.2 * ripple)
    dims = (*values, "start")
    variables = {
        "regime": flagged(dims, regimes),
        "impact_velocity": (dims, velocity),
        "period": (dims, np.where(regimes == 0, np.nan, period)),
    }
    ds = xr.Dataset(variables, {**values, "start": list(starts)}, {"title": "a sweep"})
    return described(ds) if attrs else ds


def flagged(dims, regimes):
    attributes = {
        "units": "1",
        "long_name": "regime",
        "flag_values": np.arange(8, dtype=np.int8),
        "flag_meanings": MEANINGS,
    }
    return dims, np.asarray(regimes).astype(np.int8), attributes


def described(ds):
    for name in set(COORDINATES) & set(ds.coords):
        long_name, symbol, units = COORDINATES[name]
        ds[name].attrs = {"long_name": long_name, "symbol": symbol, "units": units}
    for name, (long_name, units) in VALUES.items():
        ds[name].attrs = {"long_name": long_name, "units": units}
    return ds


def square(count=9, **further):
    return {"beta": np.linspace(0.1, 1.2, count), "gamma": np.linspace(0.3, 1.2, count), **further}


def points(count=40, also_v=False):
    draw = np.random.default_rng(3)
    ds = lanes({"point": np.arange(count)}, ("drive",)).isel(start=0, drop=True)
    ds["regime"] = flagged(("point",), draw.choice([2, 3, 3, 6], count))
    ds = ds.assign_coords(beta=("point", draw.uniform(0.1, 1.2, count)), gamma=("point", draw.uniform(0.3, 1.2, count)))
    ds = ds.assign_coords(start=("point", np.array(["drive", "stuck"])[np.arange(count) % 2]))
    return described(ds.assign_coords(v=("point", draw.uniform(0.5, 2, count))) if also_v else ds)


def returns(grid, keep=24, starts=("drive", "stuck")):
    ds = lanes(grid, starts)
    several = np.random.default_rng(5).standard_normal((*ds["regime"].shape, keep))
    two = np.where(np.arange(keep) % 2, 0.5, -0.5)
    spread = xr.where(ds["regime"] == 6, 0.35, 0.0).values[..., None] * several
    doubled = xr.where(ds["regime"] == 5, 0.4, 0.0).values[..., None] * two
    kept = ds["impact_velocity"].values[..., None] * (1 + 0.3 * (spread + doubled))
    attributes = {"long_name": "impact velocity at each stored return", "units": "m s-1"}
    ds["return_impact_velocity"] = ((*ds["regime"].dims, "return_index"), kept, attributes)
    return ds


def run(duration=12.0, impacts=True, events=True):
    """Return a trajectory at 4.4 Hz in which the bit sticks for a part of each cycle."""
    time = np.arange(0.0, duration, 5e-4)
    turn = 2 * np.pi * 4.4 * time
    growth = 1 - 0.6 * np.exp(-time)
    x1, v1 = growth * 0.05 * np.sin(turn), growth * 0.05 * 27.65 * np.cos(turn)
    x2, v2 = growth * 0.03 * np.sin(turn - 0.4) - 0.035, growth * 0.03 * 27.65 * np.cos(turn - 0.4)
    force = np.where(x2 > -0.006, 50e6 * (x2 + 0.006) / 100, 0.0)
    ds = xr.Dataset(coords={"time": ("time", time, {"units": "s"})})
    for name, values, units in (("x1", x1, "m"), ("v1", v1, "m s-1"), ("x2", x2, "m"), ("v2", v2, "m s-1")):
        ds[name] = ("time", values, {"units": units, "long_name": name})
    ds["friction_force"] = ("time", 981 * np.sign(v1 + 1.5), {"units": "N"})
    ds["stuck"] = ("time", (v1 < -1.3).astype(np.int8), {"flag_values": np.arange(2, dtype=np.int8)})
    if impacts:
        ds["impact_force"] = ("time", force, {"units": "N"})
    if impacts and events:
        hits = time[1:][(force[1:] > 0) & (force[:-1] <= 0)]
        meanings = {"flag_values": np.arange(1, 6, dtype=np.int8), "flag_meanings": "stick slip impact release section"}
        ds["event_time"] = ("event", np.concatenate([hits, hits + 1e-3]), {"units": "s"})
        ds["event_kind"] = ("event", np.repeat([3, 4], hits.size).astype(np.int8), meanings)
    scene, gap = ("vibro-impact", {"delta": -0.006}) if impacts else ("rotary", {})
    parameters = json.dumps({"beta": 0.4, "gamma": 0.75, "v": 1.5, **gap})
    return ds.assign_attrs(scene=scene, start="drive", parameters=parameters)


# Regime maps.


def test_each_gap_and_start_has_panel_for_each_quantity():
    figure = picture(lanes(square(9, delta=[-0.005, 0.005])))
    expected = [f"Δ = {gap} mm, start: {start}" for gap in ("−5", "5") for start in ("drive", "stuck")]
    assert titles(figure) == expected
    assert [len(meshes(figure, name)) for name in (None, "viridis", "cividis")] == [4, 4, 4]
    assert {"mass ratio m2/m1, β", "frequency ratio w2/w1, γ", "impact velocity [m/s]", "period [s]"} <= axis_labels(
        figure
    )


def test_panel_shows_lanes_named_in_its_title():
    ds = lanes(square(7, delta=[-0.005, 0.005]))
    shown = dict(zip(titles(figure := picture(ds)), meshes(figure), strict=True))
    lane = ds["regime"].sel(delta=0.005, start="drive").transpose("beta", "gamma").values
    assert np.array_equal(shown["Δ = 5 mm, start: drive"].get_array(), lane)


@pytest.mark.parametrize("flag", range(8))
def test_flag_has_same_colour_in_every_map(flag):
    alone = meshes(picture(lanes(square(4), regime=flag)))[0]
    assert to_hex(alone.to_rgba(alone.get_array())[0, 0]).upper() == REGIME_COLOURS[flag]


def test_flag_without_colour_is_refused_by_name():
    ds = lanes(square(4))
    ds["regime"].values[1, 2] = 9
    ds["regime"].attrs |= {"flag_values": np.arange(10, dtype=np.int8), "flag_meanings": f"{MEANINGS} hopping rattling"}
    with pytest.raises(InputError, match=r"regime: flag 9 \(rattling\) is not a regime with a colour") as refused:
        picture(ds)
    assert "\n" not in str(refused.value)


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


def linear(srgb):
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def lab(rgb):
    """Convert linear RGB to CIELAB (D65)."""
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = to_xyz @ np.clip(rgb, 0, 1) / [0.9505, 1.0, 1.089]
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def test_legend_lists_present_regimes_with_shares():
    ds = lanes(square(4), ("drive",))
    ds["regime"].values[:] = 3
    ds["regime"].values[0, 0], ds["regime"].values[1] = 6, 7
    assert legend(picture(ds))[:3] == [
        "single-impact  69 % of lanes",
        "irregular  6 % of lanes",
        "failed  25 % of lanes",
    ]


def test_source_region_is_outlined_only_over_beta_and_gamma():
    assert np.allclose(outlines(picture(lanes(square(9)))), [0.6, 0.25, 0.8, 0.6])
    other = picture(lanes({"v": np.linspace(0.5, 2, 5), "gamma": np.linspace(0.3, 1.2, 5)}))
    assert not outlines(other)
    assert "source's best region" not in legend(other)


def test_lanes_without_value_are_hatched():
    ds = lanes(square(6), ("drive",))
    ds["impact_velocity"][{"beta": 2, "gamma": 3, "start": 0}] = np.nan
    mesh = meshes(figure := picture(ds), "viridis")[0]
    assert np.argwhere(mesh.get_array().mask).tolist() == [[2, 3]]
    assert mesh.get_cmap().get_bad()[3] == 0.0  # the hatched background shows through
    drawn = [quads for axes in figure.axes for quads in axes.collections if isinstance(quads, QuadMesh)]
    assert mesh.axes.patch.get_hatch() == NO_VALUE["hatch"]
    assert all(bool(quads.axes.patch.get_hatch()) == np.ma.getmaskarray(quads.get_array()).any() for quads in drawn)
    keys = [key for axes in figure.axes if (box := axes.get_legend()) for key in box.get_patches()]
    assert [key.get_hatch() for key in keys if key.get_label() == "no value"] == [mesh.axes.patch.get_hatch()]


def test_greys_of_regimes_and_missing_values_differ_in_lightness():
    undecided, equilibrium = REGIME_COLOURS[0], REGIME_COLOURS[1]
    colours = (undecided, equilibrium, NO_VALUE["facecolor"])
    lightness = [lab(linear(np.array(to_rgb(colour))))[0] for colour in colours]
    assert lightness[0] - lightness[1] > 30 and lightness[2] - lightness[0] > 12
    stroke = lab(linear(np.array(to_rgb(NO_VALUE["edgecolor"]))))[0]
    assert lightness[2] - stroke > 30  # the hatching is visible on its background


@pytest.mark.parametrize("count", [2, 3, 4])
def test_coincident_lines_are_all_visible(count):
    first, *others = (nested_line(position, count) for position in range(count))
    assert first["linestyle"] == "-" and all(first["linewidth"] > 1.5 * other["linewidth"] for other in others)
    phase = np.linspace(0.0, 1.0, 1000, endpoint=False)
    drawn = []
    for offset, (on, off) in (other["linestyle"] for other in others):
        assert (on + off) == pytest.approx(2.6 * count)
        drawn.append((phase * (on + off) + offset) % (on + off) < on)
    assert (
        np.sum(drawn, axis=0).max() == 1 and not np.any(drawn, axis=0).all()
    )  # at most one of the others is drawn at a time, and the first shows in the gaps
    sizes = [nested_line(position, count)["markersize"] for position in range(count)]
    assert np.all(np.diff(sizes) < -0.2)


def test_coincident_curves_of_starts_differ_in_dashes_and_markers_are_not_clipped():
    figure = picture(lanes({"gamma": np.linspace(0.3, 1.2, 9)}, ("drive", "stuck", "touching"), regime=3))
    figure.draw_without_rendering()
    for axes in figure.axes[:2]:
        looks = [(line.get_linewidth(), line.get_markersize(), line._dash_pattern) for line in axes.lines]
        assert len(set(map(str, looks))) == 3
        assert not any(line.get_clip_on() for line in axes.lines)


def test_dots_at_ends_of_diagram_are_not_clipped():
    ds = returns({"gamma": np.linspace(0.3, 1.2, 60)})
    figure = picture(ds)
    figure.draw_without_rendering()
    for axes in figure.axes[:2]:
        dots = [collection for collection in axes.collections if isinstance(collection, PathCollection)]
        assert len(dots) == 2 and not any(collection.get_clip_on() for collection in dots)
        others, own = sorted(dots, key=lambda collection: collection.get_zorder())
        assert others.get_sizes()[0] > 2 * own.get_sizes()[0]  # a rim stays visible where both starts coincide


def test_constant_panel_does_not_clip_other_panels():
    ds = lanes({"delta": [-0.005, 0.005], "gamma": np.linspace(0.3, 1.2, 9)}, ("drive",), regime=3)
    ds["period"].values[0], ds["period"].values[1] = 0.25, np.linspace(0.2, 0.3, 9)[:, None]
    for axes in picture(ds).axes:
        low, high = axes.get_ylim()
        for line in (line for line in axes.lines if line.get_marker() == "o"):
            assert low <= np.nanmin(line.get_ydata()) and np.nanmax(line.get_ydata()) <= high


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
    assert counted(1, "lane is", "lanes are") == "1 lane is"


def test_shares_are_not_rounded_up_and_starts_have_no_quotes():
    assert share_text(1 - 1e-15) == "100 %" and share_text(0.995) == ">99 %"
    assert short('"drive"') == "drive" and short("[0.0, 0.125]") == "[0, 0.125]"


def test_tick_labels_of_colour_bars_do_not_overlap():
    ds = points(12)
    ds["period"].values[:] = np.linspace(0.2143, 0.2328, 12)
    figure = picture(ds.isel(point=ds["start"].values == "drive"))
    figure.draw_without_rendering()
    bars = [axes for axes in figure.axes if axes.get_xlabel().startswith("period")]
    assert bars
    for bar in bars:
        low, high = bar.get_xlim()
        texts = [tick.label1 for tick in bar.xaxis.get_major_ticks() if low <= tick.get_loc() <= high]
        boxes = sorted((text.get_window_extent() for text in texts), key=lambda box: box.x0)
        assert all(left.x1 + 4 < right.x0 for left, right in pairwise(boxes))


def test_panels_share_colour_limits_and_ignore_outliers():
    ds = lanes(square(12, delta=[-0.005, 0.005]))
    ds["impact_velocity"][{"beta": 0, "gamma": 0, "delta": 0, "start": 0}] = 1e6
    norms = {(mesh.norm.vmin, mesh.norm.vmax) for mesh in meshes(picture(ds), "viridis")}
    assert len(norms) == 1
    assert norms.pop()[1] < 10


def test_cells_end_halfway_and_geometric_axes_are_logarithmic():
    ds = lanes({"v": [0.5, 1.0, 2.0, 4.0], "delta": [-0.004, 0.0, 0.002]}, ("drive",))
    mesh = meshes(picture(ds))[0]
    corners = mesh.get_coordinates()
    assert np.allclose(corners[0, :, 0], 0.5 * 2.0 ** np.arange(-0.5, 4))
    assert np.allclose(corners[:, 0, 1], [-6, -2, 1, 3])  # mm
    assert (mesh.axes.get_xscale(), mesh.axes.get_yscale()) == ("log", "linear")


def test_unsorted_values_are_drawn_in_order():
    ds = lanes(square(5), ("drive",))
    shuffled = ds.isel(beta=[3, 0, 4, 1, 2])
    assert np.array_equal(meshes(picture(shuffled))[0].get_array(), meshes(picture(ds))[0].get_array())


def test_axis_with_few_values_becomes_panels():
    figure = picture(lanes({"beta": [0.25, 0.6], "v": np.linspace(0.5, 2, 7), "delta": np.linspace(0, 0.02, 6)}))
    assert titles(figure)[0] == "β = 0.25, start: drive"
    assert {"drive speed, v [m/s]", "gap between striker and bit,\nΔ [mm]"} <= axis_labels(figure)


def test_excess_panels_are_thinned_with_note():
    figure = picture(lanes(square(3, v=np.linspace(0.5, 2, 4), delta=[-0.005, 0.0, 0.005])))
    assert len(meshes(figure)) == 12
    assert "v = 0.5, 2 m/s (2 of 4 values)" in note(figure)
    assert titles(figure)[0] == "v = 0.5 m/s, Δ = −5 mm, start: drive"


def test_single_valued_axes_and_fixed_parameters_are_in_note():
    ds = lanes(square(4, delta=[-0.005]), ("drive",)).assign_attrs(parameters=json.dumps({"v": 1.5, "k0": 5e7}))
    figure = picture(ds)
    assert note(figure) == "Δ = −5 mm, start: drive, v = 1.5 m/s"
    assert not titles(figure)


def test_data_without_attributes_is_labelled_by_variable_names():
    figure = picture(lanes(square(4, delta=[-0.005, 0.005]), attrs=False))
    assert titles(figure)[0] == "delta = −0.005, start: drive"
    assert {"beta", "gamma", "impact velocity", "period"} <= axis_labels(figure)


def test_scene_without_impacts_shows_period_and_amplitude():
    ds = lanes(square(4)).drop_vars("impact_velocity")
    ds["bit_amplitude"] = ds["period"].dims, 0.05 + 0 * ds["period"].values, {"units": "m"}
    assert {"period [s]", "bit amplitude [mm]"} <= axis_labels(picture(ds))


# One axis, and lists of points.


def test_one_axis_gives_line_per_start_above_regimes():
    ds = lanes({"gamma": np.linspace(0.3, 1.2, 11), "delta": [-0.005, 0.005]})
    figure = picture(ds)
    assert titles(figure) == ["Δ = −5 mm", "Δ = 5 mm"]
    velocity, period, strip = figure.axes[:3]
    lines = {line.get_label(): line.get_ydata() for line in velocity.lines}
    for start in ("drive", "stuck"):
        assert np.array_equal(lines[start], ds["impact_velocity"].sel(delta=-0.005, start=start), equal_nan=True)
    assert [text.get_text() for text in strip.get_yticklabels()] == ["drive", "stuck"]
    assert np.array_equal(meshes(figure)[0].get_array(), ds["regime"].sel(delta=-0.005).transpose("start", "gamma"))
    assert (velocity.get_ylabel(), period.get_ylabel()) == ("impact velocity\n[m/s]", "period\n[s]")
    assert {"start: drive", "start: stuck"} <= set(legend(figure))


def test_points_over_two_parameters_are_scattered_by_start():
    ds = points()
    figure = picture(ds)
    assert titles(figure) == ["start: drive", "start: stuck"]
    dots = [c for c in figure.axes[0].collections if isinstance(c, PathCollection) and len(c.get_offsets())]
    here = ds["start"].values == "drive"
    assert np.array_equal(dots[0].get_offsets(), np.column_stack([ds["gamma"], ds["beta"]])[here])
    assert np.array_equal(dots[0].get_array(), ds["regime"].values[here])


def test_points_over_three_parameters_are_counted():
    ds = points(also_v=True)
    bars = {axes.get_title("left"): [bar.get_width() for bar in axes.patches] for axes in picture(ds).axes}
    for start in ("drive", "stuck"):
        here = ds["regime"].values[ds["start"].values == start]
        assert bars[f"start: {start}"] == [np.count_nonzero(here == flag) for flag in (2, 3, 6)]


# Bifurcation diagrams.


def test_each_start_has_diagram_with_other_starts_behind():
    ds = returns({"gamma": np.linspace(0.3, 1.2, 15)}, keep=6)
    ds["return_impact_velocity"][{"gamma": 3}] = np.nan
    figure = bifurcation(ds)
    assert titles(figure) == ["start: drive", "start: stuck"]
    for own, other, axes in (("drive", "stuck", figure.axes[0]), ("stuck", "drive", figure.axes[1])):
        dots = {c.get_label(): c for c in axes.collections}
        assert {name: len(c.get_offsets()) for name, c in dots.items()} == {own: 14 * 6, f"_{other}": 14 * 6}
        assert dots[own].get_zorder() > dots[f"_{other}"].get_zorder()
        assert np.array_equal(dots[own].get_offsets()[:6, 1], ds["return_impact_velocity"].sel(start=own)[0])
        assert axes.get_ylim() == figure.axes[0].get_ylim()
    assert meshes(figure)[0].get_array().shape == (2, 15)
    assert axis_labels(figure) >= {"impact velocity at each return [m/s]"}


def test_further_axes_of_diagram_become_panels():
    ds = returns({"delta": [-0.005, 0.005], "gamma": np.linspace(0.3, 1.2, 9)}, keep=4)
    assert titles(bifurcation(ds)) == [f"Δ = {d} mm, start: {s}" for d in ("−5", "5") for s in ("drive", "stuck")]


def test_sweep_without_stored_returns_is_refused():
    with pytest.raises(InputError, match="keep_returns"):
        bifurcation(lanes(square(4)))


# Trajectories.


def test_run_has_history_portraits_and_spectrum():
    figure = trajectory(run())
    assert titles(figure) == ["bit", "striker", "spectrum, second half of the run"]
    displacement = panel(figure, ylabel="displacement")
    assert np.allclose(displacement.get_xlim(), [11.9995 - 1.5, 11.9995])
    assert panel(figure, ylabel="whole run").get_xlim()[0] == 0.0
    assert panel(figure, title="bit").get_ylabel() == "sliding speed u = x₁′ + v [m/s]"
    assert {"bit", "striker", "bit sticks", "impact begins", "gap Δ = −6 mm", "impact force J"} <= set(legend(figure))
    assert note(figure) == "β = 0.4, γ = 0.75, v = 1.5 m/s, Δ = −6 mm, start: drive"


def test_note_lists_values_that_differ_from_defaults():
    ds = run()
    changed = [
        {"name": "k0", "symbol": "k₀", "units": "N m-1", "value": 2e7, "default": 5e7},
        {"name": "delta", "symbol": "Δ", "units": "m", "value": -0.006, "default": -0.005},
    ]
    ds.attrs |= {"differing": json.dumps(changed), "friction": "coulomb"}
    expected = "β = 0.4, γ = 0.75, v = 1.5 m/s, Δ = −6 mm, k₀ = 20 MN/m, friction: coulomb, start: drive"
    assert note(trajectory(ds)) == expected


@pytest.mark.parametrize("events", [True, False])
def test_impacts_and_stick_are_marked(events):
    ds = run(events=events)
    bit = panel(trajectory(ds), title="bit")
    hits = next(line for line in bit.lines if line.get_marker() == "o")
    assert len(hits.get_xdata()) == 7  # in the last 1.5 s, at 4.4 Hz
    thick = max(bit.lines, key=lambda line: line.get_linewidth())
    late = ds["time"] >= 11.9995 - 1.5
    assert np.array_equal(np.isfinite(thick.get_ydata()), ds["stuck"].where(late, drop=True) == 1)


def test_spectrum_labels_dominant_peak():
    spectrum = panel(trajectory(run()), title="spectrum")
    assert [text.get_text() for text in spectrum.texts] == ["4.4 Hz"]
    assert spectrum.get_xlim()[1] == pytest.approx(5 * 4.4, rel=1e-3)
    bit = spectrum.lines[0]
    assert bit.get_ydata().max() == pytest.approx(
        50 * (1 - 0.6 * np.exp(-9)), rel=0.1
    )  # mm; the peak lies between two bins


def test_run_without_impacts_or_attributes_is_drawn():
    assert "impact begins" not in legend(trajectory(run(impacts=False)))
    plain = run(duration=1.2).drop_attrs()[["x1", "v1", "x2", "v2"]]
    figure = trajectory(plain)
    assert panel(figure, title="bit").get_ylabel() == "velocity x₁′ [m/s]"
    assert not any("whole run" in text for text in axis_labels(figure))


def test_diverging_run_is_drawn_to_divergence_and_resting_run_is_drawn():
    broken, resting = run(duration=4.0), run(duration=4.0)
    broken["x1"][5000:] = np.nan
    assert panel(trajectory(broken), ylabel="displacement").get_xlim()[1] == pytest.approx(2.4995)
    for name in ("x1", "v1", "x2", "v2"):
        resting[name][:] = 0.0
    assert not panel(trajectory(resting), title="spectrum").texts


@pytest.mark.parametrize(
    ("ds", "message"), [(run().drop_vars("v2"), "v2"), (run().isel(time=slice(5)), "5 finite samples")]
)
def test_invalid_trajectory_is_refused(ds, message):
    with pytest.raises(InputError, match=message):
        trajectory(ds)


# All kinds.

KINDS = {
    "map": lambda: lanes(square(8, delta=[-0.005, 0.005])),
    "map-of-one": lambda: lanes(square(8), ("drive",)),
    "map-of-many": lambda: lanes(square(3, v=np.linspace(0.5, 2, 4), delta=[-0.005, 0.0, 0.005])),
    "line": lambda: lanes({"gamma": np.linspace(0.3, 1.2, 20)}),
    "points": points,
    "counts": lambda: points(also_v=True),
    "bifurcation": lambda: returns({"gamma": np.linspace(0.3, 1.2, 20), "delta": [-0.005, 0.005]}),
    "trajectory": run,
}


@pytest.mark.parametrize("kind", KINDS)
def test_texts_lie_within_figure_without_overlap(kind):
    check_texts(picture(KINDS[kind]().assign_attrs(title="Regimes of a drill " * 12)))


@pytest.mark.parametrize("kind", ["map-of-one", "line", "trajectory"])
def test_user_settings_are_ignored_and_unchanged(kind):
    ds = KINDS[kind]()
    with matplotlib.rc_context({"axes.titlesize": 40, "xtick.labelsize": 30, "axes.facecolor": "red"}):
        before = dict(matplotlib.rcParams)
        figure = picture(ds)
        assert dict(matplotlib.rcParams) == before
        assert {text.get_size() for axes in figure.axes for text in axes.get_xticklabels()} <= {8.0}
    assert to_hex(figure.axes[0].get_facecolor()) == "#ffffff"


def test_pyplot_is_not_imported():
    code = "import sys, vibrojax.pictures.choose; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_figure_has_png_representation_for_notebooks():
    figure = picture(lanes(square(3)))
    assert isinstance(figure, Figure)
    assert figure._repr_png_().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("suffix", "begins"), [(".png", b"\x89PNG"), (".pdf", b"%PDF"), (".svg", b"<?xml"), (".PNG", b"\x89PNG")]
)
def test_picture_is_saved_in_format_of_suffix(tmp_path, suffix, begins):
    path = tmp_path / f"map{suffix}"
    save_picture(lanes(square(3)), path)
    assert path.read_bytes().startswith(begins)
    assert list(tmp_path.iterdir()) == [path]


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
    assert path.read_bytes() == old
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["map.jpg", "map", "nowhere/map.png"])
def test_invalid_path_is_refused(tmp_path, name):
    with pytest.raises(InputError, match="map"):
        save_picture(lanes(square(3)), tmp_path / name)


def test_dataset_with_nothing_to_draw_is_refused():
    with pytest.raises(InputError, match="nothing to draw"):
        picture(xr.Dataset({"threshold": 1.0}))


@pytest.mark.parametrize(
    ("name", "long_name", "symbol", "unit", "shown"),
    [
        ("frequency", "pulses per second", "f", "s-1", "Hz"),
        ("sweep_start", "frequency of the swept sine at t = 0", "f₀", "s-1", "Hz"),
        ("sweep_rate", "rate of the swept sine's frequency", "r", "s-2", "Hz/s"),
        ("drive", "frequency of the imbalance", "f_d", "Hz", "Hz"),
        ("decay", "rate of decay", "κ", "s-1", "1/s"),
        ("frequency", "frequency of the imbalance", "w", "s-1", "1/s"),  # the unit does not say whether it is angular
        ("lyapunov", "largest Lyapunov exponent", "", "s-1", "1/s"),
        ("w", "angular frequency of the imbalance", "w", "s-1", "rad/s"),
        ("omega", "forcing", "", "s-1", "rad/s"),
        ("forcing", "forcing", "Ω", "s-1", "rad/s"),
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


def test_notes_show_starts_without_quotes_and_singular_counts():
    assert point_text(xr.Dataset(attrs={"start": '"drive"'})) == "start: drive"
    counts = {"within": 34, "estimated": 35, "still_settling": 1, "sensitive": 2, "error": 1e-4}
    text = "34 of 35 lanes that repeat are known to 0.0001, 1 is still settling, 2 are sensitive to rounding"
    assert certified_text(xr.Dataset(attrs={"certified": json.dumps(counts)})) == text


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


def test_plane_without_border_has_text_saying_so():
    path = {"gamma": ("vertex", [0.6, 0.7]), "beta": ("vertex", [0.3, 0.4])}
    kinds = {"flag_values": [0, 1], "flag_meanings": "fold basin"}
    ds = xr.Dataset(
        path | {"kind": ("curve", [1], kinds), "curve": ("vertex", [0, 0]), "region_area": ("region", [0.4, 1.0])},
        {"start": ("curve", ["drive"]), "region_start": ("region", ["drive", "any"])},
        {"axes": ["gamma", "beta"], "kind": "borders"},
    )
    figure = picture(ds)
    assert [axes.get_title() for axes in figure.axes] == [
        "start drive: 40 % of the plane",
        "any start: 100 % of the plane",
    ]
    texts = [[text.get_text().replace("\n", " ") for text in axes.texts] for axes in figure.axes]
    assert texts == [[], ["no border: a single impact is stable everywhere"]]
    (line,) = (line for box in figure.legends for line in box.get_lines())
    assert line.get_label() == "basin" and line.is_dashed()
