"""Check that figures of the README and of the site are those of the code."""

import re
from pathlib import Path

import vibrojax as vj
from vibrojax import cli
from vibrojax.io.dataset import LAZY_FROM
from vibrojax.lanes import certificate
from vibrojax.periodic import lane_stages
from vibrojax.pictures.selection import MOST_LANES
from vibrojax.settings.toml import bundled_names
from vibrojax.stepping import Located

ROOT = Path(__file__).parents[1]


def text_of(name: str) -> str:
    """Return the text of a file of the repository, or of a page of the site, with line breaks replaced by spaces."""
    path = ROOT / name if "/" in name or "." in name else ROOT / "notebooks" / f"{name}.md"
    return " ".join(path.read_text().split())


def test_readme_describes_bundled_sweeps():
    readme, sweep = text_of("README.md"), vj.read_sweep("regime-map")
    seconds = sweep.run.settle + sweep.run.observe
    assert f"{sweep.lanes:,} lanes, each with {seconds:g} s of simulated time" in readme
    assert sweep.axes["delta"].tolist() == [-0.005, 0.005] and len(sweep.starts) == 2
    names = readme.partition("runs a bundled sweep (")[2].partition(")")[0]
    assert sorted(re.findall(r"`([\w-]+)`", names)) == bundled_names()


def test_constants():
    methods, accuracy, large = map(text_of, ("how_it_works", "accuracy", "large_sweeps"))
    assert f"a Taylor series of order {Located().order}" in methods
    assert f"at least {lane_stages.EARLY_END_MIN_SECONDS:,.0f} simulated seconds, or" in methods
    assert f"or {lane_stages.SHARING_MIN_SECONDS:,.0f} if lanes share orbits" in methods
    assert f"at least {lane_stages.SHARING_MIN_STARTS} starts" in methods
    assert Located().coarser_by == 10 and "ten times coarser" in accuracy
    assert f"more than {certificate.GROWTH_RETURNS:g} returns" in accuracy and certificate.CHANGE == 1e-9
    assert f"up to {certificate.LANE_SECONDS:,.0f} simulated seconds" in accuracy
    assert f"chunks of {lane_stages.CHUNK:,} lanes, or {lane_stages.CHUNK_SHARING_ORBITS:,} if they share" in large
    assert f"of over {LAZY_FROM / 1e6:g} MB is opened" in large and f"draws {MOST_LANES:,} lanes at most" in large
    commands = text_of("commands")
    assert f"{cli.DONE} done; {cli.BAD_INPUT} bad input" in commands
    assert f"{cli.INTERRUPTED} interrupted" in commands and f"{cli.TERMINATED} terminated" in commands
