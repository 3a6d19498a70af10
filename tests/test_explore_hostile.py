"""Browser tests of pages of untrusted datasets: only the page's script runs, and the calls to copy are harmless."""

import ast
import json
import shlex
from collections.abc import Iterator
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
from vibrojax.scenes.vibro_impact import VibroImpact

NAMES = ("__proto__", "toString", "v\nx", "v=1", CODE, "vе", "v\u202e", "$(x)", "'", '"')
WORDS = ("$(touch hacked)", "'; touch hacked; '", '"), __import__("os"), ("', "stuck\nx", "ѕtuck", MARKUP)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as instance:
        yield instance


def open_page(browser: Any, text: str, folder: Path, width: int = 1280) -> tuple[Any, Any, Any]:
    """Return the page of this text in the browser, its console messages and its requests."""
    path = folder / "page.html"
    path.write_text(text, encoding="utf-8")
    page, messages, requests = new_page(browser, viewport={"width": width, "height": 900})
    page.goto(path.as_uri())
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


def hostile_map() -> xr.Dataset:
    """Return a map whose texts are markup, including those of the starts."""
    ds = each_variable(long_name=MARKUP, units=MARKUP, symbol=MARKUP)(small_map())
    ds = attribute("title", f"{MARKUP} {STEERING} {HUGE}")(ds)
    ds = ds.assign_coords(start=[f"$(x){MARKUP}", f'"), x, ("{MARKUP}'])
    ds["regime"].attrs["flag_meanings"] = " ".join(
        f"<img/src=x/onerror=window.hacked={k}>" for k in range(len(ds["regime"].attrs["flag_values"]))
    )
    return ds


def test_run_holds_only_names_and_words_of_the_scene() -> None:
    for name in NAMES:
        about = [{"name": name, "symbol": "", "units": "1", "value": 1.0, "default": 0.0}]
        try:
            assert run_document(small_map().assign_attrs(differing=json.dumps(about)))["parameters"] == {}
        except vj.InputError as error:
            assert "attribute differing[0]: name" in str(error)
    for word in WORDS:
        assert run_document(small_map().assign_attrs(start=word))["start"] is None
        assert run_document(small_map().assign_attrs(friction=word)) == {"own_scene": True}
        assert run_document(small_map().assign_attrs(scene=word)) == {"own_scene": True}
    vector = run_document(small_map().assign_attrs(start="[0.0, -1.5, 0.0, 0.0]"))["start"]
    assert vector == (0.0, -1.5, 0.0, 0.0)


def test_hostile_dataset_runs_no_code(browser: Any, tmp_path: Path) -> None:
    width = 390
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
    hits: list[str] = []
    page.route("**/*", lambda route: (hits.append(route.request.url), route.abort()))  # sees what the policy lets pass
    page.evaluate(ATTEMPTS, "http://127.0.0.1:1")
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


def test_policy_allows_only_content_of_the_page() -> None:
    policy = content_policy(["a()"], [])
    assert "script-src 'sha256-" in policy and "style-src 'none'" in policy and "connect-src 'none'" in policy
    assert "connect-src 'self'" in content_policy([], [], asks=True) and "unsafe" not in policy
