"""Tests of the widget: selections in the page and in Python follow each other, and the kernel computes motions."""

import json

import numpy as np
import pytest
from browser import chromium, new_page, wrong
from cell_blocks import decode
from small_map import small_map

import vibrojax as vj
from vibrojax.errors import InputError


@pytest.fixture(scope="module")
def dataset():
    return small_map()


@pytest.fixture
def widget(dataset):
    return vj.explore(dataset)


@pytest.fixture
def sent(widget):
    """Return the messages that the widget sends to the page."""
    messages = []
    widget.send = lambda content, buffers=None: messages.append((content, buffers))
    return messages


def test_cell_selected_in_page_is_known_to_python(widget, dataset):
    seen = []
    widget.observe(lambda change: seen.append(change["new"]), "point")
    widget.set_state({"cell": {"beta": 2, "gamma": 1, "start": 1}})  # as the page sends it
    assert widget.point == {"beta": 0.4, "gamma": 0.7, "start": "stuck"} and seen == [widget.point]
    assert widget.cell == {"beta": 2, "gamma": 1, "start": 1}
    assert widget.lane.identical(dataset.isel(beta=2, gamma=1, start=1))


def test_python_selects_nearest_cell(widget):
    seen = []
    widget.observe(lambda change: seen.append(change["new"]), "cell")
    widget.point = {"beta": 0.31, "gamma": 0.79, "start": "stuck"}
    assert widget.cell == {"beta": 0, "gamma": 3, "start": 1} and seen == [widget.cell]
    assert widget.point == {"beta": 0.3, "gamma": 0.8, "start": "stuck"}
    widget.point = {"gamma": np.float64(0.0)}  # the other axes keep their values
    assert widget.cell == {"beta": 0, "gamma": 0, "start": 1}
    widget.cell = {"beta": 99}
    assert widget.point == {"beta": 0.4, "gamma": 0.65, "start": "stuck"}


def test_wrong_points_are_refused(widget):
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


def test_failed_computations_are_reported(widget, sent):
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
    with pytest.raises(InputError, match="explore: "):
        vj.explore(foreign, live=True)


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


def test_module_in_browser(widget, sent):
    """In a stand-in for a notebook, clicks set the cell, cells from Python are shown, and sliders request motions."""
    import base64

    with chromium() as browser:
        page, messages, requests = new_page(browser, viewport={"width": 1000, "height": 900})

        def answer_request(text):
            widget._handle_custom_msg(json.loads(text), [])
            content, buffers = sent.pop()
            page.evaluate(
                "([content, block]) => setTimeout(() => answer(content, block))",
                [content, base64.b64encode(buffers[0]).decode() if buffers else None],
            )

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
