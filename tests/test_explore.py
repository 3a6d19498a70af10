"""What a page holds, before any browser: the form of cells and arrays, motions against single runs, what is refused."""

import base64
import json
import re
import zlib
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from cell_blocks import decode
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.explorer import Cell, cell_of, cells_of, document_of, encode, module_text, page_text, write_page
from vibrojax.explorer.encoding import EVENTS, MANTISSA_BITS, STATE_LEVELS, STUCK, StateColumn, pack
from vibrojax.explorer.figure_view import figure_document
from vibrojax.explorer.reading import first_cell
from vibrojax.explorer.write import blocks_of
from vibrojax.sweep.input.read import read_sweep

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
def cells(plane: xr.Dataset) -> list[Cell]:
    return list(cells_of(plane, progress=False))


@cache
def run_of(lane: int) -> xr.Dataset:
    """A single run of a lane of the plane."""
    sweep = read_sweep(PLANE)
    values, start = sweep.lane_values(lane, lane + 1)
    point = {name: float(values[name][0]) for name in ("beta", "gamma", "delta")}
    return vj.simulate("vibro-impact", **point, start=sweep.start_names[start[0]], duration=48.0, progress=False)


def unpacked(one: dict) -> np.ndarray:
    """What the page's `unpack` does, written anew."""
    width = np.dtype(one["dtype"]).itemsize
    planes = np.frombuffer(zlib.decompress(base64.b64decode(one["data"])), np.uint8).reshape(width, -1)
    return np.ascontiguousarray(planes.T).view(f"<{one['dtype']}").reshape(one["shape"])


# The forms.


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.lists(st.integers(0, 40), min_size=1, max_size=4))
def test_cells_come_back_from_their_bytes(seed: int, sizes: list[int]) -> None:
    random = np.random.default_rng(seed)
    cells = []
    for lane, size in enumerate(sizes):
        states = {one.name: random.normal(size=size) * 10.0 ** random.integers(-6, 6) for one in COLUMNS}
        time = np.sort(random.uniform(size=size))
        flags = random.integers(0, 32, size).astype(np.uint8)
        section = {"x1": random.normal(size=3), "v1": np.full(3, 7.5)}
        numbers = {"regime": 3, "period": 0.25, "impact_velocity": None}
        known = random.uniform(size=(2, 2)) if size % 2 else None
        cells.append(Cell(lane, "motion", "a note", 5, 1.0, COLUMNS, time, states, flags, known, section, numbers))
    for one, back in zip(cells, decode(encode(cells)), strict=True):
        assert (back.lane, back.kind, back.note, back.returns) == (one.lane, one.kind, one.note, one.returns)
        assert back.numbers == one.numbers
        np.testing.assert_array_equal(back.flags, one.flags)
        np.testing.assert_allclose(back.time, one.time, atol=0.51 / 16383)
        for name, values in one.states.items():
            step = np.ptp(values) / STATE_LEVELS if values.size else 0.0
            np.testing.assert_allclose(back.states[name], values, atol=0.51 * step, rtol=1e-6)
        np.testing.assert_allclose(back.section["v1"], 7.5)
        if one.multipliers is not None and back.multipliers is not None:
            np.testing.assert_allclose(back.multipliers, one.multipliers, rtol=1e-6)


def test_a_block_of_nothing_and_a_cell_without_a_motion() -> None:
    assert decode(encode([])) == []
    [back] = decode(encode([Cell(7, "none", "refused: too stiff")]))
    assert (back.lane, back.kind, back.note, len(back.time)) == (7, "none", "refused: too stiff", 0)


def test_arrays_keep_five_digits_and_what_is_no_number() -> None:
    values = np.array([[1.0, np.nan, -np.inf], [1.23456789e-8, 98765.4321, 0.0]])
    back = unpacked(pack(values))
    finite = np.isfinite(values)
    np.testing.assert_allclose(back[finite], values[finite], rtol=2.0 ** -(MANTISSA_BITS + 1))
    np.testing.assert_array_equal(back[~finite], values[~finite].astype(np.float32))
    for whole in (np.array([-1, 0, 7], np.int8), np.array([0, 70_000, -5])):
        np.testing.assert_array_equal(unpacked(pack(whole)), whole)


# Motions.


def test_a_cell_is_the_motion_that_its_lane_settles_on(plane: xr.Dataset, cells: list[Cell]) -> None:
    """Against single runs of the lanes: an orbit starts at its section, closes, and is where the run is."""
    sweep = read_sweep(PLANE)
    assert [cell.lane for cell in cells] == list(range(sweep.lanes))
    orbits = 0
    regimes = plane["regime"].transpose(*sweep.dims).values.ravel()
    for lane, cell in enumerate(cells):
        if cell.kind != "orbit":
            continue
        orbits += 1
        run = run_of(lane)
        sections = run["event_time"].values[run["event_kind"].values == EVENTS.index("section")]
        assert cell.duration == pytest.approx(sections[-1] - sections[-1 - cell.returns], rel=1e-4)
        begin = min(sections[-1 - cell.returns : -1], key=lambda t: abs(_at(run, "x2", t) - cell.states["x2"][0]))
        for name, values_ in cell.states.items():
            swing = np.ptp(values_)
            # A sample of the run every millisecond: at a blow a velocity turns between two of them.
            where = np.full(len(cell.time), name.startswith("x")) | (cell.flags & 7 == 0)
            apart = np.abs(_at(run, name, begin + cell.time - 1e-9) - values_)[where]
            assert np.quantile(apart, 0.95) < 2e-3 * swing, (lane, name)
            assert abs(values_[-1] - values_[0]) < 1e-3 * swing
        impacts = int((cell.flags & 7 == EVENTS.index("impact")).sum())
        assert impacts == float(plane["impacts"].transpose(*sweep.dims).values.ravel()[lane])
        assert cell.multipliers is not None and cell.multipliers[0, 0] < 1.0
    assert orbits >= 4
    assert (regimes == 3).sum() >= 2


def _at(run: xr.Dataset, name: str, times: np.ndarray) -> np.ndarray:
    length = float(run["time"][-1])
    return np.interp(np.minimum(times, length), run["time"].values, run[name].values)


def test_what_sticks_goes_back_with_the_drive(cells: list[Cell]) -> None:
    """Stuck to the rock, or just coming to that or leaving it, the bit has x1' = -v."""
    events = {name: 0 for name in ("stick", "slip")}
    for cell in cells:
        at_rest = (cell.flags & STUCK) > 0
        for name in events:
            there = cell.flags & 7 == EVENTS.index(name)
            events[name] += int(there.sum())
            at_rest |= there
        np.testing.assert_allclose(cell.states["v1"][at_rest], -1.5, atol=1e-6)
    assert events["stick"] >= 1 and events["slip"] >= 4


def test_a_trajectory_ends_as_its_lane_does(cells: list[Cell]) -> None:
    lane = next(cell.lane for cell in cells if cell.kind == "orbit" and cell.returns == 1)
    cell, of_lane = cell_of(run_of(lane)), cells[lane]
    assert (cell.kind, cell.returns) == ("orbit", 1)
    assert cell.duration == pytest.approx(of_lane.duration, rel=1e-5)
    for name in ("x1", "x2"):
        ends = [(np.min(one.states[name]), np.max(one.states[name])) for one in (cell, of_lane)]
        np.testing.assert_allclose(ends[0], ends[1], atol=3e-3 * np.ptp(ends[1]))
    assert cell.numbers is not None and cell.numbers["regime"] == 3


def test_lanes_that_were_refused_say_why() -> None:
    grid = {"pulse_width": [4e-3, 3e-2], "frequency": [20.0, 50.0]}
    ds = vj.run_sweep({"scene": "penetration", "grid": grid, "run": {"settle": 0.5, "observe": 0.5}}, progress=False)
    cells = list(cells_of(ds, progress=False))
    assert [cell.kind for cell in cells] == ["orbit", "orbit", "orbit", "none"]
    assert cells[3].note.startswith("refused: pulse width not below 1/frequency")
    assert cells[0].duration == pytest.approx(1 / 20.0)


# Documents.


def test_numbers_of_a_document_are_those_of_the_dataset(plane: xr.Dataset) -> None:
    document = document_of(plane)
    assert document["view"] == ["gamma", "beta"]
    for variable in document["variables"]:
        data = plane[variable["name"]].transpose(*variable["axes"])
        back = unpacked(variable["data"])
        if data.dtype.kind == "f":
            np.testing.assert_allclose(back, data.values, rtol=1e-5)
        else:
            np.testing.assert_array_equal(back, data.values)
    lanes = unpacked(document["lanes"])
    assert sorted(lanes.ravel().tolist()) == list(range(8))
    json.dumps(document, allow_nan=False)


def test_colours_are_those_of_the_picture(plane: xr.Dataset) -> None:
    from matplotlib.colors import to_hex

    from vibrojax.plot.colours import REGIME_COLOURS, value_of

    variables = {one["name"]: one for one in document_of(plane)["variables"]}
    assert variables["regime"]["colours"]["3"] == REGIME_COLOURS[3]
    value, one = value_of(plane["impact_velocity"]), variables["impact_velocity"]
    map_ = document_of(plane)["maps"][one["map"]]
    for x in plane["impact_velocity"].values.ravel()[:4]:
        share = (x * one["factor"] - one["low"]) / (one["high"] - one["low"])
        shown = map_[max(0, min(255, int(share * 256)))]
        assert shown == to_hex(value.colour_map(value.norm(x * value.factor)))


def test_a_plane_of_starts_has_its_lanes_where_they_belong() -> None:
    starts = {"plane": {"x2": {"start": -0.05, "stop": 0.05, "num": 3}, "v2": [-1.0, 1.0]}, "at": {"v1": -1.5}}
    given = {"scene": "vibro-impact", "starts": starts, "run": {"settle": 1.0, "observe": 1.0}}
    ds = vj.run_sweep(given, progress=False)
    document = document_of(ds)
    assert document["lanes"]["axes"] == ["start_x2", "start_v2"]
    lanes, x2 = unpacked(document["lanes"]), document["axes"][0]["values"]
    for i, j in np.ndindex(lanes.shape):
        assert x2[i] == pytest.approx(float(ds["start_x2"][lanes[i, j]]))
        assert document["axes"][1]["values"][j] == pytest.approx(float(ds["start_v2"][lanes[i, j]]))


def test_families_open_with_their_branches_and_orbits() -> None:
    fam = vj.follow("vibro-impact", along="gamma", at=0.75, span=(0.74, 0.76), start="stuck", beta=0.4, progress=False)
    document, cells = document_of(fam), list(cells_of(fam))
    assert document["kind"] == "family"
    assert {tuple(run["points"]) for run in document["family"]["runs"]} == {tuple(range(fam.sizes["point"]))}
    assert len(cells) == fam.sizes["point"]
    for k, cell in enumerate(cells):
        assert cell.lane == k and cell.kind == "orbit"
        assert cell.duration == pytest.approx(float(fam["period"][k]), rel=1e-6)
        closes = abs(cell.states["x2"][-1] - cell.states["x2"][0])
        assert closes < 1e-6 * np.ptp(cell.states["x2"])


# The page.


def test_the_page_of_the_default_map_is_under_ten_megabytes() -> None:
    """By the lanes of a coarser grid over the same plane."""
    plane = {"beta": {"start": 0.1, "stop": 1.2, "num": 5}, "gamma": {"start": 0.3, "stop": 1.2, "num": 6}}
    grid = plane | {"delta": [-0.005, 0.005]}
    ds = vj.run_sweep({**PLANE, "grid": grid}, progress=False)
    blocks = blocks_of(cells_of(ds, progress=False))
    document = document_of(ds)
    text = page_text(document, blocks)
    each = (sum(map(len, blocks)) + sum(len(one["data"]["data"]) for one in document["variables"])) / ds["regime"].size
    assert 8280 * each + len(text) < 10e6
    assert each > 300  # there is something in it


def test_a_page_loads_nothing_and_nothing_ends_its_script(plane: xr.Dataset, tmp_path: Path) -> None:
    named = plane.assign_attrs(title="</script><script>alert(1)</script>")
    path = write_page(named, tmp_path / "page.html", progress=False)
    text = path.read_text(encoding="utf-8")
    assert "@" not in re.sub(r"@(media|supports|container)", "", text.split("<body>")[0])
    assert text.count("</script>") == 3 and "alert(1)</script>" not in text
    assert not re.findall(r"""(?:src|href)\s*=\s*["'](?!data:)""", text)
    assert not re.findall(r"\b(?:fetch|XMLHttpRequest|WebSocket|EventSource|sendBeacon|import)\s*\(", text)
    assert not re.findall(r"url\((?!data:|#)", text)


def test_the_module_is_one_text_that_imports_nothing() -> None:
    text = module_text(exported=True)
    assert "import " not in re.sub(r"//.*|/\*.*?\*/", "", text, flags=re.DOTALL).replace("important", "")
    assert text.endswith("\nexport { mount, decodeCells, embeddedSource };\n") and text.count("\nexport ") == 1


# What is refused.


def _said(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(["explore", *words]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    return said


def test_what_cannot_be_shown_is_refused_in_one_line(
    plane: xr.Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sweep, study, nothing = (str(tmp_path / f"{name}.nc") for name in ("sweep", "study", "nothing"))
    vj.write_dataset(plane, sweep)
    about = {"source": "vibrojax 0"}
    vj.write_dataset(xr.Dataset({"error_worst": ("setting", [1.0])}, attrs=about), study)
    vj.write_dataset(xr.Dataset(attrs=about), nothing)
    assert "no such file" in _said(capsys, str(tmp_path / "none.nc"))
    assert "does not end in .html" in _said(capsys, sweep, "-o", str(tmp_path / "page.txt"))
    assert "holds no borders or curves" in _said(capsys, sweep, "--over", sweep)
    assert f"{study}: its content does not fit together" in _said(capsys, study)
    assert f"{nothing}: explore: nothing to draw" in _said(capsys, nothing)
    assert not list(tmp_path.glob("*.html"))


def test_a_page_with_borders_replaces_no_other_page(
    plane: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("map.nc", "a/borders.nc", "b/borders.nc"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        vj.write_dataset(plane.assign_attrs(title=name), tmp_path / name)
    monkeypatch.setattr(
        "vibrojax.explorer.write_page",
        lambda ds, path, over, **_: path.write_text(ds.title + ("" if over is None else over.title)),
    )

    def written(*words: str) -> str:
        assert main(["explore", "map.nc", *words]) == 0
        return capsys.readouterr().out.rstrip()

    for _ in range(2):
        assert written() == "map.html: 0.0 MB"
        assert written("--over", "a/borders.nc") == "map-over-borders.html: 0.0 MB"
        assert written("--over", "b/borders.nc") == "map-over-borders-2.html: 0.0 MB"
    assert (tmp_path / "map-over-borders.html").read_text() == "map.nca/borders.nc"
    (tmp_path / "map.html").write_text("of an earlier dataset")
    assert written() == "map.html: 0.0 MB; replaces another page"


def test_a_dataset_whose_sweep_is_not_known_opens_without_motions(plane: xr.Dataset) -> None:
    alone = plane.copy()
    del alone.attrs["sweep"]
    document = document_of(alone)
    assert document["lanes"] is None and "no motions" in document["without"]
    assert list(cells_of(alone)) == []


# Plots of the analyses.


def test_a_figure_is_described_in_its_data_coordinates() -> None:
    """Lines, points, areas, cells and texts keep their numbers; an axis named as the dataset's is linked to it."""
    x, ds = np.array([1.0, 10.0, 100.0]), xr.Dataset(coords={"force": ("force", [1e3, 1e4], {"units": "N"})})
    figure = Figure()
    axes, strip = figure.subplots(2)
    axes.plot(x, 2 * x, color="#112233", linestyle="--", marker="s", label="law")
    axes.scatter(x, x, s=16.0, color=["#ff0000", "#00ff00", "#0000ff"])
    axes.fill_between(x, x, 3 * x, color="#abcdef", alpha=0.5)
    axes.axhline(7.0)
    axes.set(xscale="log", xlabel="force [kN]", ylabel="rate", title="start: a")
    axes.legend()
    strip.pcolormesh([0.0, 1.0, 2.0], [0.0, 1.0], [[0.0, np.nan]])
    strip.set(xticks=[0.5, 1.5], xticklabels=["left", "right"])
    axis = {"name": "force", "columns": [], "values": [1e3, 1e4]}
    found = figure_document([figure], ds, [axis])
    first, second = found["plots"]
    items = {item["kind"]: item for item in reversed(first["items"]) if item.get("colour") != "#1f77b4"}
    assert items["line"]["x"] == x.tolist() and items["line"]["y"] == (2 * x).tolist()
    assert items["line"]["dash"] and items["line"]["colour"] == "#112233"
    assert any(
        one["kind"] == "points" and one["colours"] == ["#ff0000", "#00ff00", "#0000ff"] for one in first["items"]
    )
    assert items["area"]["alpha"] == 0.5 and set(items["area"]["y"]) == {*x, *(3 * x)}
    [level] = [one for one in first["items"] if one.get("colour") == "#1f77b4"]
    assert level["y"] == pytest.approx([7.0, 7.0])
    assert first["x"]["log"] and first["x"]["direction"] == "force" and first["y"]["direction"] is None
    assert second["items"][0]["data"]["shape"] == [2] and second["x"]["ticks"] == [[0.5, "left"], [1.5, "right"]]
    level, missing = unpacked(second["items"][0]["data"]).tolist()
    assert level >= 0 and missing == -1
    assert found["keys"] == [{"text": "law", "shape": "line", "colour": "#112233", "dash": items["line"]["dash"]}]
    json.dumps(found, allow_nan=False)


def test_a_figure_keeps_scales_rows_and_directions() -> None:
    """A title holds for its row, a colour bar becomes a key, and depth grows downwards."""
    figure = Figure(layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot([0.0, 1.0], [1.0, 2.0])
    left.set(title="row of a", ylabel="depth [m]")
    left.invert_yaxis()
    cells = right.pcolormesh([0.0, 1.0, 2.0], [0.0, 1.0], [[-0.5, 3.0]])
    figure.colorbar(cells, ax=right, label="share [%]")
    found = figure_document([figure], xr.Dataset(), [])
    assert [plot["title"] for plot in found["plots"]] == ["row of a", "row of a"]
    assert [plot["y"]["reversed"] for plot in found["plots"]] == [True, False]
    [key] = found["keys"]
    assert key["shape"] == "scale" and key["text"] == "share [%]: −0.5 to 3" and len(key["colours"]) == 9


def test_pages_open_at_what_there_is_most_of() -> None:
    """Attractors at the most frequent one, fits at the form with the lowest AIC, pushes on the side with values."""
    share = xr.DataArray([[1.0, 0.0], [0.3, 0.7], [1.0, 0.0]], dims=("gamma", "attractor"))
    attractors = xr.Dataset({"share": share, "lane_attractor": ("gamma", [0, 1, 0])})
    assert first_cell(attractors, [], []) == {"gamma": 1, "attractor": 1}
    fit = xr.Dataset({"aic": (("form", "k3"), [[3.0, 9.0], [1.0, np.nan]])}, {"form": ["literal", "power"]})
    assert first_cell(fit, [], []) == {"form": 1}
    assert first_cell(xr.Dataset({"push_x1": ("sign", [np.nan, 0.1])}), [], []) == {"sign": 1}


def test_returns_are_a_diagram_and_the_first_cell_is_a_single_impact() -> None:
    grid = {"gamma": [0.35, 0.6, 0.7, 0.75, 0.8]}
    ds = vj.run_sweep({**PLANE, "grid": grid, "run": {"keep_returns": 4}}, progress=False)
    document = document_of(ds)
    diagram = document["variables"][0]
    assert diagram["inner"] == "return_index" and diagram["count"] == 4
    assert diagram["label"] == "impact velocity at each return [m/s]"
    np.testing.assert_allclose(
        unpacked(diagram["data"]), ds["return_impact_velocity"].transpose(*diagram["axes"]), rtol=1e-5
    )
    assert "return_index" not in [axis["name"] for axis in document["axes"]]
    first, regimes = document["first"], ds["regime"]
    single = np.flatnonzero(regimes.isel(start=first["start"]).values == 3)
    assert first["gamma"] in single and abs(first["gamma"] - 2) == np.abs(single - 2).min()
    assert re.match(r"\d+ of 10 motions repeat; all ", document["notes"][0])
