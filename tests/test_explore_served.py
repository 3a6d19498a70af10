"""Tests of `vibrojax explore OUT.nc --live`: its output, how it ends, and the page in a browser."""

import os
import re
import signal
import socket
import urllib.request
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlparse
from urllib.request import url2pathname

import pytest
from browser import chromium, new_page, wrong
from commands import end_of, start, wait_for
from small_map import small_map

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.explorer.live import serve


@pytest.fixture(scope="module")
def dataset():
    return small_map()


@pytest.fixture(scope="module")
def file(dataset, tmp_path_factory):
    path = tmp_path_factory.mktemp("explore") / "small.nc"
    vj.write_dataset(dataset, path)
    return path


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--live", "-o", "page.html"], "-o: --live writes no page"),
        (["beta=0.4", "--live"], '"beta=0.4": values are for a scene, with --live; leave them out'),
        (["--no-browser"], "--no-browser: there is no browser to open without --live"),
    ],
)
def test_contradictory_options_are_refused(file, capsys, words, line):
    assert main(["explore", str(file), *words]) == 2
    error = capsys.readouterr().err
    assert line in error and error.count("\n") == 1


@pytest.mark.skipif(os.name != "posix", reason="modes of files and signals")
def test_command_serves_until_interrupted_and_browser_arguments_hold_no_token(file, tmp_path):
    """All users see the arguments of a browser. A private file, which is deleted at the end, leads it to the page."""
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


@pytest.fixture(scope="module")
def browser():
    with chromium() as instance:
        yield instance


@contextmanager
def browser_page(browser, url):
    """Open a page; check that its console has no error and that it requests nothing from elsewhere."""
    page, messages, requests = new_page(browser, viewport={"width": 1280, "height": 900})
    page.goto(url)
    page.wait_for_selector("[data-ready]")
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
        page, _, _ = new_page(browser)
        page.goto(live.url)
        page.wait_for_selector("[data-ready]")
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
