"""Browser tests of pages of untrusted datasets: only the page's script runs, and the calls to copy are harmless."""

import ast
import json
import shlex
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
import xarray as xr
from browser import chromium, new_page, wrong
from hostile import CODE, HUGE, MARKUP, STEERING, attribute, each_variable
from small_map import small_map

import vibrojax as vj
from vibrojax.explorer import contents_of, page_text
from vibrojax.explorer.document import run_document
from vibrojax.explorer.write import content_policy
from vibrojax.io.kinds import SPECIAL_KINDS
from vibrojax.scenes.vibro_impact import VibroImpact

NAMES = (
    "__proto__",
    "constructor",
    "toString",
    "v\nx",
    "v x",
    "v=1",
    CODE,
    "vе",
    "v\u202e",
    "v;x",
    "$(x)",
    "'",
    '"',
    "`",
)
WORDS = (
    "$(touch hacked)",
    "`touch hacked`",
    "'; touch hacked; '",
    '"), __import__("os"), ("',
    "stuck\nx",
    "ѕtuck",
    MARKUP,
)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as instance:
        yield instance


def open_page(browser: Any, text: str, folder: Path, fragment: str = "", width: int = 1280) -> tuple[Any, Any, Any]:
    """Return the page of this text in the browser, its console messages and its requests."""
    path = folder / "page.html"
    path.write_text(text, encoding="utf-8")
    page, messages, requests = new_page(browser, viewport={"width": width, "height": 900})
    page.goto(path.as_uri() + fragment)
    page.wait_for_selector("[data-ready]")
    return page, messages, requests


def check_calls(calls: dict[str, str]) -> dict[str, object]:
    """Check that a Python call is plain and a command line is made of words; return the call's arguments."""
    tree = ast.parse(calls["python"], mode="eval").body
    assert isinstance(tree, ast.Call) and ast.unparse(tree.func) == "vj.simulate"
    assert [type(node) for node in tree.args] == [ast.Constant]
    arguments = {str(keyword.arg): ast.literal_eval(keyword.value) for keyword in tree.keywords}
    assert None not in [keyword.arg for keyword in tree.keywords]  # no **
    known = {*VibroImpact().parameters(), "start", "duration", "friction"}
    assert set(arguments) <= known, arguments
    words = shlex.split(calls["command"])
    assert words[:3] == ["vibrojax", "simulate", "vibro-impact"]
    assert [word.partition("=")[0] for word in words[3:]] == list(arguments)
    assert not set(calls["command"].replace("'", "")) & set('$`;&|<>\\\n"(){}*?!#~')
    return arguments


def hostile_runs() -> list[dict[str, Any]]:
    """Return values that a page would hold as its `run` if Python checked nothing."""
    plain = run_document(small_map())
    runs = [plain | {"parameters": {name: 1.0}} for name in NAMES]
    runs += [plain | {"parameters": {"v": word}} for word in WORDS]
    runs += [plain | {"parameters": {"v": None}}, plain | {"parameters": {"v": {"toString": 1}}}]
    runs += [plain | {"start": word} for word in WORDS] + [plain | {"start": [0, word, 0, 0]} for word in WORDS]
    runs += [plain | {"options": {"friction": word}} for word in WORDS] + [plain | {"options": {CODE: "coulomb"}}]
    runs += [plain | {"names": [*plain["names"], CODE], "parameters": {CODE: 1.0}}]
    runs += [plain | {"starts": [word, "stuck"], "start": word} for word in WORDS]
    return runs


def test_calls_of_hostile_documents_are_plain(browser: Any, tmp_path: Path) -> None:
    """The page repeats the checks that Python makes."""
    document = contents_of(small_map()).document
    page, messages, _ = open_page(browser, page_text(document), tmp_path)
    call = """([runs, own]) => runs.map((run) => {
        Object.assign(vibrojax.data, { run });
        vibrojax.coordinates = () => own;
        return vibrojax.calls();
    })"""
    runs = hostile_runs()
    own: dict[str, object] = {"beta": 0.4, "gamma": 0.7, "start": "stuck"}
    for calls in page.evaluate(call, [runs, own]):
        arguments = check_calls(calls)
        assert arguments["beta"] == 0.4 and arguments["start"] == "stuck"
    for word in (*WORDS, *NAMES):
        [calls] = page.evaluate(call, [[run_document(small_map())], own | {"start": word, "rock": word, word: 1.0}])
        assert "start" not in check_calls(calls)
    scenes = [run_document(small_map()) | {"scene": word} for word in WORDS]
    assert page.evaluate(call, [scenes, own]) == [None] * len(scenes)
    assert not messages


@pytest.mark.parametrize("name", NAMES)
def test_run_holds_only_names_of_the_scene(name: str) -> None:
    about = [{"name": name, "symbol": "", "units": "1", "value": 1.0, "default": 0.0}]
    ds = small_map().assign_attrs(differing=json.dumps(about))
    try:
        parameters = run_document(ds)["parameters"]
    except vj.InputError as error:
        assert "attribute differing[0]: name" in str(error)
    else:
        assert parameters == {}


@pytest.mark.parametrize("word", WORDS)
def test_run_holds_only_words_of_the_scene(word: str) -> None:
    assert run_document(small_map().assign_attrs(start=word))["start"] is None
    assert run_document(small_map().assign_attrs(friction=word)) == {"own_scene": True}
    assert run_document(small_map().assign_attrs(scene=word)) == {"own_scene": True}
    vector = run_document(small_map().assign_attrs(start="[0.0, -1.5, 0.0, 0.0]"))["start"]
    assert vector == (0.0, -1.5, 0.0, 0.0)


def hostile_map() -> xr.Dataset:
    """Return a map whose texts are markup, including those of the starts."""
    ds = each_variable(long_name=MARKUP, units=MARKUP, symbol=MARKUP)(small_map())
    ds = attribute("title", f"{MARKUP} {STEERING} {HUGE}")(ds)
    ds = ds.assign_coords(start=[f"$(x){MARKUP}", f'"), x, ("{MARKUP}'])
    ds["regime"].attrs["flag_meanings"] = " ".join(
        f"<img/src=x/onerror=window.hacked={k}>" for k in range(len(ds["regime"].attrs["flag_values"]))
    )
    return ds


@pytest.mark.parametrize("width", [1280, 390])
def test_hostile_dataset_runs_no_code(browser: Any, tmp_path: Path, width: int) -> None:
    text = page_text(contents_of(hostile_map()).document)
    assert len(text) < 500_000
    page, messages, requests = open_page(browser, text, tmp_path, width=width)
    for variable in ("regime", "period", "stick_fraction"):
        page.get_by_label("Variable").select_option(variable)
        page.locator(".vx-over").press("ArrowRight")
    assert page.evaluate("[window.hacked, document.images.length, document.scripts.length]") == [None, 0, 3]
    assert page.evaluate("document.scrollingElement.scrollWidth") <= width
    assert len(page.locator("h1").inner_text()) <= 200
    arguments = check_calls(page.evaluate("vibrojax.calls()"))
    assert "start" not in arguments and {"beta", "gamma"} <= set(arguments)
    assert len(requests) == 1 and not messages


def test_page_policy_blocks_injected_code(browser: Any, tmp_path: Path) -> None:
    """Injected code can neither run, nor load, nor send anything."""
    page, messages, _ = open_page(browser, page_text(contents_of(small_map()).document), tmp_path)
    policy = page.locator("meta[http-equiv]").get_attribute("content")
    assert "unsafe" not in policy and "default-src 'none'" in policy and "connect-src 'none'" in policy
    assert not messages
    with counting_server() as (address, hits):
        page.evaluate(ATTEMPTS, address)
    assert page.evaluate("window.hacked") is None
    assert hits == []
    assert len([text for text in wrong(messages) if "Content Security Policy" in text or "violates" in text]) >= 6


ATTEMPTS = """async (address) => {
    const add = (tag, given) => document.body.append(Object.assign(document.createElement(tag), given));
    add("script", { textContent: "window.hacked = 1" });
    add("script", { src: `${address}/x.js` });
    add("img", { src: `${address}/x.png` });
    add("iframe", { src: `${address}/` });
    add("style", { textContent: `body { background: url(${address}/x) }` });
    add("base", { href: `${address}/` });
    document.body.insertAdjacentHTML("beforeend", "<p onclick='window.hacked = 2' id='p'>x</p>");
    document.getElementById("p").click();
    await fetch(`${address}/x`).catch(() => 0);
    navigator.sendBeacon(`${address}/x`, "x");
}"""
"""Script that tries each way in which injected code could run, load or send."""


@contextmanager
def counting_server() -> Iterator[tuple[str, list[str]]]:
    """Serve on this machine; yield the address and the paths of the requests."""
    hits: list[str] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            hits.append(self.path)
            self.send_response(204)
            self.end_headers()

        do_POST = do_GET

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}", hits
        server.shutdown()
        thread.join()


def test_policy_allows_only_content_of_the_page() -> None:
    policy = content_policy(["a()"], [])
    assert "script-src 'sha256-" in policy and "style-src 'none'" in policy and "connect-src 'none'" in policy
    assert "connect-src 'self'" in content_policy([], [], asks=True) and "unsafe" not in policy


def curves_over(change: dict[str, Any]) -> xr.Dataset:
    """Return two curves over the small map, with changed variables."""
    kinds = {"flag_meanings": " ".join(SPECIAL_KINDS), "flag_values": range(len(SPECIAL_KINDS))}
    about = {"kind": "curves", "source": "vibrojax 0", "scene": "vibro-impact", "axes": ["gamma", "beta"]}
    about |= {name: small_map().attrs[name] for name in ("friction",) if name in small_map().attrs}
    variables: dict[str, Any] = {
        "point_curve": ("point", [0, 0, 1, 1]),
        "gamma": ("point", [0.66, 0.7, 0.7, 0.79]),
        "beta": ("point", [0.3, 0.35, 0.35, 0.3]),
        "period": ("point", [1.0] * 4),
        "cycles": ("point", [1] * 4),
        "multiplier_abs": (("point", "multiplier"), [[1.0]] * 4),
        "kind": ("curve", [0, 3], kinds),
        "special": ("curve", [0, 1]),
        "curve_note": ("curve", [MARKUP, MARKUP]),
        "codim2_kind": ("codim2", [MARKUP]),
        "codim2_curve": ("codim2", [0]),
        "codim2_gamma": ("codim2", [0.7]),
        "codim2_beta": ("codim2", [0.35]),
    }
    return xr.Dataset(variables | change, attrs=about)


@pytest.mark.parametrize(
    ("change", "says"), [({"gamma": ("point", [0.66, float("nan"), 0.7, 0.79])}, "variable gamma is not finite")]
)
def test_hostile_curves_are_refused(change: dict[str, Any], says: str) -> None:
    with pytest.raises(vj.InputError, match=says):
        contents_of(small_map(), curves_over(change))
