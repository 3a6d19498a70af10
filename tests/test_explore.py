"""Tests of explorer pages without a browser: encoding, motions against single runs, and refused datasets."""

import base64
import json
import re
import zlib
from pathlib import Path
from typing import Any

import drawn
import numpy as np
import pytest
import xarray as xr
from cell_blocks import decode
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib import colormaps
from matplotlib.colors import Normalize, to_hex
from refusals import command_refusal
from systems import BALL

import vibrojax as vj
from vibrojax.explorer import Cell, cell_of, contents_of, encode, module_text, write, write_page
from vibrojax.explorer.encoding import EVENTS, STATE_LEVELS, StateColumn
from vibrojax.explorer.plots_view import figure_document
from vibrojax.explorer.views import summary_parts
from vibrojax.pictures.branches import MARKS
from vibrojax.pictures.colours import REGIME_COLOURS, value_of
from vibrojax.pictures.motion import states_over_time
from vibrojax.pictures.plots import Area, Axis, Cells, Layer, Line, Plot, Points, Sheet, Text, dots, level

COLUMNS = (StateColumn("x1", "m", "position"), StateColumn("v1", "m s-1", "velocity"))
PLANE = {
    "scene": "vibro-impact",
    "starts": ["drive", "stuck"],
    "grid": {"beta": [0.3, 0.4], "gamma": [0.35, 0.75], "delta": [0.005]},
}


@pytest.fixture(scope="module")
def plane() -> xr.Dataset:
    return vj.run_sweep(PLANE, progress=False)


@pytest.fixture(scope="module")
def cells(plane) -> list[Cell]:
    return list(contents_of(plane, progress=False).cells)


def unpack(packed: dict) -> np.ndarray:
    """Decode an array as the page's `unpack` does."""
    width = np.dtype(packed["dtype"]).itemsize
    planes = np.frombuffer(zlib.decompress(base64.b64decode(packed["data"])), np.uint8).reshape(width, -1)
    return np.ascontiguousarray(planes.T).view(f"<{packed['dtype']}").reshape(packed["shape"])


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.lists(st.integers(0, 40), min_size=1, max_size=4))
def test_cells_survive_encoding(seed: int, sizes: list[int]):
    random = np.random.default_rng(seed)
    cells = []
    for lane, size in enumerate(sizes):
        states = {column.name: random.normal(size=size) * 10.0 ** random.integers(-6, 6) for column in COLUMNS}
        time = np.sort(random.uniform(size=size))
        flags = random.integers(0, 32, size).astype(np.uint8)
        section = {"x1": random.normal(size=3), "v1": np.full(3, 7.5)}
        numbers = {"regime": 3, "period": 0.25, "impact_velocity": None}
        known = random.uniform(size=(2, 2)) if size % 2 else None
        cells.append(Cell(lane, "motion", "a note", 5, 1.0, COLUMNS, time, states, flags, known, section, numbers))
    for cell, decoded in zip(cells, decode(encode(cells)), strict=True):
        assert (decoded.lane, decoded.kind, decoded.note, decoded.returns) == (
            cell.lane,
            cell.kind,
            cell.note,
            cell.returns,
        )
        assert decoded.numbers == cell.numbers
        np.testing.assert_array_equal(decoded.flags, cell.flags)
        np.testing.assert_allclose(decoded.time, cell.time, atol=0.51 / 16383)
        for name, values in cell.states.items():
            step = np.ptp(values) / STATE_LEVELS if values.size else 0.0
            np.testing.assert_allclose(decoded.states[name], values, atol=0.51 * step, rtol=1e-6)
        np.testing.assert_allclose(decoded.section["v1"], 7.5)
        if cell.multipliers is not None and decoded.multipliers is not None:
            np.testing.assert_allclose(decoded.multipliers, cell.multipliers, rtol=1e-6)


def test_cells_are_closed_orbits_of_their_lanes(plane, cells):
    sweep = vj.read_sweep(PLANE)
    assert [cell.lane for cell in cells] == list(range(sweep.lanes))
    features = {name: plane[name].transpose(*sweep.dims).values.ravel() for name in ("period", "cycles", "impacts")}
    orbits = [cell for cell in cells if cell.kind == "orbit"]
    assert len(orbits) >= 4
    for cell in orbits:
        period, cycles, impacts = (values[cell.lane] for values in features.values())
        assert cell.returns == cycles and cell.duration == pytest.approx(cycles * period, rel=1e-4)
        assert (cell.flags & 7 == EVENTS.index("impact")).sum() == impacts
        assert all(abs(values[-1] - values[0]) < 1e-3 * np.ptp(values) for values in cell.states.values())
        assert cell.multipliers is not None and cell.multipliers[0, 0] < 1.0


def test_summary_has_the_symbols_of_the_pictures():
    [part] = summary_parts(drawn.rock({"k3": [1e8, 3e8], "force": [1e5, 3e5]}))
    assert part["lines"][1].startswith("largest at k₃=1e+08")


def test_states_before_and_after_an_impact_are_at_its_own_time():
    """A ball that loses half of its velocity at each impact, as a lane of a sweep and as a sampled trajectory."""
    lane = {"scene": BALL, "starts": [[1.0, 0.0]], "grid": {"r": [0.5]}, "run": {"settle": 0.3, "observe": 0.2}}
    swept = next(iter(contents_of(vj.run_sweep(lane, progress=False), own=vj.read_sweep(lane), progress=False).cells))
    motion = vj.simulate(BALL, start=[1.0, 0.0], duration=2.0, sampling=0.011, progress=False)
    for cell in (swept, cell_of(motion)):
        before = np.flatnonzero(cell.flags & 7 == EVENTS.index("impact"))[:3]
        assert before.size and (cell.time[before] == cell.time[before + 1]).all()
        np.testing.assert_allclose(cell.states["v"][before + 1], -0.5 * cell.states["v"][before], rtol=1e-3)
        np.testing.assert_allclose([cell.states["x"][before], cell.states["x"][before + 1]], 0.0, atol=1e-4)
    unsettled = motion.assign(drift_estimate=np.inf)
    document = contents_of(unsettled).document  # a number without an end refuses no page
    words = "still on its way to where it settles, and its returns do not tell how far"
    assert all(words in text for text in (cell_of(unsettled).note, str(document["summary"])))
    assert words[1:] in states_over_time(unsettled).note and words not in cell_of(motion).note
    assert document["common"].count("r = 0.5") == 1 and "bit" not in document["meanings"]["equilibrium"]


def test_document_holds_numbers_and_colours(plane):
    document = contents_of(plane).document
    assert document["view"] == ["gamma", "beta"]
    for variable in document["variables"]:
        data = plane[variable["name"]].transpose(*variable["axes"])
        decoded = unpack(variable["data"])
        if data.dtype.kind == "f":
            np.testing.assert_allclose(decoded, data.values, rtol=1e-5)
        else:
            np.testing.assert_array_equal(decoded, data.values)
    lanes = unpack(document["lanes"])
    assert sorted(lanes.ravel().tolist()) == list(range(8))
    json.dumps(document, allow_nan=False)
    document = contents_of(plane).document
    variables = {entry["name"]: entry for entry in document["variables"]}
    assert variables["regime"]["colours"]["3"] == REGIME_COLOURS[3]
    value, entry = value_of(plane["impact_velocity"]), variables["impact_velocity"]
    map_ = document["maps"][entry["map"]]
    for x in plane["impact_velocity"].values.ravel()[:4]:
        share = (x * entry["factor"] - entry["low"]) / (entry["high"] - entry["low"])
        shown = map_[max(0, min(255, int(share * 256)))]
        assert shown == to_hex(value.colour_map(value.norm(x * value.factor)))


def test_family_document_has_branches_and_orbits():
    fam = vj.follow("vibro-impact", along="gamma", at=0.75, span=(0.74, 0.76), start="stuck", beta=0.4, progress=False)
    contents = contents_of(fam)
    document, cells = contents.document, list(contents.cells)
    assert document["kind"] == "family"
    assert {tuple(run["points"]) for run in document["family"]["runs"]} == {tuple(range(fam.sizes["point"]))}
    assert len(cells) == fam.sizes["point"]
    for k, cell in enumerate(cells):
        assert cell.lane == k and cell.kind == "orbit"
        assert cell.duration == pytest.approx(float(fam["period"][k]), rel=1e-6)
        closure = abs(cell.states["x2"][-1] - cell.states["x2"][0])
        assert closure < 1e-6 * np.ptp(cell.states["x2"])


def test_every_kind_of_special_point_has_a_shape():
    """The page's one table of marks, for plots and legends, has the markers of the pictures; circles need none."""
    table = re.search(r"const AREAS = .*?\n};\nconst STROKES = .*?;\n", module_text(), re.DOTALL)
    assert table
    names = set(re.findall(r"""["']?([A-Za-z*|^<>+])["']?: (?=\[|AROUND)""", table[0]))
    assert {str(mark["marker"]) for mark in MARKS.values()} <= {*names, "o"}


def test_page_loads_nothing_and_text_cannot_end_its_script(plane, tmp_path):
    named = plane.assign_attrs(title="</script><script>alert(1)</script>")
    path = write_page(named, tmp_path / "page.html", progress=False)
    text = path.read_text(encoding="utf-8")
    assert "@" not in re.sub(r"@(media|supports|container)", "", text.split("<body>")[0])
    policy = text.partition('http-equiv="Content-Security-Policy"')[2].partition(">")[0]
    assert "default-src 'none'" in policy and "connect-src 'none'" in policy and "unsafe" not in policy
    assert text.count("</script>") == 3 and "alert(1)</script>" not in text
    assert not re.findall(r"""(?:src|href)\s*=\s*["'](?!data:)""", text)
    assert not re.findall(r"\b(?:fetch|XMLHttpRequest|WebSocket|EventSource|sendBeacon|import)\s*\(", text)
    assert not re.findall(r"url\((?!data:|#)", text)


def test_undrawable_datasets_are_refused_in_one_line(plane, tmp_path, capsys: pytest.CaptureFixture[str]):
    sweep, study, empty = (str(tmp_path / f"{name}.nc") for name in ("sweep", "study", "nothing"))
    vj.write_dataset(plane, sweep)
    attributes = {"source": "vibrojax 0"}
    vj.write_dataset(xr.Dataset({"error_worst": ("setting", [1.0])}, attrs=attributes), study)
    vj.write_dataset(xr.Dataset(attrs=attributes), empty)
    assert "no such file" in command_refusal(capsys, "explore", str(tmp_path / "none.nc"))
    assert "does not end in .html" in command_refusal(capsys, "explore", sweep, "-o", str(tmp_path / "page.txt"))
    assert "holds no borders or curves" in command_refusal(capsys, "explore", sweep, "--over", sweep)
    assert f"{study}: its content does not fit together" in command_refusal(capsys, "explore", study)
    assert f"{empty}: explore: nothing to draw" in command_refusal(capsys, "explore", empty)
    assert not list(tmp_path.glob("*.html"))


def test_plots_keep_their_numbers_and_are_linked_to_axes():
    """Infinite coordinates become the ends of the axes; a plot over an axis of the dataset is linked to it."""
    x = np.array([1.0, 10.0, 100.0])
    ds = xr.Dataset(coords={"force": ("force", [1e3, 1e4], {"units": "N"}), "start": ["a", "b"]})
    layers: list[Layer] = [
        Line(x, 2 * x, "#112233", dash="--", label="law"),
        Points(x, x, ["#ff0000", "#00ff00", "#0000ff"], 4.0, values=[7.0, np.nan, 9.0]),
        Area(x, x, 3 * x, "#abcdef", 0.5),
        level(7.0, colour="#123456"),
        Text(0.5, 0.5, "in the middle", relative=True),
    ]
    across = Axis("force [kN]", "force", (1.0, 100.0), log=True)
    depth = Axis("depth [m]", limits=(0.0, 300.0), reversed=True)
    strip = Cells([0.0, 1.0, 2.0], [0.0, 1.0], np.array([[0.0, np.nan]]), colormaps["viridis"], Normalize(0.0, 1.0))
    value = value_of(xr.DataArray([-0.5, 3.0], name="share", attrs={"units": "%"}))
    plots = [
        Plot(layers, across, depth, at={"start": "b"}, scale=value),
        Plot([strip], Axis(ticks=[(0.5, "left")]), place=(1, 0)),
    ]
    axes: list[dict[str, Any]] = [{"name": name, "columns": []} for name in ("force", "start")]
    document = figure_document(Sheet(plots, (6.0, 4.0), heights=(1.0, 0.3)), ds, axes)
    first, second = document["plots"]
    line, points, area, upright, text = (
        next(one for one in first["items"] if one.get(key) == look)
        for key, look in (
            ("colour", "#112233"),
            ("kind", "points"),
            ("kind", "area"),
            ("colour", "#123456"),
            ("kind", "text"),
        )
    )
    assert line["x"] == x.tolist() and line["y"] == (2 * x).tolist() and line["dash"] and line["label"] == "law"
    assert points["colours"] == ["#ff0000", "#00ff00", "#0000ff"] and points["sizes"] == [2.0]
    assert points["values"] == [7.0, None, 9.0]
    assert set(area["y"]) == {*x, *(3 * x)} and upright["x"] == [1.0, 100.0] and upright["y"] == [7.0, 7.0]
    assert text["x"] == [pytest.approx(10.0)] and text["y"] == [150.0]
    assert first["x"]["log"] and first["x"]["direction"] == "force" and first["at"] == {"start": 1}
    assert first["y"]["reversed"] and first["y"]["direction"] is None and second["x"]["ticks"] == [[0.5, "left"]]
    shown, missing = unpack(second["items"][0]["data"]).tolist()
    assert shown >= 0 and missing == -1 and second["items"][0]["values"] == [0.0, None]
    [bar] = document["bars"]
    assert (bar["label"], bar["low"], bar["high"], first["bar"], second["bar"]) == ("share [%]", -0.5, 3.0, 0, None)
    json.dumps(document, allow_nan=False)


def test_legend_has_signs_as_they_are_drawn_and_the_note_of_the_picture():
    """A sign in ink takes the colour of its marks; a line that a mark hides has no entry."""
    blue, limits = "#56b4e9", (0.0, 1.0)
    layers: list[Layer] = [
        dots([0.5], [0.5], colour=blue, size=9.0),
        Line([0.5, 0.51], [0.5, 0.5], "#aa0000", label="short"),
    ]
    layers += [Line([0.1, 0.9], [0.5, 0.5], "#aa0000", label="long"), dots([0.2], [0.2], face="none")]
    chosen = dots([], [], colour="#222222", size=9.0, label="chosen")
    sheet = Sheet(
        [Plot(layers, Axis("x", limits=limits), Axis("y", limits=limits))], keys=[[chosen]], note="a = 1. Bars: errors"
    )
    ds = xr.Dataset(coords={"a": 1.0})
    figure = figure_document(sheet, ds, [])
    assert {key["text"]: key["colour"] for key in figure["keys"]} == {"chosen": blue, "long": "#aa0000"}
    assert figure["note"] == "Bars: errors"
    assert [one["hollow"] for one in figure["plots"][0]["items"] if one["kind"] == "points"] == [False, "none"]


def test_modules_share_one_scope_without_clashes():
    """The modules of a page are one script, in which the later of two functions of a name would replace the other."""
    folder = Path(write.__file__).parent / "page"
    defined = r"^(?:export )?(?:async )?(?:function\*?|class|const|let) (\w+)"
    for more in (("begin.js", "served.js", *write.LIVE_MODULES), ("begin.js", "page.js"), ("widget.js",)):
        text = "".join((folder / name).read_text(encoding="utf-8") for name in (*write.MODULES, *more))
        names = re.findall(defined, text, re.MULTILINE)
        assert len(names) > 100 and {name for name in names if names.count(name) > 1} == set()


def test_plots_of_a_page_have_the_labels_that_panels_share():
    """Each plot stands alone on a page: it has the label at the left of its row, but not beside named ticks."""
    line, names = Line([0.0, 1.0], [2.0, 3.0]), Axis(ticks=[(0.0, "beta"), (1.0, "gamma")])
    time, rate = Axis("time [s]"), Axis("rate [m/h]")
    plots = [
        Plot([line], Axis(), rate, place=(0, 0)),
        Plot([line], Axis(), Axis(), place=(0, 1)),
        Plot([line], time, rate, place=(1, 0)),
        Plot([line], names, names, place=(1, 1)),
    ]
    shown = figure_document(Sheet(plots), xr.Dataset(), [])["plots"]
    labels = [(plot["x"]["label"], plot["y"]["label"]) for plot in shown]
    assert labels == [("time [s]", "rate [m/h]"), ("", "rate [m/h]"), ("time [s]", "rate [m/h]"), ("", "")]
