"""Test pictures with chosen variables, values and colours, and the requests that are refused."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from drawn import LONG, basin, cells, lanes, plane, points, returns, rock, sample, scales, sheet_of, square
from matplotlib.collections import QuadMesh
from refusals import command_refusal, refusal

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.measures.labels import SINGLE_IMPACT
from vibrojax.pictures.chart import chart
from vibrojax.pictures.selection import select
from vibrojax.studies.choose import picture, requested


def with_shares(ds):
    """Return `ds` with an added variable that no picture shows by default."""
    values = np.linspace(0.0, 0.5, ds["regime"].size).reshape(ds["regime"].shape)
    return ds.assign(stick_fraction=(ds["regime"].dims, values, {"units": "1", "long_name": "share of time"}))


def test_variable_over_two_axes_is_drawn_as_single_map():
    ds = with_shares(lanes(square(7, delta=[-0.005, 0.005])))
    sheet = requested(ds, "stick_fraction")
    shown = cells(sheet, "viridis")
    assert not cells(sheet) and len(shown) == 4
    expected = ds["stick_fraction"].sel(delta=-0.005, start="stuck").transpose("beta", "gamma")
    assert np.array_equal(shown[1][1].values, expected)
    assert scales(sheet)[0].label == "share of stick" and sheet.plots[0].y.label == "mass ratio m₂/m₁, β"


def test_variable_of_many_starts_is_mapped_over_starts_or_as_median():
    ((_, over),) = cells(requested(with_shares(basin(plane())), "stick_fraction"), "viridis")
    assert over.values.shape == (10, 12)
    ds = with_shares(basin(sample(64), LONG))
    sheet = requested(ds, "stick_fraction")
    ((_, shown),) = cells(sheet, "viridis")
    assert np.allclose(shown.values, ds["stick_fraction"].median("start").transpose("beta", "gamma"))
    assert "Of 64 starts the median" in sheet.note


def test_only_lanes_at_selected_value_are_drawn():
    ds = lanes(square(7, delta=[-0.005, 0.005])).assign_attrs(certified=json.dumps({"estimated": 9}))
    sheet = sheet_of(select(ds, {"delta": 0.005, "start": "stuck"}))
    ((title, shown),) = cells(sheet)
    assert np.array_equal(shown.values, ds["regime"].sel(delta=0.005, start="stuck").transpose("beta", "gamma"))
    assert not title and sheet.note.startswith("Δ = 5 mm, start: stuck")


def test_selection_by_value():
    ds = lanes({"gamma": np.linspace(0.6, 0.8, 7), "beta": [0.3, 0.4]})
    assert float(select(ds, {"gamma": 0.63333})["gamma"]) == ds["gamma"].values[1]
    assert "gamma = 0.64; there are 0.6, 0.633333" in refusal(select, ds, {"gamma": 0.64})
    ds = basin(plane())
    assert select(ds, {"start_v2": 3.0}).sizes["start"] == 12
    assert select(points(), {"start": "stuck"}).sizes["point"] == 20
    vector = select(basin({"x2": np.linspace(-0.05, 0.05, 3)}), {"start": "[0,0,-0.05,0]"})
    assert float(vector["start_x2"]) == -0.05


def test_chosen_colours_apply_to_quantities_but_not_to_regimes():
    ds = lanes(square(7), ("drive",))
    for chosen, names in ({"colours": "magma"}, {"magma"}), ({}, {"viridis", "cividis"}):  # the next picture is usual
        meshes = (mesh for axes in picture(ds, **chosen).axes for mesh in axes.collections)
        shown = [mesh for mesh in meshes if isinstance(mesh, QuadMesh) and not hasattr(mesh.axes, "_colorbar")]
        assert {mesh.get_cmap().name for mesh in shown} == {"regimes", *names}


def test_error_names_invalid_value_and_available_ones():
    ds = with_shares(returns({"gamma": np.linspace(0.3, 1.2, 15)}, keep=4))
    for arguments, message in (
        ({"variable": "stick_fractoin"}, 'variable: "stick_fractoin" is not in the dataset; did you mean "stick_f'),
        ({"variable": ["return_impact_velocity", "period"]}, "is not one number a lane; choose from regime"),
        ({"where": {"k0": 1.0}}, 'where: "k0" is none of the dataset\'s axes; choose from gamma, start'),
        ({"where": {"gamma": 0.5}}, "no lane has gamma = 0.5; there are 15 from 0.3 to 1.2, beside it 0.492857 and"),
    ):
        assert message in refusal(picture, ds, **arguments)


@pytest.fixture
def written(tmp_path):
    ds = with_shares(lanes(square(3, delta=[-0.005, 0.005]))).assign_attrs(source="vibrojax 0")
    vj.write_dataset(ds, tmp_path / "map.nc")
    return tmp_path / "map.nc"


def test_command_refuses_invalid_option_in_one_line(written, capsys):
    for words, message in (
        (["--where", "delta"], 'where: "delta" is no condition; write one, like'),
        (["--where", "delta (kg) > 1"], "where: delta (kg) > 1 does not suit delta [m]; write a number in its unit"),
        (["--where", "delta=0.005", "delta=-0.005"], '--where: delta: "-0.005" is a second value; give one'),
        (["--variable", "period", "period"], 'variable[1]: "period" is there already, at [0]; give each variable once'),
    ):
        assert message in command_refusal(capsys, "plot", written, *words) and not written.with_suffix(".png").exists()


def test_command_writes_picture(written):
    assert main(["plot", str(written), "--variable", "stick_fraction", "--where", "start=drive"]) == 0
    assert written.with_name("map-stick_fraction-start-drive.png").read_bytes().startswith(b"\x89PNG")
    assert main(["plot", str(written), "--variable", "period", "--where", "delta (mm) > 0"]) == 0
    assert written.with_name("map-period-delta_mm-0.png").exists()


def test_command_does_not_replace_other_pictures(written, capsys):
    """A picture with options gets its own file name, with a number if another picture already has that name."""

    def name_of(*words):
        assert main(["plot", str(written), *words]) == 0
        return Path(capsys.readouterr().out.rstrip()).name

    assert [name_of() for _ in range(2)] == ["map.png"] * 2  # the same picture is written again to the same file
    written.with_name("map-magma.png").write_bytes(b"of something else")
    assert name_of("--colours", "magma") == "map-magma-2.png"
    assert written.with_name("map-magma.png").read_bytes() == b"of something else"


def test_campbell_shows_blows_that_differ_from_decided_returns():
    """Returns at 4 Hz: one blow each, two blows, and an undecided lane that has none."""
    table = {"regime": [3, 4, 0], "period": [0.25] * 3, "cycles": [1.0] * 3, "impacts": [1.0, 2.0, 0.0]}
    parameters = json.dumps({"beta": 0.4, "gamma": 0.75, "m1": 1e3, "k1": 5e5})
    ds = xr.Dataset({k: ("v", np.array(v)) for k, v in table.items()}, {"v": [1.0, 1.5, 2.0]})
    (plot,) = requested(ds.assign_attrs(scene="vibro-impact", parameters=parameters), diagram="campbell").plots
    marks = {layer.marker: [*zip(layer.x, layer.y, strict=True)] for layer in plot.layers if layer.marker}
    assert marks["o"] == [(1.0, 4.0), (1.5, 4.0)]
    assert marks["x"] == [(1.5, 8.0)]
    assert len({(bool(layer.marker), layer.order) for layer in plot.layers}) == 2  # no line hides a mark


def test_rate_over_force_lists_the_onsets_of_each_rock_once():
    """The rock slips from a force of 1.1 D on, of which the mean is 0.08 of the greatest force."""
    ds = rock({"force": np.linspace(1e5, 5e5, 9), "k3": [2e8, 3e8], "frequency": [20.0, 30.0]})
    marks, lines = requested(ds, diagram="rate-over-force").keys
    assert [line.label.splitlines()[0] for line in lines] == [f"k₃ = {k} MN/m, onset [kN]" for k in (200, 300)]
    assert lines[0].label.splitlines()[1:] == ["f = 20 Hz 12–16", "f = 30 Hz 18–24"]
    law = "fit of C ln(P/P₀), not compared with other laws"
    assert [mark.label for mark in marks] == [law, "no penetration", "onset"]


def test_star_of_chart_is_robust_within_the_map():
    """Everywhere is a single impact, strongest at the edge, where cells are not known to be robust."""
    grid = np.linspace(0.3, 0.7, 5)
    energy = 100 + 1000 * np.add.outer(grid, grid)
    penetrated = 0 * energy + np.where(np.arange(5) == 0, 0.1, 0.0)  # only in cells that are not robust
    table = {"regime": np.full((5, 5), SINGLE_IMPACT), "impact_energy": energy, "blow_frequency": 0 * energy + 260.0}
    table = {name: (("beta", "gamma"), x) for name, x in (table | {"rate_of_penetration": penetrated}).items()}
    sheet = chart(xr.Dataset(table, {"beta": grid, "gamma": grid}))
    first, label = sheet.plots[0].layers, "robust: also within\ngamma ± 0.1, beta ± 0.1"
    [border] = (layer for layer in first if getattr(layer, "label", "") == label)
    assert np.nanmin([border.x, border.y], axis=1).tolist() == pytest.approx([0.35, 0.35])
    assert np.nanmax([border.x, border.y], axis=1).tolist() == pytest.approx([0.65, 0.65])
    assert np.array_equal(first[0].values, energy) and len(scales(sheet)) == 3  # each quantity has its colour bar
    assert "Best robust cell, by impact energy at worst within the tolerance: gamma = 0.6, beta = 0.6" in sheet.note
    assert sheet.title.startswith("Designer's chart")
