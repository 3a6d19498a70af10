"""Test the pictures of families of orbits, alone and over the returns of a sweep."""

import json

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex
from read_off import axis_labels, check_texts, legend, meshes, note, panel, titles
from test_plot import lanes, returns, square

from vibrojax.errors import InputError
from vibrojax.pictures.branch_data import branches, places, stability, stable_intervals
from vibrojax.pictures.branches import smooth
from vibrojax.pictures.choose import picture
from vibrojax.pictures.returns import bifurcation
from vibrojax.studies.family_analysis import family_lines

KINDS = "fold period-doubling torus grazing stick section end"
FOLD, DOUBLING, TORUS, GRAZING, STICK, SECTION, END = range(7)
FLAGS = {"flag_values": np.arange(7, dtype=np.int8), "flag_meanings": KINDS}
STABILITY = {"flag_values": np.arange(-1, 2, dtype=np.int8), "flag_meanings": "not-known unstable stable"}
MACHINE = {"scene": "vibro-impact", "friction": "stribeck"}


def one_family(low=0.4, high=1.0, family=0):
    """Return a family that runs down from `high` to a fold at 0.5, then back up, unstable, to 0.8.

    The part before the fold is stable up to a period doubling at 0.9 and unstable above it. A branch of two returns
    runs from 0.9 to `high`.
    """
    down = np.concatenate([np.linspace(high, 0.9, 5), np.linspace(0.9, 0.5, 9)[1:]])
    up = np.linspace(0.5, 0.8, 7)[1:]
    doubled = np.linspace(0.9, high, 6)
    gamma = np.concatenate([down, up, doubled])
    branch = np.repeat([0, 1], [down.size + up.size, doubled.size])
    stable = np.concatenate([down <= 0.9, np.zeros(up.size), np.ones(doubled.size)])
    # At the fold, the multipliers are those on the side from which the continuation reached it.
    velocity = np.concatenate([2 + (down - 0.5), 2 - (up - 0.5), np.full(doubled.size, 2.4)])
    least, greatest = velocity.copy(), velocity.copy()
    half_gap = np.sqrt(np.maximum(doubled - 0.9, 0.0))
    least[branch == 1] -= half_gap
    greatest[branch == 1] += half_gap
    largest = np.where(stable, 0.5, 3.0)
    special = [(END, high, 0), (DOUBLING, 0.9, 0), (FOLD, 0.5, 0), (END, 0.8, 0), (END, high, 1)]
    kind, value, special_branch = map(np.array, zip(*special, strict=True))
    points = {
        "gamma": gamma,
        "branch": branch,
        "cycles": branch + 1,
        "impacts": branch + 1.0,
        "impact_velocity": velocity,
        "impact_velocity_min": least,
        "impact_velocity_max": greatest,
        "orbit_x1": -0.07 * gamma,
        "point_family": np.full(gamma.size, family),
    }
    at_special = {
        "special_value": value,
        "special_branch": special_branch,
        "special_family": np.full(kind.size, family),
    }
    ds = xr.Dataset({name: ("point", x) for name, x in points.items()})
    ds = ds.assign({name: ("special", x) for name, x in at_special.items()})
    ds["stable"] = ("point", stable.astype(np.int8), STABILITY)
    ds["special_kind"] = ("special", kind.astype(np.int8), FLAGS)
    ds["special_note"] = ("special", np.full(kind.size, ""))
    ds["multiplier_abs"] = (("point", "multiplier"), np.stack([largest, np.full(gamma.size, 0.25)], axis=1))
    ds["multiplier_arg"] = (("point", "multiplier"), np.tile([np.pi / 2, 0.0], (gamma.size, 1)))
    for name in ("impact_velocity", "impact_velocity_min", "impact_velocity_max", "orbit_x1"):
        ds[name].attrs = {"units": "m" if name == "orbit_x1" else "m s-1", "long_name": name}
    ds["gamma"].attrs = {"units": "1", "long_name": "frequency ratio", "symbol": "γ"}
    attributes = {"title": "a family", "along": "gamma", "span": [low, high], "start": "stuck", **MACHINE}
    return ds.assign_attrs(attributes, parameters=json.dumps({"beta": 0.4, "delta": -0.005}))


def several_families(values=(0.3, 0.4, 0.5)):
    parts = [one_family(family=number) for number in range(len(values))]
    ds = xr.merge(
        [
            xr.concat([part[[n for n in part if dim in part[n].dims]] for part in parts], dim, combine_attrs="override")
            for dim in ("point", "special")
        ],
        combine_attrs="override",
    )
    number = ("family", np.arange(len(values)), {"units": "1", "long_name": "number"})
    beta = ("family", np.array(values), {"units": "1", "long_name": "mass ratio", "symbol": "β"})
    attributes = {**parts[0].attrs, "parameters": json.dumps({"delta": -0.005})}
    return ds.assign_coords(family=number, beta=beta).assign_attrs(attributes)


def orbit_lines(axes):
    """Return the solid and the dashed lines through orbits, without the border of stability."""
    drawn = [line for line in axes.lines if len(line.get_xdata()) > 2]
    return [[line for line in drawn if line.is_dashed() == dashed] for dashed in (False, True)]


def mark_positions(axes):
    """Return the positions of the marks of each kind."""
    positions = {}
    for line in axes.lines:
        label = str(line.get_label()).removeprefix("_")
        if label in KINDS.split():
            positions.setdefault(label, []).append((line.get_xdata()[0], line.get_ydata()[0]))
    return positions


def finite_range(lines):
    x = np.concatenate([line.get_xdata() for line in lines])
    x = x[np.isfinite(np.concatenate([line.get_ydata() for line in lines]))]
    return pytest.approx((x.min(), x.max()))


@pytest.fixture(scope="module")
def figure():
    return picture(one_family())


# Datasets.


def test_stable_intervals_end_at_special_points():
    first, second = branches(one_family())
    (down,), (doubled,) = (stable_intervals(one_family(), branch) for branch in (first, second))
    assert (down.low, down.high) == (0.5, 0.9) and (down.low_kind, down.high_kind) == ("fold", "period-doubling")
    assert (doubled.low, doubled.high) == (0.9, 1.0)
    assert (doubled.low_kind, doubled.high_kind) == ("period-doubling", "end")


def test_stability_change_at_special_point_is_read_from_neighbours():
    ds = one_family()
    first = next(branches(ds))
    for side in (0, 1):  # the located point may lie on either side of the change
        ds["stable"][{"point": first.points[ds["gamma"].values[first.points] == 0.9]}] = side
        changes = ds["gamma"].values[first.points][1:-1][np.diff(stability(ds, first)) != 0]
        assert changes.tolist() == [0.9, 0.5]


def test_special_points_on_two_sheets_at_same_value_have_separate_points():
    ds = one_family(high=0.8).isel(point=slice(0, 19))
    ds["gamma"][{"point": 0}] = 0.8
    first = next(branches(ds))
    values = ds["special_value"].values[first.special]
    indices = places(ds, first)
    ends = indices[(values == 0.8) & (ds["special_kind"].values[first.special] == END)]
    assert len(ends) == 2 and len(set(ends.tolist())) == 2


# One family.


def test_stable_parts_are_solid_and_unstable_parts_dashed(figure):
    solid, dashed = orbit_lines(panel(figure, ylabel="x₁"))
    assert finite_range(solid) == (0.5, 1.0) and finite_range(dashed) == (0.5, 1.0)
    assert finite_range([line for line in solid if line.get_color() == "#00598C"]) == (0.5, 0.9)
    assert finite_range([line for line in solid if line.get_color() == "#D1570A"]) == (0.9, 1.0)


def test_special_points_lie_at_their_orbits(figure):
    positions = mark_positions(panel(figure, ylabel="x₁"))
    assert {kind: len(places) for kind, places in positions.items()} == {"end": 3, "period-doubling": 1, "fold": 1}
    assert positions["fold"] == [pytest.approx((0.5, -35.0))]
    assert positions["period-doubling"] == [pytest.approx((0.9, -63.0))]


def test_two_return_branch_is_drawn_by_smallest_and_largest_impact(figure):
    solid, _ = orbit_lines(panel(figure, ylabel="impact velocity"))
    ends = sorted(float(line.get_ydata()[-1]) for line in solid if line.get_color() == "#D1570A")
    assert ends == pytest.approx([2.4 - np.sqrt(0.1), 2.4 + np.sqrt(0.1)])
    assert "the least and the greatest blow" in note(figure)


def test_lines_pass_through_every_orbit(figure):
    ds = one_family()
    solid, _ = orbit_lines(panel(figure, ylabel="impact velocity"))
    x, y = (np.concatenate([getattr(line, f"get_{c}data")() for line in solid]) for c in "xy")
    inner = ds.isel(point=(ds.branch.values == 0) & (ds.gamma.values <= 0.9) & (ds.stable.values == 1))
    distance = np.hypot(x[:, None] - inner.gamma.values, y[:, None] - inner.impact_velocity.values)
    assert inner.sizes["point"] and distance.min(axis=0).max() < 1e-9


def test_smoothing_is_monotone_and_keeps_corners():
    x, step = np.linspace(0.0, 1.0, 7), np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0])
    ((along, up),) = smooth(x, step, np.array([], int))
    assert along.size > x.size and up.min() >= 0.0 and up.max() <= 1.0 and (np.diff(up) >= 0).all()
    left, right = smooth(x, np.abs(x - 0.5), np.array([3]))
    assert np.allclose(left[1], 0.5 - left[0]) and np.allclose(right[1], right[0] - 0.5)


def test_moduli_panel_has_stability_border_and_multiplier_plane_has_circle(figure):
    moduli = panel(figure, ylabel="largest modulus")
    assert moduli.get_yscale() == "log" and any(set(line.get_ydata()) == {1.0} for line in moduli.lines)
    plane = panel(figure, title="multipliers")
    (circle,) = plane.patches
    assert circle.get_radius() == 1.0 and plane.get_aspect() == 1.0
    dots = np.concatenate([collection.get_offsets() for collection in plane.collections])
    expected = {(0.0, 0.5), (0.0, -0.5), (0.25, 0.0), (0.0, 3.0), (0.0, -3.0)}  # conjugate pairs are drawn in full
    assert {(round(float(x), 9) + 0.0, round(float(y), 9) + 0.0) for x, y in dots} == expected
    assert "The plane leaves out 10 of 19" in note(figure)


def test_note_mentions_moduli_outside_panel(figure):
    assert "largest modulus is drawn" not in note(figure)
    ds = one_family()
    ds["multiplier_abs"][{"point": 2, "multiplier": 0}] = 500.0
    assert "The largest modulus is drawn from 0.01 to 100" in note(picture(ds))


def test_bit_amplitude_is_drawn_without_impacts():
    ds = one_family().drop_vars(["impact_velocity", "impact_velocity_min", "impact_velocity_max", "impacts"])
    bit = ds.assign(bit_amplitude=("point", 0.04 * ds["gamma"].values, {"units": "m", "long_name": "amplitude"}))
    assert "bit amplitude\n[mm]" in axis_labels(picture(bit))
    assert not any("amplitude" in text for text in axis_labels(picture(ds)))


def test_legend_counts_special_points_and_explains_lines(figure):
    entries = {"fold  1", "period-doubling  1", "end  3", "stable", "unstable"}
    assert entries | {"repeats after one return", "repeats after 2 returns"} <= set(legend(figure))
    assert "β = 0.4, Δ = −5 mm, start: stuck" in note(figure)


def test_all_kinds_have_different_markers():
    drawn = {}
    for kinds in (np.arange(5), np.arange(2, 7)):
        ds = one_family().assign(special_kind=("special", kinds.astype(np.int8), FLAGS))
        lines = panel(picture(ds), ylabel="x₁").lines
        drawn |= {label: line.get_marker() for line in lines if (label := str(line.get_label())[1:]) in KINDS.split()}
    assert len(drawn) == 7 == len(set(drawn.values()))


# Several families, and selections from them.


def test_families_have_separate_colours_and_names():
    figure = picture(several_families())
    solid, _ = orbit_lines(panel(figure, ylabel="x₁"))
    assert len({line.get_color() for line in solid}) == 3
    assert {"β = 0.3", "β = 0.4", "β = 0.5"} <= set(legend(figure))


def test_where_selects_family_or_branch():
    single = picture(several_families(), where={"beta": 0.4})
    assert "β = 0.4" in note(single) and "repeats after one return" in legend(single)
    solid, _ = orbit_lines(panel(picture(one_family(), where={"branch": 1}), ylabel="x₁"))
    assert finite_range(solid) == (0.9, 1.0)
    two = several_families((0.3, 0.4, 0.4))
    assert "β = 0.3" not in legend(picture(two, where={"beta": 0.4}))


def test_chosen_variable_is_drawn_along_family():
    figure = picture(one_family(), variable="impact_velocity_max")
    assert "impact velocity max\n[m/s]" in axis_labels(figure) and not any("x₁" in text for text in axis_labels(figure))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"variable": "branch"}, '"branch" is not one number a point of the families; choose from gamma'),
        ({"variable": "speed"}, '"speed" is not in the dataset'),
        ({"where": {"gama": 1.0}}, '"gama" tells no families apart'),
        ({"where": {"branch": 7}}, "no lane has branch = 7; there are 0, 1"),
        ({"over": one_family()}, "families are laid over the returns of a sweep with keep_returns"),
    ],
)
def test_invalid_request_is_refused_in_one_line(arguments, message):
    with pytest.raises(InputError, match=message) as error:
        picture(one_family(), **arguments)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("make", [one_family, several_families])
def test_texts_lie_within_figure_without_overlap(make):
    check_texts(picture(make().assign_attrs(title="Families of periodic orbits over the frequency ratio " * 6)))


# Over returns.


def swept(**more):
    ds = returns({"gamma": np.linspace(0.6, 0.95, 15), **more})
    parameters = {"delta": -0.005} | ({} if "beta" in more else {"beta": 0.4})
    return ds.assign_attrs(parameters=json.dumps(parameters), **MACHINE)


def test_family_is_drawn_over_returns_of_every_start_within_axis_limits():
    alone, laid = bifurcation(swept()), picture(swept(), over=one_family())
    diagrams = [axes for axes in laid.axes if orbit_lines(axes)[0]]
    assert len(diagrams) == len(titles(alone)) > 1
    for axes in diagrams:
        solid, dashed = orbit_lines(axes)
        low, high = axes.get_xlim()
        assert all(
            low <= x <= high for line in (*solid, *dashed) for x in line.get_xdata()[np.isfinite(line.get_ydata())]
        )
        assert "fold" not in mark_positions(axes) and "period-doubling" in mark_positions(
            axes
        )  # 0.5 lies outside the axis
    assert {"stable orbit", "unstable orbit", "period-doubling"} <= set(legend(laid))
    assert "Lines: orbits that were followed" in note(laid)


def test_each_panel_shows_families_with_its_parameters():
    figure = bifurcation(swept(beta=[0.3, 0.4]), several_families((0.4, 0.5)))
    drawn = {
        axes.get_title("left").partition(",")[0]: bool(orbit_lines(axes)[0])
        for axes in figure.axes
        if axes.get_title("left")
    }
    assert drawn == {"β = 0.3": False, "β = 0.4": True}


def test_several_families_can_be_overlaid():
    weak = one_family()
    weak["impact_velocity"] = 0.5 * weak["impact_velocity"]
    alone, both = picture(swept(), over=one_family()), picture(swept(), over=[one_family(), weak])
    assert legend(alone) == legend(both)
    counts = [sum(map(len, orbit_lines(figure.axes[0]))) for figure in (alone, both)]
    assert counts[1] == 2 * counts[0] > 0


def carried(keep=True):
    """Return lanes that are carried up and down."""
    ds = swept().rename(start="direction").assign_coords(direction=["up", "down"])
    ds = ds.assign(cycles=xr.ones_like(ds["regime"]), error_estimate=xr.zeros_like(ds["period"]))
    ds = ds if keep else ds.drop_vars("return_impact_velocity")
    return ds.assign_attrs(run=json.dumps({"carry": "gamma"}))


def test_families_are_drawn_over_carried_lanes():
    figure = picture(carried(), over=one_family())
    solid, dashed = orbit_lines(panel(figure, ylabel="impact velocity at each return"))
    assert solid and dashed and "period-doubling" in mark_positions(figure.axes[0])
    assert {"up", "down", "stable orbit", "unstable orbit"} <= set(legend(figure))
    ds = one_family()
    ds["period"] = ("point", 0.2 + 0.01 * ds["gamma"].values, {"units": "s", "long_name": "period"})
    periods = panel(picture(carried(keep=False), over=ds), ylabel="period")
    drawn = [line for line in periods.lines if line.get_color() == "#222222" and len(line.get_xdata()) > 2]
    x, y = (np.concatenate([getattr(line, f"get_{axis}data")() for line in drawn]) for axis in "xy")
    shown = np.isfinite(y)
    assert shown.any() and np.allclose(y[shown], 0.2 + 0.01 * x[shown], atol=1e-4)


@pytest.mark.parametrize(
    ("over", "message"),
    [
        (lambda: swept(), "over: no families of orbits"),
        (lambda: one_family().assign_attrs(along="orbit_x1"), "along orbit_x1, and the returns over gamma"),
        (lambda: one_family().assign_attrs(friction="coulomb"), "of friction coulomb, the returns of stribeck"),
        (lambda: one_family().assign_attrs(parameters='{"delta": 0.005}'), "delta = 0.005, the returns of −0.005"),
        (lambda: several_families((0.3, 0.5)), "none of the families has the beta of the returns"),
    ],
)
def test_families_of_different_machine_are_refused(over, message):
    with pytest.raises(InputError, match=message) as error:
        bifurcation(swept(), over())
    assert "\n" not in str(error.value)


def test_over_requires_returns():
    with pytest.raises(InputError, match="over no other variable"):
        picture(swept(), variable="period", over=one_family())
    with pytest.raises(InputError, match="holds none"):
        picture(lanes(square(4)), over=one_family())


# Orbits over a map.


def with_orbits(grid):
    ds = lanes(grid)
    shape = ds["regime"].shape
    moduli = np.linspace(0.1, 0.9, ds["regime"].size).reshape(shape)
    dims = (*ds["regime"].dims, "multiplier")
    ds["multiplier_abs"] = (dims, np.stack([moduli, 0.1 * moduli], axis=-1), {"units": "1", "long_name": "modulus"})
    ds["stable"] = (ds["regime"].dims, np.where(moduli > 0.5, 1, -1).astype(np.int8), STABILITY)
    return ds


def test_only_largest_multiplier_is_drawn():
    ds = with_orbits(square(6))
    figure = picture(ds, variable="multiplier_abs")
    assert "largest |multiplier|" in axis_labels(figure)
    drawn = [mesh.get_array() for mesh in meshes(figure, "viridis")]
    starts = [
        ds["multiplier_abs"].isel(start=start, multiplier=0).transpose("beta", "gamma").values for start in range(2)
    ]
    assert all(np.allclose(values, expected) for values, expected in zip(drawn, starts, strict=True))


def test_flag_names_label_colour_bar_and_curves():
    ds = with_orbits(square(6))
    figure = picture(ds, variable="stable")
    bar = next(axes for axes in figure.axes if "stability" in (axes.get_xlabel(), axes.get_ylabel()))
    axis = bar.yaxis if bar.get_ylabel() else bar.xaxis
    assert [text.get_text() for text in axis.get_ticklabels()] == ["not-known", "stable"]
    colours = {to_hex(mesh.to_rgba(mesh.get_array())[0, 0]) for mesh in meshes(figure, "stable")}
    assert colours <= {"#bbbbbb", "#0072b2"}
    line = with_orbits({"gamma": np.linspace(0.5, 1.0, 12)})
    curves = panel(picture(line, variable="stable"), ylabel="stability")
    assert [text.get_text() for text in curves.get_yticklabels()] == ["not-known", "stable"]


@pytest.mark.parametrize(
    ("values", "branch", "line"),
    [
        ([0.123456789012], [0], "1 on branch 0 at gamma 0.123456789"),
        ([0.5, 0.6, 0.7], [0, 1, 2], "1 on branch 0 at gamma 0.5; 2 on other branches"),
        ([0.5, 0.6], [1, 1], "2 on other branches"),
        ([0.1, 0.2, 0.3, 0.4, 0.5], [0] * 5, "5 on branch 0 at gamma 0.1, 0.2, 0.3, 0.4 (and 1 more up to 0.5)"),
    ],
)
def test_summary_lists_special_points(values, branch, line):
    """Counts and values belong to the same branch. The kinds follow each file's own flag meanings."""
    for meanings in (KINDS, " ".join(reversed(KINDS.split()))):
        flags = FLAGS | {"flag_meanings": meanings}
        kind = np.full(len(values), meanings.split().index("stick"), np.int8)
        ds = one_family().drop_dims("special")
        ds["special_kind"] = ("special", kind, flags)
        ds["special_value"], ds["special_branch"] = ("special", values), ("special", np.array(branch))
        ds["special_note"] = ("special", np.full(len(values), ""))
        (stick,) = (text for text in family_lines(ds) if text.startswith("stick"))
        assert stick.removeprefix("stick").strip() == line
