"""Browser tests of pages of untrusted datasets: only the page's script runs, and the calls to copy are harmless."""

import ast
import json
import shlex
from pathlib import Path
from typing import Any

import xarray as xr
from browser import new_page, wrong
from hostile import CODE, HUGE, MARKUP, STEERING, attribute, each_variable
from small_map import small_map

import vibrojax as vj
from vibrojax.explorer import contents_of, page_text
from vibrojax.explorer.document import run_document
from vibrojax.scenes.vibro_impact import VibroImpact

NAMES = ("__proto__", "toString", "v\nx", "v=1", CODE, "vе", "v\u202e", "$(x)", "'", '"')
WORDS = ("$(touch hacked)", "'; touch hacked; '", '"), __import__("os"), ("', "stuck\nx", "ѕtuck", MARKUP)


def open_page(browser: Any, text: str, folder: Path, width: int = 1280) -> tuple[Any, Any, Any]:
    """Return the page of this text in the browser, its console messages and its requests."""
    path = folder / "page.html"
    path.write_text(text, encoding="utf-8")
    return new_page(browser, path.as_uri(), viewport={"width": width, "height": 900})


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


def hostile_map() -> xr.Dataset:
    """Return a map whose texts are markup, including those of the starts."""
    ds = each_variable(long_name=MARKUP, units=MARKUP, symbol=MARKUP)(small_map())
    ds = attribute("title", f"{MARKUP} {STEERING} {HUGE}")(ds)
    ds = ds.assign_coords(start=[f"$(x){MARKUP}", f'"), x, ("{MARKUP}'])
    ds["regime"].attrs["flag_meanings"] = " ".join(
        f"<img/src=x/onerror=window.hacked={k}>" for k in range(len(ds["regime"].attrs["flag_values"]))
    )
    return ds


def test_run_holds_only_names_and_words_of_the_scene():
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


def test_hostile_dataset_runs_no_code(browser, tmp_path):
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


def test_page_policy_blocks_injected_code(browser, tmp_path):
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
