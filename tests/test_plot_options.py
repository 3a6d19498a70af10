"""Test pictures with chosen variables, values and colours, and the requests that are refused."""

import json

import numpy as np
import pytest
import xarray as xr
from drawn import LONG, basin, flagged, lanes, law, line, plane, points, returns, rock, run, sample, scales, square
from matplotlib.colors import to_hex
from read_off import axis_labels, legend, meshes, note, titles

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.errors import InputError
from vibrojax.pictures.colours import REGIME_COLOURS
from vibrojax.pictures.plots import Points
from vibrojax.pictures.selection import select
from vibrojax.pictures.sheet import PAGE
from vibrojax.studies.choose import picture, requested


def with_shares(ds):
    """Return `ds` with an added variable that no picture shows by default."""
    values = np.linspace(0.0, 0.5, ds["regime"].size).reshape(ds["regime"].shape)
    return ds.assign(stick_fraction=(ds["regime"].dims, values, {"units": "1", "long_name": "share of time"}))


# Variables.


def test_variable_over_two_axes_is_drawn_as_single_map():
    ds = with_shares(lanes(square(7, delta=[-0.005, 0.005])))
    figure = picture(ds, variable="stick_fraction")
    assert not meshes(figure) and len(meshes(figure, "viridis")) == 4
    expected = ds["stick_fraction"].sel(delta=-0.005, start="stuck").transpose("beta", "gamma")
    assert np.array_equal(meshes(figure, "viridis")[1].get_array(), expected)
    assert {"share of stick", "mass ratio m2/m1, β"} <= axis_labels(figure)


def test_several_variables_are_drawn_side_by_side_in_given_order():
    figure = picture(with_shares(lanes(square(7), ("drive",))), variable=["stick_fraction", "regime"])
    assert [len(meshes(figure, name)) for name in (None, "viridis", "cividis")] == [1, 1, 0]
    (share,), (regime,) = meshes(figure, "viridis"), meshes(figure)
    assert share.axes.get_position().x0 < regime.axes.get_position().x0


def test_variable_over_one_axis_is_drawn_as_curves_above_regimes():
    ds = with_shares(lanes({"gamma": np.linspace(0.3, 1.2, 11)}))
    curves, strip = requested(ds, "stick_fraction").plots
    assert np.array_equal(curves.layers[1].y, ds["stick_fraction"].sel(start="stuck"))
    assert strip.layers[0].values.shape == (2, 11)


def test_variable_of_point_list_is_scattered():
    ds = with_shares(points())
    shown = [layer for plot in requested(ds, "stick_fraction").plots for layer in plot.layers]
    places = {(x, y) for layer in shown if isinstance(layer, Points) for x, y in zip(layer.x, layer.y, strict=True)}
    assert places == set(zip(ds["beta"].values, ds["gamma"].values, strict=True))


def test_variable_of_rock_sweep_and_of_fit_is_drawn_as_curves():
    swept = rock({"k3": [1e8, 3e8], "frequency": np.linspace(10, 40, 5)})
    assert np.allclose(requested(swept, "relief").plots[0].layers[1].y, swept["relief"].sel(k3=3e8))
    fit = law({"force": [2e5, 2.5e5, 3e5]})
    curves = requested(fit, "aic").plots[0].layers
    assert np.array_equal([curve.y for curve in curves], fit["aic"].transpose("form", "force"))


def test_variables_of_run_are_drawn_as_histories():
    ds = run(duration=2.0)
    plots = requested(ds, ["v2", "stuck"]).plots
    assert [plot.y.label for plot in plots] == ["v2\n[m/s]", "stuck"]
    assert np.array_equal(plots[0].layers[0].y, ds["v2"])


def test_flag_names_label_colour_bar():
    ds = lanes(square(7), ("drive",))
    ds["check_regime"] = flagged(
        ds["regime"].dims, np.where(ds["beta"].values[:, None, None] > 0.6, 6, 3) + 0 * ds["regime"]
    )
    figure = picture(ds, variable="check_regime")
    (mesh,) = meshes(figure, "check_regime")
    cells = mesh.to_rgba(mesh.get_array())
    regimes = np.array([[REGIME_COLOURS[flag] for flag in row] for row in mesh.get_array().astype(int).tolist()])
    assert [to_hex(cell).upper() for row in cells for cell in row] == regimes.ravel().tolist()
    bar = next(axes for axes in figure.axes if "check regime" in (axes.get_xlabel(), axes.get_ylabel()))
    names = [text.get_text() for axis in (bar.xaxis, bar.yaxis) for text in axis.get_ticklabels()]
    assert names == ["single-impact", "irregular"]


def test_variable_of_many_starts_is_mapped_over_starts_or_as_median():
    over = picture(with_shares(basin(plane())), variable="stick_fraction")
    assert meshes(over, "viridis")[0].get_array().shape == (10, 12) and not meshes(over)
    ds = with_shares(basin(sample(64), LONG))
    figure = picture(ds, variable="stick_fraction")
    median = ds["stick_fraction"].median("start").transpose("beta", "gamma")
    assert np.allclose(meshes(figure, "viridis")[0].get_array(), median)
    assert "Of 64 starts the median" in note(figure)


KINDS = {
    "map": lambda: lanes(square(8, delta=[-0.005, 0.005])),
    "line": lambda: lanes({"gamma": np.linspace(0.3, 1.2, 20)}),
    "starts": lambda: lanes({"gamma": [0.7]}),
    "one": lambda: lanes({"gamma": [0.7]}, ("drive",)),
    "points": points,
    "points-of-many": lambda: points(also_v=True),
    "returns": lambda: returns({"gamma": np.linspace(0.3, 1.2, 20), "delta": [-0.005, 0.005]}).drop_dims(
        "return_index"
    ),
    "facets": lambda: lanes(square(7, v=np.linspace(0.5, 2, 7), delta=np.linspace(-0.005, 0.005, 6))),
    "plane": lambda: basin(plane(), {"gamma": [0.5, 0.7]}),
    "start-line": lambda: basin(line()),
    "sample": lambda: basin(sample()),
    "nameless": lambda: basin(sample()).drop_vars([f"start_{name}" for name in ("x1", "v1", "x2", "v2")]),
    "sample-line": lambda: basin(sample(20), {"gamma": LONG["gamma"]}),
    "sample-map": lambda: basin(sample(20), LONG),
    "sample-points": lambda: basin(sample(20), {"point": np.arange(9.0)}).assign_coords(beta=("point", np.arange(9.0))),
}


@pytest.mark.parametrize("count", [1, 4])
@pytest.mark.parametrize("kind", KINDS)
def test_variables_of_every_kind_of_sweep_fit_on_page(kind, count):
    names = ["stick_fraction", "regime", "impact_velocity", "period"][:count]
    sheet = requested(with_shares(KINDS[kind]()), names)
    assert sheet.size[0] <= PAGE[0] and sheet.size[1] <= PAGE[1]
    words = [plot.y.label for plot in sheet.plots] + [scale.label for scale in scales(sheet)]
    assert "share of stick" in words


# Selection by value.


def test_only_lanes_at_selected_value_are_drawn():
    ds = lanes(square(7, delta=[-0.005, 0.005])).assign_attrs(certified=json.dumps({"estimated": 9}))
    figure = picture(ds, where={"delta": 0.005, "start": "stuck"})
    assert np.array_equal(meshes(figure)[0].get_array(), ds["regime"].sel(delta=0.005, start="stuck").T.T)
    assert not titles(figure) and note(figure).startswith("Δ = 5 mm, start: stuck")


def test_values_match_to_four_digits():
    ds = lanes({"gamma": np.linspace(0.6, 0.8, 7), "beta": [0.3, 0.4]})
    assert float(select(ds, {"gamma": 0.63333})["gamma"]) == ds["gamma"].values[1]
    with pytest.raises(InputError, match=r"gamma = 0\.64; there are 0\.6, 0\.633333"):
        select(ds, {"gamma": 0.64})


def test_coordinate_along_axis_selects_all_matching_lanes():
    ds = basin(plane())
    assert select(ds, {"start_v2": 3.0}).sizes["start"] == 12
    assert select(points(), {"start": "stuck"}).sizes["point"] == 20
    vector = select(basin(line(3)), {"start": "[0,0,-0.05,0]"})
    assert float(vector["start_x2"]) == -0.05


def test_group_of_fit_is_selected_by_its_column():
    fit = law({"group": np.arange(3)}).drop_vars("group").assign_coords(rpm=("group", [80.0, 120.0, 160.0]))
    assert float(select(fit, {"rpm": 120})["C"].sel(form="line")) == float(fit["C"].isel(group=1).sel(form="line"))


# Colours.


def test_chosen_colours_apply_to_quantities_but_not_to_regimes():
    ds = lanes(square(7), ("drive",))
    figure = picture(ds, colours="magma")
    assert len(meshes(figure, "magma")) == 2 and len(meshes(figure)) == 1
    assert len(meshes(picture(ds), "viridis")) == 1  # the choice does not affect the next picture


# Invalid requests.

WRONG = [
    (
        {"variable": "stick_fractoin"},
        'variable: "stick_fractoin" is not in the dataset; did you mean "stick_fraction"?',
    ),
    ({"variable": "qqq"}, '"qqq" is not in the dataset; choose from regime, impact_velocity, period'),
    ({"variable": ["return_impact_velocity", "period"]}, "is not one number a lane; choose from regime"),
    ({"variable": ["period"] * 5}, "variable: 5 names; give one to 4"),
    ({"variable": []}, "variable: 0 names"),
    ({"where": {"k0": 1.0}}, 'where: "k0" is none of the dataset\'s axes; choose from gamma, start'),
    ({"where": {"gama": 0.5}}, 'did you mean "gamma"?'),
    (
        {"where": {"gamma": 0.5}},
        "no lane has gamma = 0.5; there are 15 from 0.3 to 1.2, beside it 0.492857 and 0.557143",
    ),
    ({"where": {"gamma": "much"}}, "no lane has gamma = much; there are 15 from 0.3 to 1.2"),
    ({"where": {"gamma": np.nan}}, "no lane has gamma = nan"),
    ({"where": {"start": "stopped"}}, "no lane has start = stopped; there are drive, stuck"),
    ({"colours": "virdis"}, 'colours: "virdis" is not a colour map; did you mean "viridis"?'),
]


@pytest.mark.parametrize(("arguments", "message"), WRONG)
def test_error_names_invalid_value_and_available_ones(arguments, message):
    ds = with_shares(returns({"gamma": np.linspace(0.3, 1.2, 15)}, keep=4))
    with pytest.raises(InputError) as refused:
        picture(ds, **arguments)
    assert message in str(refused.value) and "\n" not in str(refused.value)


def test_run_has_no_axes_for_selection():
    with pytest.raises(InputError, match='"delta" is none of the dataset\'s axes; there are none'):
        picture(run(duration=2.0), where={"delta": 0.005})
    with pytest.raises(InputError, match='"event_kind" is not one number a time'):
        picture(run(duration=2.0), variable="event_kind")


# The command.


@pytest.fixture
def written(tmp_path):
    ds = with_shares(lanes(square(5, delta=[-0.005, 0.005]))).assign_attrs(source="vibrojax 0")
    vj.write_dataset(ds, tmp_path / "map.nc")
    return tmp_path / "map.nc"


def test_command_accepts_same_options(written, monkeypatch):
    received = {}

    def save_picture(ds, path, *how):
        path.write_bytes(b"a picture")
        received.update(path=path, how=how)
        return ""

    monkeypatch.setattr("vibrojax.studies.choose.save_picture", save_picture)
    argv = ["plot", str(written), "--variable", "stick_fraction", "regime", "--variable", "period"]
    assert main([*argv, "--where", "delta=0.005", "start=stuck", "--colours", "magma"]) == 0
    name = "map-stick_fraction-regime-period-delta-0.005-start-stuck-magma.png"
    assert received["path"] == written.with_name(name)
    variables, values = ["stick_fraction", "regime", "period"], {"delta": 0.005, "start": "stuck"}
    assert received["how"] == (variables, values, "magma", None, None)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--where", "delta"], 'where: "delta" is no condition; write one, like'),
        (["--where", "delta=1"], "no lane has delta = 1.0; there are -0.005, 0.005"),
        (["--where", "delta > 1"], "where: no lane has delta > 1; there are -0.005 to 0.005"),
        (["--where", "delta (kg) > 1"], "where: delta (kg) > 1 does not suit delta [m]; write a number in its unit"),
        (["--where", "delta=0.005", "delta=-0.005"], '--where: delta: "-0.005" is a second value; give one'),
        (["--over", "a.nc", "a.nc"], '--over[1]: "a.nc" is there already, at [0]; give each file once'),
        (["--variable", "period", "period"], 'variable[1]: "period" is there already, at [0]; give each variable once'),
        (["--variable", "stick"], 'did you mean "stick_fraction"?'),
        (["--colours", "rainbows"], "is not a colour map"),
    ],
)
def test_command_refuses_invalid_option_in_one_line(written, capsys, words, message):
    assert main(["plot", str(written), *words]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1 and not written.with_suffix(".png").exists()


def test_command_writes_picture(written):
    assert main(["plot", str(written), "--variable", "stick_fraction", "--where", "start=drive"]) == 0
    assert written.with_name("map-stick_fraction-start-drive.png").read_bytes().startswith(b"\x89PNG")
    assert main(["plot", str(written), "--variable", "period", "--where", "delta (mm) > 0"]) == 0
    assert written.with_name("map-period-delta_mm-0.png").exists()


def test_command_does_not_replace_other_pictures(tmp_path, monkeypatch, capsys):
    """A picture with options gets its own file name, with a number if another picture already has that name."""
    monkeypatch.chdir(tmp_path)
    for name, gap in (("map.nc", 0.005), ("a/borders.nc", 0.001), ("b/borders.nc", 0.002)):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        vj.write_dataset(lanes(square(5, delta=[-0.005, gap])).assign_attrs(source="vibrojax 0"), tmp_path / name)
    content = {}

    def save_picture(ds, path, *how):
        path.write_bytes(b"\x89PNG Software\0vibrojax " + f"{content.get('as')} {how}".encode())
        return ""

    def command_output(*words):
        assert main(["plot", "map.nc", *words]) == 0
        return capsys.readouterr().out.rstrip()

    monkeypatch.setattr("vibrojax.studies.choose.save_picture", save_picture)
    many = ("--variable", "a", "b", "c", "d", "e", "--where", "start=[0, 0,1,0]")
    for _ in range(2):  # the same picture is written again to the same file
        assert command_output() == "map.png"
        assert command_output("--variable", "period") == "map-period.png"
        assert command_output("--over", "a/borders.nc") == "map-over-borders.png"
        assert command_output("--over", "b/borders.nc") == "map-over-borders-2.png"
        assert command_output("--over", "b/borders.nc", "--variable", "period") == "map-period-over-borders.png"
        assert command_output("--diagram", "campbell") == "map-campbell.png"
        assert command_output(*many) == "map-a-b-c-and-2-more-start-_0_0_1_0_.png"
    (tmp_path / "map-magma.png").write_bytes(b"of something else")
    kept = {path.name: path.read_bytes() for path in tmp_path.glob("map*.png")}
    assert command_output("--colours", "magma") == "map-magma-2.png"
    content["as"] = "of other values"
    assert command_output("--variable", "period") == "map-period-2.png"
    assert all((tmp_path / name).read_bytes() == bytes_ for name, bytes_ in kept.items())
    assert command_output() == "map.png: replaces another picture"
    assert command_output("-o", "map.png", "--variable", "period") == "map.png"
    assert not list(tmp_path.glob(".*"))


def test_variable_of_sweep_without_regime_and_rate_is_drawn():
    swept = xr.Dataset(
        {"status": ("gamma", np.zeros(3, np.int8)), "power": ("gamma", [1.0, 2.0, 3.0])}, {"gamma": [1.0, 2.0, 3.0]}
    )
    assert "power" in axis_labels(picture(swept, variable="power"))
    assert not legend(picture(swept, variable="power"))
