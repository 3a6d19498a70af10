"""Tests of `explore --live` and of the widget: output, the page in a browser, and selections that Python follows."""

import base64
import json
import os
import re
import signal
import socket
import urllib.request
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlparse
from urllib.request import url2pathname

import numpy as np
import pytest
from browser import new_page, wrong
from cell_blocks import decode
from commands import end_of, start, wait_for
from refusals import command_refusal, refusal
from small_map import small_map

import vibrojax as vj
from vibrojax.errors import InputError
from vibrojax.explorer.live import serve


@pytest.fixture(scope="module")
def dataset():
    return small_map()


def test_contradictory_options_are_refused(dataset, tmp_path, capsys):
    vj.write_dataset(dataset, tmp_path / "small.nc")
    for words, line in (
        (["--live", "-o", "page.html"], "-o: --live writes no page"),
        (["beta=0.4", "--live"], '"beta=0.4": values are for a scene, with --live; leave them out'),
        (["--no-browser"], "--no-browser: there is no browser to open without --live"),
    ):
        assert line in command_refusal(capsys, "explore", tmp_path / "small.nc", *words)


@pytest.mark.skipif(os.name != "posix", reason="modes of files and signals")
def test_command_serves_until_interrupted_and_browser_arguments_hold_no_token(tmp_path):
    """All users see the arguments of a browser. A private file, which is deleted at the end, leads it to the page."""
    rock = {"grid": {"force": [2e5, 3e5], "k3": [2e8, 3e8]}, "run": {"settle": 0.2, "observe": 0.2}}
    file = tmp_path / "rock.nc"
    vj.write_dataset(vj.run_sweep({"scene": "penetration"} | rock, progress=False), file)
    browser, seen, folder = tmp_path / "browser", tmp_path / "seen", tmp_path / "temporary"
    browser.write_text(f'#!/bin/sh\nprintf "%s" "$*" > {seen}.part\nmv {seen}.part {seen}\n')
    browser.chmod(0o700)
    folder.mkdir()
    environment = {"BROWSER": f"{browser} %s", "DISPLAY": ":0", "TMPDIR": str(folder)}
    process = start("explore", file, "--live", environment=environment)
    try:
        url = process.stdout.readline().strip()
        wait_for(seen.exists, process)
        redirect = Path(url2pathname(urlparse(seen.read_text()).path))
        assert urlparse(url).path.strip("/") not in seen.read_text() and redirect.is_relative_to(folder)
        assert [path.stat().st_mode & 0o777 for path in (redirect, redirect.parent)] == [0o600, 0o700]
        assert re.findall(r'content="0; url=([^"]*)"', redirect.read_text()) == [url]
        assert "<title>" in urllib.request.urlopen(url, timeout=100).read().decode()
        process.send_signal(signal.SIGINT)
        status, errors = end_of(process)
    finally:
        process.kill()
    last = errors.splitlines()[-1]
    assert status == 130 and "Traceback" not in errors
    assert last.startswith("vibrojax: interrupted") and last.endswith(f"explore {file} --live")
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.1", urlparse(url).port), 1).close()
    assert not redirect.parent.exists()


@contextmanager
def browser_page(browser, url):
    """Open a page; check that its console has no error and that it requests nothing from elsewhere."""
    page, messages, requests = new_page(browser, url, viewport={"width": 1280, "height": 900})
    yield page
    page.context.close()
    # A browser logs refused values as errors, whatever the page does with the answer.
    assert not [line for line in wrong(messages) if "400 (Bad Request)" not in line]
    assert all(request.startswith((url, "data:")) for request in requests)


PICTURE = "() => document.querySelector('.vx-panels canvas[role=img]').toDataURL()"


def numbers(page):
    cells = page.locator(".vx-numbers td").evaluate_all("all => all.map(one => [one.dataset.name, one.dataset.value])")
    return {name: float(value) for name, value in cells if value not in ("", "NaN")}


def test_dragging_slider_changes_motion(dataset, browser):
    """The phase plane changes; the numbers and the command line to copy are those of `simulate`."""
    with serve(dataset) as live, browser_page(browser, live.url) as page:
        before = page.evaluate(PICTURE)
        slider = page.locator("input[data-parameter=delta]")
        box = slider.bounding_box()
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.mouse.down()
        for share in (0.55, 0.6, 0.65, 0.7):
            page.mouse.move(box["x"] + share * box["width"], box["y"] + box["height"] / 2)
        page.mouse.up()
        page.locator(".vx-said", has_text="simulated in").wait_for()
        page.locator("h2", has_text="With Δ = ").wait_for()
        value = 1e-3 * float(page.locator("input[name=delta]").input_value())
        assert 0.005 < value < 0.012
        # The page may show motions of intermediate positions before the last one.
        page.locator(".vx-call code", has_text=re.compile(rf"delta={value:g}\b")).first.wait_for()
        assert page.evaluate(PICTURE) != before
        code = page.locator(".vx-call code").all_text_contents()
        assert "vibrojax simulate vibro-impact" in code[0] and f"delta={value:g}" in code[0]
        [motion] = [eval(code[1].replace("vj.simulate(", "vj.simulate(progress=False, scene="), {"vj": vj})]
        shown = numbers(page)
        for name in ("regime", "period", "stick_fraction", "bit_amplitude"):
            assert shown[name] == pytest.approx(motion[name].item(), rel=1e-6), name
        page.locator("button", has_text="back to the cell").click()
        page.locator("h2", has_text="β = 0.35").wait_for()
        assert page.locator("input[name=delta]").input_value() == "-5"


def test_stopped_server_is_reported(dataset, browser):
    """A line beside the sliders reports it, and the page keeps what it shows."""
    with serve(dataset) as live:
        page, _, _ = new_page(browser, live.url)
        live.close()
        page.locator("input[data-parameter=v]").press("ArrowLeft")
        page.locator(".vx-wrong", has_text="the server does not answer; it may have been stopped").wait_for()


def test_badge_and_text_of_cell_agree(dataset, tmp_path, browser):
    """Badge and text follow the dataset, also where the motion that is simulated for the page does not."""
    changed = dataset.copy(deep=True)
    for name, value in (("regime", 6), ("cycles", 0)):
        changed[name][...] = value
    path = vj.write_page(changed, tmp_path / "page.html", progress=False)
    with serve(changed) as live:
        for url in (live.url, path.as_uri()):
            with browser_page(browser, url) as page:
                text = page.locator(".vx-motion", has_text="does not repeat;").first
                text.wait_for()
                assert page.locator(".vx-badge").inner_text() == "irregular"
                assert text.inner_text().startswith("does not repeat; simulated anew it ends in another motion")


@pytest.fixture
def widget(dataset):
    return vj.explore(dataset)


@pytest.fixture
def sent(widget):
    """Return the messages that the widget sends to the page."""
    messages = []
    widget.send = lambda content, buffers=None: messages.append((content, buffers))
    return messages


def test_python_selects_nearest_cell(widget, dataset):
    seen = []
    widget.set_state({"cell": {"beta": 2, "gamma": 1, "start": 1}})  # as the page sends it
    assert widget.lane.identical(dataset.isel(beta=2, gamma=1, start=1))
    widget.observe(lambda change: seen.append(change["new"]), "cell")
    widget.point = {"beta": 0.31, "gamma": 0.79, "start": "stuck"}
    assert widget.cell == {"beta": 0, "gamma": 3, "start": 1} and seen == [widget.cell]
    assert widget.point == {"beta": 0.3, "gamma": 0.8, "start": "stuck"}
    widget.point = {"gamma": np.float64(0.0)}  # the other axes keep their values
    assert widget.cell == {"beta": 0, "gamma": 0, "start": 1}
    widget.cell = {"beta": 99}
    assert widget.point == {"beta": 0.4, "gamma": 0.65, "start": "stuck"}
    before = widget.point
    with pytest.raises(InputError, match=r'explore: point\.bta: the map has no such axis; did you mean "beta"\?'):
        widget.point = {"bta": 0.3}
    with pytest.raises(InputError, match=r'point\.start: "nowhere" is not one of its values; choose from drive, stuck'):
        widget.point = {"start": "nowhere"}
    with pytest.raises(InputError, match="a cell has an index for each of beta, gamma, start"):
        widget.cell = {"nowhere": 1}
    assert widget.point == before


def test_kernel_computes_requested_motions(widget, sent, dataset):
    widget._handle_custom_msg({"id": "a", "parameters": {"beta": 0.37}, "start": "stuck"}, [])
    motion = vj.simulate("vibro-impact", beta=0.37, gamma=0.65, start="stuck", duration=10.0, progress=False)
    [(content, [block])] = sent
    [cell] = decode(block)
    assert content == {"id": "a"} and cell.numbers["period"] == motion["period"].item()
    assert widget.simulated == {"parameters": {"beta": 0.37}, "start": "stuck"}
    widget._handle_custom_msg({"id": "b", "lane": 3}, [])
    [cell] = decode(sent[1][1][0])
    assert cell.lane == 3 and widget.simulated == {}
    sent.clear()
    widget._handle_custom_msg({"id": "a", "parameters": {"beta": -1}}, [])
    assert sent == [({"id": "a", "error": "explore: beta: is -1; it must be above 0"}, None)]
    for nonsense in ({}, {"parameters": {}}, "x", None, 3):
        widget._handle_custom_msg(nonsense, [])
    assert len(sent) == 1


def test_trajectory_and_plane_of_starts():
    motion = vj.simulate("rotary", duration=2.0, v=0.7, progress=False)
    widget = vj.explore(motion)
    assert widget.offered["values"]["v"] == 0.7 and len(widget.blocks) == 1
    x2 = {"start": -0.02, "stop": 0.02, "num": 3}
    starts = {"plane": {"x2": x2, "v2": {"start": -1.0, "stop": 1.0, "num": 2}}}
    run = {"settle": 1.0, "observe": 1.0}
    plane = vj.run_sweep({"scene": "vibro-impact", "starts": starts, "run": run}, progress=False)
    widget = vj.explore(plane)
    widget.point = {"start_x2": 0.019, "start_v2": -0.6}
    assert widget.point == {"start_x2": 0.02, "start_v2": -1.0} and widget.lane["regime"].ndim == 0


def test_unknown_scene_is_shown_but_not_simulated(dataset):
    foreign = dataset.drop_attrs().assign_attrs(scene="mine")
    assert vj.explore(foreign).offered is None
    assert "explore: " in refusal(vj.explore, foreign, live=True)


HOST = """
<!doctype html><div id="here"></div><script type="module">
const text = await getModule(), blob = new Blob([text], { type: "text/javascript" });
const module = await import(URL.createObjectURL(blob));
const state = JSON.parse(await getState()), heard = new Map();
window.tell = (name, ...rest) => (heard.get(name) ?? []).forEach((one) => one(...rest));
window.answer = (content, base64) => {
  const bytes = base64 ? [new DataView(Uint8Array.from(atob(base64), (one) => one.charCodeAt(0)).buffer)] : [];
  tell("msg:custom", content, bytes);
};
window.model = {
  get: (name) => state[name],
  set: (name, value) => { state[name] = value; },
  save_changes: () => saved(JSON.stringify(state.cell)),
  on: (name, one) => heard.set(name, [...(heard.get(name) ?? []), one]),
  off: (name, one) => heard.set(name, (heard.get(name) ?? []).filter((other) => other !== one)),
  send: (content) => asked(JSON.stringify(content)),
};
window.cleanup = await module.default.render({ model, el: document.getElementById("here") });
</script>
"""


def test_module_in_browser(widget, sent, browser):
    """In a stand-in for a notebook, clicks set the cell, cells from Python are shown, and sliders request motions."""
    page, messages, requests = new_page(browser, viewport={"width": 1000, "height": 900})

    def answer_request(text):
        widget._handle_custom_msg(json.loads(text), [])
        content, buffers = sent.pop()
        block = base64.b64encode(buffers[0]).decode() if buffers else None
        page.evaluate("([content, block]) => setTimeout(() => answer(content, block))", [content, block])

    page.expose_function("getModule", lambda: widget._esm)
    page.expose_function("getState", lambda: json.dumps(widget.get_state(), default=str))
    page.expose_function("saved", lambda cell: widget.set_state({"cell": json.loads(cell)}))
    page.expose_function("asked", answer_request)
    widget.point = {"beta": 0.3, "gamma": 0.8, "start": "stuck"}
    page.set_content(HOST)
    page.locator("h2", has_text="β = 0.3, γ = 0.8, start stuck").wait_for()
    page.locator(".vx-panels canvas[role=img]").first.wait_for()
    page.locator(".vx-over").press("ArrowLeft")
    page.locator("h2", has_text="γ = 0.75").wait_for()
    assert widget.point == {"beta": 0.3, "gamma": 0.75, "start": "stuck"}
    widget.point = {"beta": 0.4, "gamma": 0.65, "start": "drive"}
    page.evaluate("(cell) => { model.set('cell', cell); tell('change:cell'); }", widget.cell)
    page.locator("h2", has_text="β = 0.4, γ = 0.65").wait_for()
    page.locator("input[name=v]").fill("1.1")
    page.locator("h2", has_text="With v = 1.1").wait_for()
    assert widget.simulated["parameters"]["v"] == 1.1 and widget.simulated["parameters"]["beta"] == 0.4
    page.evaluate("() => cleanup()")
    assert page.locator(".vx-map").count() == 0
    assert not wrong(messages)
    assert all(url.startswith(("blob:", "about:", "data:")) for url in requests)
