"""Tests of untrusted datasets: each command soon gives its result or one line, without control characters; a page runs
only its own script, and the calls to copy are harmless."""

import ast
import json
import os
import re
import resource
import shlex
import time
import unicodedata
from pathlib import Path
from typing import Any

import netCDF4
import pytest
import xarray as xr
from browser import new_page, wrong
from hostile import CODE, HUGE, MARKUP, REFUSED, SHOWN, STEERING, attribute, each_variable
from mutants import write_mutant
from refusals import command_refusal, refusal
from small_map import small_map

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.errors import InputError, escape_json, printable
from vibrojax.explorer import contents_of, page_text
from vibrojax.explorer.document import check_names, run_document
from vibrojax.io.files import read_regular
from vibrojax.maps.rerun import sweep_of_dataset
from vibrojax.scenes.vibro_impact import VibroImpact

SWEEP = {
    "scene": "vibro-impact",
    "parameters": {"delta": 0.005},
    "grid": {"beta": [0.3, 0.35], "gamma": [0.65, 0.7]},
    "run": {"settle": 1.0, "observe": 1.0},
}
READ = (["info"], ["plot"], ["explore"], ["fit"])
RUN = (["orbits"], ["attractors"], ["borders"])
WRITES = {"plot": "png", "explore": "html", "fit": "nc", "orbits": "nc", "attractors": "nc", "borders": "nc"}
LONG, SHORT_STEPS = "settle = 1e9", ("borders", "settle = 1.0\nstep = 1e-7", 2e7)


@pytest.fixture(scope="module")
def sweep() -> xr.Dataset:
    return vj.run_sweep(SWEEP, progress=False)


@pytest.fixture
def run_command(tmp_path, capsys):
    """Return a function that runs a command on a dataset and returns its status, stdout and stderr."""

    def run(words, ds):
        path = tmp_path / "sent.nc"
        vj.write_dataset(ds, path)  # sealed, so that no process of its own reads it each time
        command, *options = words
        out = ["-o", str(tmp_path / f"out.{WRITES[command]}")] if command in WRITES else []
        status = main([command, str(path), *options, *out])
        printed = capsys.readouterr()
        return status, printed.out, printed.err

    return run


def control_characters(text):
    """Return the characters of a text that control a terminal or the direction of writing."""
    return {x for x in text if x != "\n" and unicodedata.category(x) in ("Cc", "Cf", "Cs", "Zl", "Zp")}


@pytest.mark.parametrize(("number", "name"), list(enumerate(REFUSED)), ids=REFUSED)
def test_malformed_dataset_is_refused_in_one_line(sweep, run_command, number, name):
    """All commands refuse it in the same words. One reader checks every dataset, so two commands per case suffice."""
    change, about = REFUSED[name]
    ds = change(sweep)
    commands = (*READ, *RUN)
    for words in (commands[0], commands[number % len(commands)]):
        status, out, err = run_command(words, ds)
        assert (status, out, err.count("\n")) == (2, "", 1), words
        assert f"sent.nc: {about}" in err or about in err, err
        assert len(err) < 500 and not control_characters(err) and "does not fit together" not in err


@pytest.mark.parametrize("name", SHOWN)
def test_unusual_dataset_is_shown_or_refused(sweep, run_command, name):
    """Texts are shortened and free of control characters, and no simulation exceeds its limit."""
    without_sweep = {key: value for key, value in sweep.attrs.items() if key != "sweep"}
    ds = SHOWN[name](sweep.drop_attrs(deep=False).assign_attrs(without_sweep)).assign_attrs(source=sweep.source)
    for words in READ:
        status, out, err = run_command(words, ds)
        assert status in (0, 2), (words, err)
        assert err.count("\n") <= 1 and len(err) < 5000, (words, err)
        assert len(out) < 100_000 and not control_characters(out + err), words
        assert "Traceback" not in err


@pytest.mark.parametrize(("word", "settle", "steps"), [("explore", LONG, 1e9), ("orbits", LONG, 1e9), SHORT_STEPS])
def test_overlong_sweep_is_not_run_for_dataset(sweep, run_command, word, settle, steps, tmp_path):
    """Steps count: two seconds in steps of 1e-7 s take as long as 30 years in usual steps. (No identity says that the
    text has changed.)"""
    ds = sweep.assign_attrs(sweep=sweep.attrs["sweep"].replace("settle = 1.0", settle))
    del ds.attrs["identity"]
    status, _, err = run_command([word], ds)
    text = (tmp_path / "out.html").read_text() if word == "explore" else err
    [(lanes, most)] = re.findall(r"the sweep that the dataset names has (\d) lanes of up to (\S+) steps", text)
    assert int(lanes) == sweep.lanes and float(most) >= steps
    assert status == (0 if word == "explore" else 2) and err.count("\n") == status / 2


def test_dataset_cannot_name_sweep_of_other_lanes(sweep):
    """A small file cannot make its reader compute a large sweep: lanes are those of its coordinates."""
    text = sweep.attrs["sweep"].replace("beta = [0.3, 0.35]", "beta = {start = 0.3, stop = 0.6, num = 1000}")
    assert text != sweep.attrs["sweep"]
    named = sweep_of_dataset(sweep.assign_attrs(sweep=text, identity="{}"))
    assert named.axes["beta"].tolist() == [0.3, 0.35] and named.lanes == sweep.lanes
    with pytest.raises(InputError, match=r"the sweep that the dataset names has changed: grid\.beta was"):
        sweep_of_dataset(sweep.assign_attrs(sweep=text))


def test_claimed_sizes_are_refused(tmp_path, capsys):
    """A file of a few kilobytes claims 10^12 values."""
    path = tmp_path / "sent.nc"
    with netCDF4.Dataset(path, "w") as file:
        file.source = "vibrojax 0"
        for name in ("beta", "gamma"):
            file.createDimension(name, 10**6)
        file.createVariable("regime", "i1", ("beta", "gamma"), chunksizes=(1000, 1000))
    assert "claims 1e+03 GB" in command_refusal(capsys, "info", path)
    path = tmp_path / "large.csv"
    path.write_bytes(b"x" * (2**20 + 1))
    assert len(read_regular(path, 2**20 + 1)) == 2**20 + 1
    assert "is larger than 1 MiB" in refusal(read_regular, path, 2**20)


def test_checks_hold_for_datasets_in_memory(sweep):
    ds = sweep.assign_attrs(differing="[1]")
    assert "attribute differing" in refusal(vj.write_page, ds, "page.html", progress=False)
    assert "attribute differing" in refusal(vj.picture, ds)
    assert "__proto__" in refusal(check_names, sweep.rename(period="__proto__"))


def test_escaping_of_texts():
    assert not control_characters(printable(STEERING)) and printable(STEERING).endswith("b")
    assert len(printable(HUGE, 200)) == 200 and printable(HUGE, 200).endswith("…")
    assert printable("  a \t b ") == "a b" and printable("β, Δ = 5 mm") == "β, Δ = 5 mm"
    text = json.dumps({"a": STEERING, "b": "\U000e0041 é"}, ensure_ascii=False)
    assert json.loads(escape_json(text)) == json.loads(text) and not control_characters(escape_json(text))


def test_suggested_columns_are_one_shell_word(tmp_path, capsys):
    """The author of a CSV file chooses the names of its columns."""
    path = tmp_path / "rig.csv"
    path.write_text('"ROP $(touch hacked) [m/h]",relief\n1.0,0.5\n')
    assert "'rate_of_penetration=ROP $(touch hacked)" in command_refusal(capsys, "fit", path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in the file system")
def test_devices_and_pipes_are_not_read(tmp_path):
    """One has no end, and the other never begins."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    points = {"scene": "vibro-impact", "points": str(pipe)}
    for read, source in ((vj.read_sweep, "/dev/zero"), (vj.read_sweep, points), (vj.read_log, pipe)):
        assert "is a device or a pipe" in refusal(read, source)


SAMPLES = sorted((Path(__file__).parent / "data" / "versions").glob("*/*.nc"))
MOST_SECONDS, MOST_MEMORY = 20.0, 2**20
"""Greatest processor time of all commands [s] and greatest growth of memory [KiB]."""


def peak(who):
    return resource.getrusage(who).ru_maxrss


@pytest.mark.parametrize("seeds", [range(2), pytest.param(range(2, 200), marks=pytest.mark.long)], ids=["few", "many"])
@pytest.mark.filterwarnings("default")
def test_mutants_are_shown_or_refused(seeds, tmp_path, capsys):
    """No command fails in more than one line, takes long, or fills the memory."""
    for seed in seeds:
        path = tmp_path / f"sent{seed}.nc"
        what = write_mutant(seed, SAMPLES, path)
        before, begun = peak(resource.RUSAGE_SELF), time.process_time()
        for words in (["info"], ["plot"], ["explore"]):
            status = main([*words, str(path)])
            err = capsys.readouterr().err
            assert status in (0, 2) and "Traceback" not in err, (what, words, err)
            assert err.count("\n") == 1 if status == 2 else err.count("\n") <= 20, (what, words, err)
        try:
            vj.open_dataset(path)
        except InputError as error:
            assert "\n" not in str(error), what
        assert time.process_time() - begun < MOST_SECONDS, what
        assert peak(resource.RUSAGE_SELF) - before < MOST_MEMORY, what


NAMES = ("__proto__", "toString", "v\nx", "v=1", CODE, "vе", "v\u202e", "$(x)", "'", '"')
WORDS = ("$(touch hacked)", "'; touch hacked; '", '"), __import__("os"), ("', "stuck\nx", "ѕtuck", MARKUP)


def open_page(browser: Any, text: str, path: Path) -> tuple[Any, Any, Any]:
    """Return the page of this text on a phone, its console messages and its requests."""
    path.write_text(text, encoding="utf-8")
    return new_page(browser, path.as_uri(), viewport={"width": 390, "height": 900})


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
    """The texts of a map are markup, including those of the starts."""
    ds = each_variable(long_name=MARKUP, units=MARKUP, symbol=MARKUP)(small_map())
    ds = attribute("title", f"{MARKUP} {STEERING} {HUGE}")(ds)
    ds = ds.assign_coords(start=[f"$(x){MARKUP}", f'"), x, ("{MARKUP}'])
    names = (f"<img/src=x/onerror=window.hacked={k}>" for k in range(len(ds["regime"].attrs["flag_values"])))
    ds["regime"].attrs["flag_meanings"] = " ".join(names)
    text = page_text(contents_of(ds).document)
    assert len(text) < 500_000
    page, messages, requests = open_page(browser, text, tmp_path / "page.html")
    for variable in ("regime", "period", "stick_fraction"):
        page.get_by_label("Variable").select_option(variable)
        page.locator(".vx-over").press("ArrowRight")
    assert page.evaluate("[window.hacked, document.images.length, document.scripts.length]") == [None, 0, 3]
    assert page.evaluate("document.scrollingElement.scrollWidth") <= 390
    assert len(page.locator("h1").inner_text()) <= 200
    arguments = check_calls(page.evaluate("vibrojax.calls()"))
    assert "start" not in arguments and {"beta", "gamma"} <= set(arguments)
    assert len(requests) == 1 and not messages


def test_page_policy_blocks_injected_code(browser, tmp_path):
    """Injected code can neither run, nor load, nor send anything."""
    page, messages, _ = open_page(browser, page_text(contents_of(small_map()).document), tmp_path / "page.html")
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
