"""A browser for tests: the installed Chromium or playwright's own."""

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

PATIENCE = 60_000
"""Timeout [ms] for a page, long enough for slow or busy machines."""

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
ARGUMENTS = ["--no-sandbox", "--no-first-run"]
ARGUMENTS += [f"--disable-{part}" for part in ("gpu", "background-networking", "component-update", "sync")]


@contextmanager
def chromium() -> Iterator[Any]:
    """Yield playwright's Chromium. Skip the test, with the reason, if there is none. The environment variable
    VIBROJAX_BROWSER names another binary."""
    playwright = pytest.importorskip("playwright.sync_api", reason='playwright is missing: pip install ".[browser]"')
    binary = os.environ.get("VIBROJAX_BROWSER") or next(filter(None, map(shutil.which, NAMES)), None)
    with playwright.sync_playwright() as tools:
        try:
            browser = tools.chromium.launch(executable_path=binary, args=ARGUMENTS)
        except playwright.Error as error:
            missing = "no Chromium: playwright install chromium, or apt install"
            reason = f"{binary} cannot be started" if binary else missing
            pytest.skip(f"{reason} ({str(error).splitlines()[0][:100]})")
        yield browser
        browser.close()


def new_page(browser: Any, url: str = "", **options: Any) -> tuple[Any, list[tuple[str, str]], list[str]]:
    """Return a page in its own context with these options, its console messages (type, text), and the requested URLs.
    With a URL, the page is open there, and ready. An error that the page does not catch has the type "error"."""
    page = browser.new_context(**options).new_page()
    page.set_default_timeout(PATIENCE)
    messages: list[tuple[str, str]] = []
    requests: list[str] = []
    page.on("console", lambda message: messages.append((message.type, message.text)))
    page.on("pageerror", lambda error: messages.append(("error", str(error))))
    page.on("request", lambda request: requests.append(request.url))
    if url:
        page.goto(url)
        page.wait_for_selector("[data-ready]")
    return page, messages, requests


def wait_for(page: Any, expression: str) -> None:
    """Wait until an expression is true in a page. `page.wait_for_function` evaluates strings inside the page, which its
    content policy refuses."""
    end = time.monotonic() + PATIENCE / 1000
    while not page.evaluate(expression):
        assert time.monotonic() < end, expression
        page.wait_for_timeout(20)


def wrong(messages: list[tuple[str, str]]) -> list[str]:
    """Return the texts of the errors and warnings among console messages."""
    return [text for kind, text in messages if kind in ("error", "warning")]
