"""Browser tests of the page: it shows the values of the dataset, by pointer, keyboard and link, without any request."""

import json
import re
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import fromstring

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from browser import new_page, wait_for

import vibrojax as vj
from vibrojax.explorer import contents_of, page_text, write_page

# Short lanes are enough to test what a page shows; motions need lanes that settle.
AXES = {"beta": np.linspace(0.2, 0.8, 17), "gamma": np.linspace(0.4, 1.0, 16), "delta": [-0.005, 0.005]}
MANY = {"scene": "vibro-impact", "starts": ["drive", "stuck"], "grid": AXES, "run": {"settle": 2.0, "observe": 3.0}}
FEW = MANY | {"grid": {"beta": [0.3, 0.4, 0.5], "gamma": [0.6, 0.7, 0.8]}, "run": {}}


@pytest.fixture(scope="module")
def many() -> xr.Dataset:
    return vj.run_sweep(MANY, progress=False)


@pytest.fixture(scope="module")
def files(many, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("pages")
    (folder / "many.html").write_text(page_text(contents_of(many).document), encoding="utf-8")
    write_page(vj.run_sweep(FEW, progress=False), folder / "few.html", progress=False)
    return {name: folder / f"{name}.html" for name in ("many", "few")}


class OpenPage:
    """An open page, with the messages of its console (`heard`) and its requests (`asked`)."""

    def __init__(self, browser, path, fragment: str = "", width: int = 1280, scheme: str = "light", **more: object):
        viewport = {"width": width, "height": 900}
        url, options = path.as_uri() + fragment, {"viewport": viewport, "color_scheme": scheme} | more
        self.page, self.heard, self.asked = new_page(browser, url, **options)

    def __enter__(self) -> "OpenPage":
        return self

    def __exit__(self, *_: object):
        self.page.context.close()

    def evaluate(self, script: str, *arguments: object) -> Any:
        return self.page.evaluate(script, *arguments)

    @property
    def cell(self) -> dict[str, int]:
        return self.evaluate("vibrojax.cell")

    def settled(self):
        """Wait until the page shows the last selection."""
        wait_for(self.page, "Number(document.querySelector('[data-ready]').dataset.ready) === vibrojax.asked")


def test_no_request_and_nothing_on_the_console(browser, files):
    for scheme in ("light", "dark"):
        with OpenPage(browser, files["few"], scheme=scheme) as opened:
            for key in ("ArrowRight", "ArrowUp", "End", "Home"):
                opened.page.locator(".vx-over").press(key)
                opened.settled()
            for name in ("impact_velocity", "stable", "cycles"):
                if opened.evaluate("name => vibrojax.grid.variables.has(name)", name):
                    opened.page.get_by_label("Variable").select_option(name)
            assert opened.asked == [files["few"].as_uri()]
            assert opened.heard == []


def test_numbers_of_cells_match_dataset(browser, files, many):
    random = np.random.default_rng(0)
    dims = ("beta", "gamma", "delta", "start")
    picked = [{name: int(random.integers(many.sizes[name])) for name in dims} for _ in range(100)]
    rows = """cells => cells.map(cell => {
        vibrojax.cell = cell;
        return [...vibrojax.numbers(null).querySelectorAll("td")].map(td => [td.dataset.name, td.textContent]);
    })"""
    with OpenPage(browser, files["many"]) as opened:
        shown = opened.evaluate(rows, picked)
        factors = dict(opened.evaluate("[...vibrojax.grid.variables].map(([name, v]) => [name, v.factor])"))
    compared = 0
    for cell, numbers in zip(picked, shown, strict=True):
        assert len(numbers) > 5  # those without a value, and flags that say nothing, have no row
        for name, text in numbers:
            data = many[name].isel({dim: cell[dim] for dim in many[name].dims})
            value = data.values.item()
            if "flag_meanings" in data.attrs:
                meanings = dict(zip(data.attrs["flag_values"], data.attrs["flag_meanings"].split(), strict=True))
                assert text.replace("\u2011", "-") == meanings[value], (name, cell)
            elif not np.isfinite(value):
                assert text in ("no value", "∞") or text.startswith("∞"), (name, text)
            else:
                # The mean of an irregular motion has two digits.
                number = float(re.split(r"[\s,]", text.replace("\u2212", "-").removeprefix("≈ "))[0])
                rel = 0.06 if text[0] == "≈" else 5e-4
                assert number == pytest.approx(value * factors[name], rel=rel, abs=1e-300), (name, cell)
                compared += 1
    assert compared > 1_000


def test_click_selects_cell_and_hovering_shows_its_value(browser, files, many):
    with OpenPage(browser, files["many"], "#variable=impact_velocity&at.delta=0.005&at.start=1") as opened:
        frame = "({left: vibrojax.view.frame.box.left, top: vibrojax.view.frame.box.top})"
        corner = opened.evaluate(frame)
        size = opened.evaluate("(b => [b.right - b.left, b.bottom - b.top])(vibrojax.view.frame.box)")
        place = {"x": corner["left"] + size[0] * 4.5 / 16, "y": corner["top"] + size[1] * (1 - 11.5 / 17)}
        over = opened.page.locator(".vx-over")
        over.hover(position=place)
        tip = opened.page.locator(".vx-tip").inner_text()
        value = float(many["impact_velocity"].isel(beta=11, gamma=4, delta=1, start=1))
        assert f"{value:.4g}" in tip and "m/s" in tip and "γ = 0.56" in tip
        over.click(position=place)
        assert opened.cell == {"beta": 11, "gamma": 4, "delta": 1, "start": 1}
        assert "γ = 0.56" in opened.page.locator("h2").inner_text()
        figure = opened.page.locator("[data-slice='1']")
        figure.click(position={"x": figure.bounding_box()["width"] - 14, "y": 40})
        assert opened.cell["beta"] == 16


def test_keyboard_reaches_everything(browser, files):
    with OpenPage(browser, files["few"]) as opened:
        page = opened.page
        page.evaluate("document.activeElement.blur()")
        reached: dict[str, int] = {}
        named = "(e => e.dataset.control || e.className.split(' ')[0] || e.tagName)(document.activeElement)"
        for tab in range(60):
            page.keyboard.press("Tab")
            reached.setdefault(name := page.evaluate(named), tab)
            assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") != "none" or name == "BODY"
        controls = {"vx-theme", "variable", "x", "y", "at-start", "region", "vx-over", "returns", "vx-copy", "SUMMARY"}
        assert controls <= set(reached), reached
        page.locator(".vx-over").focus()
        opened.evaluate("vibrojax.pick({beta: 0, gamma: 0, start: 0})")
        for key, cell in (
            ("ArrowRight", {"beta": 0, "gamma": 1, "start": 0}),
            ("ArrowUp", {"beta": 1, "gamma": 1, "start": 0}),
            ("Shift+ArrowRight", {"beta": 1, "gamma": 2, "start": 0}),
            ("Home", {"beta": 1, "gamma": 0, "start": 0}),
            ("PageUp", {"beta": 2, "gamma": 0, "start": 0}),
            ("ArrowDown", {"beta": 1, "gamma": 0, "start": 0}),
            ("ArrowLeft", {"beta": 1, "gamma": 0, "start": 0}),
        ):
            page.keyboard.press(key)
            assert opened.cell == cell, key
        opened.settled()
        live = page.locator("[aria-live]").inner_text()
        assert "β = 0.4" in live and "γ = 0.6" in live and "regime" in live
        page.locator("[data-control='at-start']").focus()
        page.keyboard.press("ArrowDown")
        assert opened.cell["start"] == 1
        assert opened.heard == []


def test_link_restores_selection(browser, files):
    with OpenPage(browser, files["few"]) as opened:
        opened.page.get_by_label("Variable").select_option("impact_velocity")
        opened.page.locator("[data-control='x']").select_option("beta")
        opened.page.locator(".vx-over").press("ArrowRight")
        opened.page.locator("[data-control='at-start']").select_option("1")
        opened.page.get_by_label("source's region").uncheck()
        opened.page.locator(".vx-theme").click()
        opened.settled()
        before = opened.evaluate("[vibrojax.cell, vibrojax.shown, vibrojax.state]")
        link = opened.evaluate("location.hash")
    with OpenPage(browser, files["few"], link) as reopened:
        assert reopened.evaluate("[vibrojax.cell, vibrojax.shown, vibrojax.state]") == before
        assert reopened.page.locator("#vibrojax").get_attribute("data-scheme") == "dark"
        # The same window opens a link to another cell.
        reopened.evaluate("location.hash = '#variable=regime&at.beta=0.5&at.gamma=0.8&at.start=0'")
        wait_for(reopened.page, "vibrojax.shown.variable === 'regime' && vibrojax.cell.beta === 2")
        assert reopened.cell == {"beta": 2, "gamma": 2, "start": 0}


def test_command_of_cell_simulates_it(browser, files):
    with OpenPage(browser, files["few"], "#at.beta=0.4&at.gamma=0.7&at.start=1&zoom=0.65_0.85_0.35_0.55") as opened:
        assert opened.evaluate("vibrojax.map.zoom") == [[0.65, 0.85], [0.35, 0.55]]
        calls = opened.evaluate("vibrojax.calls()")
        period = opened.evaluate("vibrojax.grid.value('period', vibrojax.cell)")
    assert calls["command"] == "vibrojax simulate vibro-impact beta=0.4 gamma=0.7 start=stuck duration=48"
    call = calls["python"].replace(")", ", progress=False)")
    motion = eval(call, {"vj": vj})  # the call that the page offers to copy, unchanged
    assert float(motion["period"]) == pytest.approx(period, rel=1e-4)


SMALL_TARGETS = """() => [...document.querySelectorAll(".vibrojax :is(button, select, summary, input, .vx-why)")]
    .map(one => one.type === "checkbox" ? one.closest("label") : one)
    .filter(one => one.checkVisibility() && Math.min(one.offsetWidth, one.offsetHeight) < 40)
    .map(one => `${one.tagName} ${one.className} ${one.offsetWidth} x ${one.offsetHeight}`)"""


def test_phone_with_touch(browser, files):
    """The sheet leaves the map free, fingers reach every control, a tap reads values, and a zoom moves no plot. Where a
    pixel of the page is 1.5 of the screen, no colours but those of the regimes are between the cells."""
    phone: dict[str, Any] = {"width": 390, "is_mobile": True, "has_touch": True, "device_scale_factor": 1.5}
    with OpenPage(browser, files["few"], "#region=off", **phone) as opened:
        page, map_canvas = opened.page, opened.page.locator(".vx-over")
        wait_for(page, "vibrojax.element.style.getPropertyValue('--sheet') !== ''")
        place = "s => document.querySelector(s).getBoundingClientRect().toJSON()"
        assert opened.evaluate(place, ".vx-map")["bottom"] <= opened.evaluate(place, ".vx-sheet")["top"] < 640
        assert opened.evaluate(SMALL_TARGETS) == []
        assert opened.evaluate("document.scrollingElement.scrollWidth") <= 390
        assert opened.evaluate("(c => c.scrollWidth <= c.clientWidth)(document.querySelector('.vx-controls'))")
        shades = """(({ map, view: { frame: { box } } }) => {
            const sides = [box.left + 2, box.top + 2, box.right - box.left - 4, box.bottom - box.top - 4];
            const { data } = map.getContext("2d").getImageData(...sides.map((x) => 1.5 * x));
            return new Set(new Uint32Array(data.buffer)).size; })(vibrojax)"""
        assert opened.evaluate(shades) == opened.page.locator(".vx-legend li").count()

        at = opened.evaluate("[vibrojax.view.frame.x(0.7), vibrojax.view.frame.y(0.4)]")
        map_canvas.tap(position={"x": at[0], "y": at[1]})
        opened.settled()
        assert opened.cell["beta"] == opened.cell["gamma"] == 1
        assert "γ = 0.7" in page.locator(".vx-map > .vx-tip").inner_text()
        plane = page.locator(".vx-panel.vx-half canvas[role=img]").first
        at = plane.evaluate("c => { const r = c.readings[0]; return [c.frame.x(r.xs[9]), c.frame.y(r.ys[9])]; }")
        plane.tap(position={"x": at[0], "y": at[1]})
        assert re.search(r"x₁ \S+ mm", page.locator(".vx-panel.vx-half .vx-tip").first.inner_text())

        inside = """one => [one, one.closest(".vx-panel, .vx-map")].map(each => each.getBoundingClientRect())
            .map(({ top, height }, k, [{ top: first }]) => [top - first, height])"""
        for plot in (".vx-panel.vx-half", ".vx-map"):
            drawn = page.locator(f"{plot} canvas:not(.vx-moment)").first
            menu = page.locator(f"{plot} .vx-menu summary").first
            before, size = drawn.evaluate(inside), menu.bounding_box()
            assert min(size["width"], size["height"]) >= 44
            menu.tap()
            page.locator(plot).first.get_by_role("button", name="Zoom in").tap()
            assert page.locator(f"{plot} .vx-reset").first.is_visible() and drawn.evaluate("c => c.zoom") is not None
            assert drawn.evaluate(inside) == before
        assert opened.heard == []


def test_motion_is_played_compared_zoomed_and_saved(browser, files):
    """The cursor moves through the plots, pins compare numbers, files hold what is shown, and Back returns."""
    with OpenPage(browser, files["few"]) as opened:
        page = opened.page
        regime = "vibrojax.grid.valueText(vibrojax.variable, vibrojax.grid.value('regime', vibrojax.cell))"
        assert opened.evaluate(regime) == "single\u2011impact"
        opened.evaluate("vibrojax.player.to(0.05)")
        duration = opened.evaluate("vibrojax.player.motion.duration")
        assert page.get_by_label("Time of the cursor").input_value() == str(round(1000 * 0.05 / duration))
        page.get_by_role("button", name="Play").click()
        wait_for(page, "vibrojax.player.time > 0.052")
        page.get_by_role("button", name="Pause").click()
        assert not opened.evaluate("vibrojax.player.playing")
        before = opened.evaluate("vibrojax.player.time")
        box = page.locator(".vx-wide canvas").first.bounding_box()
        page.mouse.move(box["x"] + box["width"] * 0.3, box["y"] + 60)
        page.mouse.down()
        page.mouse.move(box["x"] + box["width"] * 0.4, box["y"] + 60, steps=4)
        page.mouse.up()
        assert opened.evaluate("vibrojax.player.time") != before  # scrubbed
        # Pins show the numbers of another cell, with their differences.
        opened.evaluate("vibrojax.pick({beta: 1, gamma: 1, start: 1})")
        opened.settled()
        page.locator(".vx-pinbutton").click()
        opened.evaluate("vibrojax.pick({beta: 1, gamma: 2, start: 1})")
        opened.settled()
        row = page.locator(".vx-numbers tr", has=page.locator("[data-name='impact_velocity']")).inner_text()
        velocity, cells = "c => vibrojax.grid.value('impact_velocity', c)", [{"beta": 1, "gamma": g} for g in (1, 2)]
        values = [opened.evaluate(velocity, cell | {"start": 1}) for cell in cells]
        numbers = [float(x.replace("\u2212", "-")) for x in re.findall(r"[+\u2212-]?\d+\.\d+", row)]
        assert numbers == pytest.approx([values[1], values[0], values[1] - values[0]], rel=5e-3)
        assert row.endswith(" m/s") and page.get_by_text("difference: this \u2212 pinned").is_visible()
        assert "pins=1.1.1" in opened.evaluate("location.hash") and page.get_by_text("Over the phase").is_visible()
        # Files.
        with page.expect_download() as saved:
            page.locator(".vx-map .vx-menu summary").click()
            page.locator(".vx-map .vx-menu button", has_text="CSV").click()
        lines = Path(saved.value.path()).read_text().splitlines()
        # All coordinates stand in the file; its name says the variable and the start.
        assert lines[0] == "beta,gamma,start,regime" and len(lines) == 10
        assert saved.value.suggested_filename == "regime_start=stuck.csv"
        contents = {}
        for kind in ("SVG", "PNG"):
            with page.expect_download() as saved:
                page.locator(".vx-map .vx-menu button", has_text=kind).click()
            contents[kind] = Path(saved.value.path()).read_bytes()
        assert contents["SVG"].startswith(b"<svg") and contents["PNG"].startswith(b"\x89PNG")
        texts = [str(text.text) for text in fromstring(contents["SVG"]).iter("{http://www.w3.org/2000/svg}text")]
        for word in ("ω₂/ω₁", "single-impact", "source's best region"):
            assert word in " ".join(texts), texts
        assert "start stuck" in " ".join(texts).replace("\u00a0", " "), texts
        with page.expect_download() as saved:
            page.get_by_role("button", name="JSON").click()
        cell = json.loads(Path(saved.value.path()).read_text())
        assert cell["coordinates"]["gamma"] == 0.8 and cell["numbers"]["impact_velocity"] == pytest.approx(values[1])
        # Zoom into a box, and reset.
        over = page.locator(".vx-over").bounding_box()
        page.mouse.move(over["x"] + 0.3 * over["width"], over["y"] + 0.3 * over["height"])
        page.mouse.down()
        page.mouse.move(over["x"] + 0.6 * over["width"], over["y"] + 0.6 * over["height"], steps=5)
        page.mouse.up()
        [low, high], _ = opened.evaluate("vibrojax.map.zoom")
        assert 0.6 < low < high < 0.8
        page.locator(".vx-map .vx-reset").click()
        assert opened.evaluate("vibrojax.map.zoom") is None
        assert opened.evaluate("vibrojax.cell") == {"beta": 1, "gamma": 2, "start": 1}
        # A regime is explained beside its name, and in the legend on focus.
        assert "The motion repeats after one return" in page.locator(".vx-meaning").inner_text()
        page.locator(".vx-legend .vx-why").first.focus()
        assert page.locator(".vx-legend .vx-sentence").first.is_visible()
        page.wait_for_timeout(800)
        page.locator(".vx-over").press("ArrowLeft")
        opened.settled()
        page.go_back()
        wait_for(page, "vibrojax.cell.gamma === 2")
        assert opened.heard == []


def test_reduced_motion_steps_and_axe_finds_nothing_serious(browser, files):
    """With reduced motion the machine steps, and an independent checker finds no barrier in any view."""
    axe = pytest.importorskip("axe_playwright_python", reason='axe is missing: pip install ".[browser]"')
    script = (Path(axe.__file__).parent / "axe.min.js").read_text(encoding="utf-8")
    for width, scheme in ((1280, "light"), (390, "dark")):
        with OpenPage(browser, files["few"], width=width, scheme=scheme) as opened:
            opened.page.emulate_media(reduced_motion="reduce")
            wait_for(opened.page, "document.querySelector('.vx-play').textContent === 'Step'")
            opened.page.locator(".vx-play").click()
            assert opened.evaluate("vibrojax.player.time > 0 && !vibrojax.player.playing")
            opened.evaluate("vibrojax.pins.toggle()")
            opened.evaluate(script)
            found = opened.evaluate("axe.run(document, {resultTypes: ['violations']})")["violations"]
            serious = [violation for violation in found if violation["impact"] in ("serious", "critical")]
            assert [(violation["id"], violation["nodes"][0]["html"]) for violation in serious] == []
            if width == 390:  # the sheet shows the motion without scrolling
                assert opened.page.locator(".vx-panels canvas[role=img]").first.bounding_box()["y"] < 900


def _open(browser, ds: xr.Dataset, path: Path, fragment: str = "", scheme: str = "light") -> OpenPage:
    path.write_text(page_text(contents_of(ds).document), encoding="utf-8")
    return OpenPage(browser, path, fragment, scheme=scheme)


def test_legend_of_family_lists_what_occurs_in_visible_colours(browser, tmp_path):
    family = vj.follow("rotary", along="v", at=1.0, span=(0.9, 1.1), progress=False)
    kinds = {family["special_kind"].attrs["flag_meanings"].split()[k] for k in family["special_kind"].values}
    runs = {"stable" if flag == 1 else "not stable" for flag in family["stable"].values}
    with _open(browser, family, tmp_path / "family.html", scheme="dark") as opened:
        items = opened.page.locator(".vx-legend li")
        assert {text.strip() for text in items.all_inner_texts()} == runs | kinds
        # Each sign is drawn, and seen on the dark ground.
        drawn = """[...document.querySelectorAll('.vx-legend .vx-sign')].map(one => {
            const { data } = one.getContext("2d").getImageData(0, 0, one.width, one.height);
            return data.reduce((most, x, k) => Math.max(most, data[k | 3] ? x : 0), 0);
        })"""
        brightest = opened.evaluate(drawn)
        assert len(brightest) == len(runs | kinds) and min(brightest) > 120
        plot = opened.page.locator(".vx-plots canvas[role=img]").first
        chosen = "vibrojax.plots.find(one => one.canvas === c)"
        zoom = f"(c, x) => {{ {chosen}.tools.set([x, [-1e3, 1e3]]); return c.frame.xTicks; }}"
        ticks = [text for _, text in plot.evaluate(zoom, [1.0, 1.000001])]
        assert len(set(ticks)) == len(ticks) > 2
        plot.evaluate(zoom, [0.95, 1.05])
        link = opened.evaluate("location.hash")
    with OpenPage(browser, tmp_path / "family.html", link) as reopened:
        plot = reopened.page.locator(".vx-plots canvas[role=img]").first
        assert plot.evaluate("c => c.zoom") == [[0.95, 1.05], [-1000, 1000]]
        plot.press("ArrowRight")  # reads the first value that is seen, not one beside the zoom
        read = reopened.page.locator(".vx-figure .vx-tip").first.inner_text().split()[-2]
        assert 0.95 <= float(read) <= 1.05
        readings = "[...document.querySelectorAll('.vx-plots canvas')].flatMap(c => c.readings ?? [])"
        values = reopened.evaluate(f"{readings}.flatMap(one => one.texts ?? [])")
        assert {"0.9", "1.1"} <= set(values)  # multipliers are read with their parameter


def test_tracks_of_rig_log_choose_rows(browser, tmp_path):
    """A log has no map: its plots choose a row, by pointer and by keys; its numbers have the units of the tracks."""
    depth = np.linspace(1500.0, 1510.0, 41)
    log = {"Depth (m)": depth, "WOB (kN)": 100.0 + depth % 7, "RPM (rpm)": 120.0 + depth % 3}
    ds = vj.rig(pd.DataFrame(log | {"ROP (m/h)": 20.0 + depth % 5}), columns={"bit_diameter": "8.5 in"})
    with _open(browser, ds, tmp_path / "rig.html") as opened:
        title, numbers = opened.page.locator(".vx-cellhead h2"), opened.page.locator("[data-name=rate_of_penetration]")
        assert not opened.page.locator(".vx-map").is_visible() and "depth = 1505 m" in title.inner_text()
        assert numbers.inner_text() == "20 m/h"
        track = opened.page.locator(".vx-tracks canvas[role=img]").nth(1)
        x, y = track.evaluate("c => [(c.frame.box.left + c.frame.box.right) / 2, c.frame.y(1502.25)]")
        track.click(position={"x": x, "y": y})
        tracks = opened.page.locator(".vx-tracks canvas[role=img]")
        assert min(tracks.evaluate_all("all => all.map(c => c.frame.xTicks.length)")) >= 3
        assert "depth = 1502.3 m" in title.inner_text() and numbers.inner_text() == "22.25 m/h"
        cloud = opened.page.locator(".vx-plots canvas[role=img]").first
        for key in ("ArrowRight", "End", "Enter"):
            cloud.press(key)
        assert "depth = 1510 m" in title.inner_text()


def test_areas_are_read_where_they_are_pointed_at_and_attractors_have_names(browser, tmp_path):
    """Of two attractors the second has 30 % of the starts at the first point; its regime stands beside its number."""
    over = ("gamma", "attractor")
    shares = {"share": (over, [[0.7, 0.3], [1.0, 0.0]]), "share_stderr": (over, np.full((2, 2), 0.05))}
    shares |= {"regime": (over, [[3, 6], [3, 6]]), "unassigned": ("gamma", [0, 0])}
    shares |= {"lane_attractor": (("gamma", "start"), [[0, 0, 1], [0, 0, 0]])}
    speeds = {"gamma": ("gamma", [0.6, 0.7], {"symbol": "v_cr"})}
    ds = xr.Dataset(shares, speeds, {"kind": "attractors", "scene": "vibro-impact"})
    with _open(browser, ds, tmp_path / "shares.html") as opened:
        flags = opened.evaluate("vibrojax.grid.variables.get('lane_attractor').flags")
        assert flags == {"0": "attractor 0, single-impact", "1": "attractor 1, irregular"}
        plot = opened.page.locator(".vx-plots canvas[role=img]").first
        x, y = plot.evaluate("c => [c.frame.x(0.61), c.frame.y(85)]")
        plot.hover(position={"x": x, "y": y})
        tip = opened.page.locator(".vx-plots .vx-tip")
        assert re.match(r"1: irregular.*: 30 %\nvcr 0.6$", tip.inner_text()) and tip.locator("sub").inner_text() == "cr"


def test_followed_orbits_are_within_the_diagram_of_returns(browser, tmp_path):
    run = {"settle": 2.0, "observe": 3.0, "keep_returns": 4}
    ds = vj.run_sweep({"scene": "vibro-impact", "grid": {"gamma": [0.6, 0.7]}, "run": run}, progress=False)
    document = contents_of(ds).document
    line = {"kind": "line", "x": [0.6, 0.7], "y": [50.0, 60.0], "colour": "#222222", "width": 1.0, "dash": [3.0, 1.0]}
    document["overlay"] = {"variable": document["variables"][0]["name"], "along": "gamma", "items": [line]}
    (tmp_path / "over.html").write_text(page_text(document), encoding="utf-8")
    with OpenPage(browser, tmp_path / "over.html") as opened:
        assert opened.evaluate("vibrojax.view.frame.yAxis.limits[1]") > 60
        assert "followed orbits, not stable" in opened.page.locator(".vx-legend").inner_text()
