"""Measure the time until a page shows its first map, and from a click to a cell's motion, in a local Chromium.

    python tests/benchmarks/explore.py PAGE.html

Wall times are from the start of the navigation to the first map, and from a click to the drawn plots, for cells across
the page. Processor times are for the page's main thread, on which other work on the machine has little effect.
"""

import sys
from pathlib import Path
from statistics import median
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

from browser import chromium

CLICKS = 60
OPENED = 5

PICKED = """async clicks => {
    const took = [], { axes } = vibrojax.grid.data;
    for (let k = 0; k < clicks; k++) {
        const cell = Object.fromEntries(axes.map((a, n) => [a.name, (k * (7 + 4 * n) + n) % a.values.length]));
        const began = performance.now();
        await vibrojax.pick(cell);
        took.push(performance.now() - began);
    }
    return took;
}"""


def main(path: Path) -> None:
    firsts, at_first, whole = [], [], []
    with chromium() as browser:
        for _ in range(OPENED):
            page = browser.new_page(viewport={"width": 1280, "height": 900})
            session = page.context.new_cdp_session(page)
            session.send("Performance.enable", {"timeDomain": "threadTicks"})
            page.goto(path.as_uri(), wait_until="commit")
            page.wait_for_function("performance.getEntriesByName('vibrojax-first-map').length > 0")
            at_first.append(busy(session))
            page.wait_for_selector("[data-ready]")
            whole.append(busy(session))
            firsts.append(page.evaluate("performance.getEntriesByName('vibrojax-first-map')[0].startTime"))
        before = busy(session)
        took = page.evaluate(PICKED, CLICKS)
        each = (busy(session) - before) / CLICKS
    clock, least = median(firsts), min(firsts)
    print(f"{path.name}: {path.stat().st_size / 1e6:.1f} MB")
    print(f"first map: {clock:.0f} ms by the clock (least {least:.0f}); {median(at_first):.0f} ms of processor time")
    print(f"whole page: {median(whole):.0f} ms of processor time")
    clock, least = median(took), min(took)
    print(f"click to motion: {clock:.0f} ms by the clock (least {least:.0f}); {each:.0f} ms of processor time")


def busy(session: Any) -> float:
    """Return the processor time [ms] of the page's main thread in tasks."""
    metrics = {one["name"]: one["value"] for one in session.send("Performance.getMetrics")["metrics"]}
    return 1e3 * metrics["TaskDuration"]


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
