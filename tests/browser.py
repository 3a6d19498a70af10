"""A browser for tests: Chromium as it is installed, or playwright's own; none where there is neither."""

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

PATIENCE = 60_000
"""Milliseconds that a page is waited for: machines may be slow, or have other work."""

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
]


@contextmanager
def chromium() -> Iterator[Any]:
    """A Chromium of playwright's; the test is skipped, and says what is missing, where there is none.

    The environment's VIBROJAX_BROWSER names another binary.
    """
    playwright = pytest.importorskip("playwright.sync_api", reason='playwright is missing: pip install ".[browser]"')
    binary = os.environ.get("VIBROJAX_BROWSER") or next(filter(None, map(shutil.which, NAMES)), None)
    with playwright.sync_playwright() as tools:
        try:
            browser = tools.chromium.launch(executable_path=binary, args=ARGUMENTS)
        except playwright.Error as error:
            what = (
                f"{binary} cannot be started" if binary else "no Chromium: playwright install chromium, or apt install"
            )
            pytest.skip(f"{what} ({str(error).splitlines()[0][:100]})")
        yield browser
        browser.close()


def new_page(browser: Any, **options: Any) -> tuple[Any, list[tuple[str, str]], list[str]]:
    """(A page in a context of its own with these options, what its console says: (type, text), what it requests).

    An error that nothing in the page catches is of the type "error".
    """
    page = browser.new_context(**options).new_page()
    page.set_default_timeout(PATIENCE)
    heard: list[tuple[str, str]] = []
    asked: list[str] = []
    page.on("console", lambda message: heard.append((message.type, message.text)))
    page.on("pageerror", lambda error: heard.append(("error", str(error))))
    page.on("request", lambda request: asked.append(request.url))
    return page, heard, asked


def wait_for(page: Any, expression: str) -> None:
    """Wait until an expression is true in a page.

    `page.wait_for_function` evaluates strings inside the page, whose content policy refuses that.
    """
    end = time.monotonic() + PATIENCE / 1000
    while not page.evaluate(expression):
        assert time.monotonic() < end, expression
        page.wait_for_timeout(20)


def wrong(heard: list[tuple[str, str]]) -> list[str]:
    """The errors and warnings of what a console said."""
    return [text for kind, text in heard if kind in ("error", "warning")]
