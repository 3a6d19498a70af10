"""Check that each figure of the README and of the site has a claim, and that cheap claims hold.

Claims are listed in `claims.toml` and, for the site, in `claims_site.toml` (any `claims*.toml`). A claim names a test
that keeps the figure true, or the command that measures it again.
"""

import ast
import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import vibrojax as vj
from vibrojax import cli
from vibrojax.io.dataset import LAZY_FROM
from vibrojax.periodic.lane_stages import CHUNK, CHUNK_SHARING_ORBITS
from vibrojax.pictures.selection import MOST_LANES
from vibrojax.settings.toml import bundled_names
from vibrojax.stepping import Located

ROOT = Path(__file__).parents[1]


def unwrapped(text: str) -> str:
    """Return the text with line breaks replaced by spaces."""
    return " ".join(text.split())


ASIDE = re.compile(
    r"^(`{3,}).*?^\1|\A---\n.*?^---$|^ *:[\w-]+:.*?$|^ *\d+\. |^%.*?$|^\(.*?\)=$"
    r"|<svg.*?</svg>|</?[a-zA-Z][^>\n]*>|\$\$.*?\$\$|\$[^$]*\$",
    flags=re.MULTILINE | re.DOTALL,
)
"""Parts of a page that are not prose: code, front matter, options, list numbers, comments, tags, equations, labels."""


def prose(path: Path) -> str:
    """Return the prose of a page, in which each figure needs a claim."""
    return unwrapped(ASIDE.sub(" ", path.read_text()))


PAGES = {
    path.relative_to(ROOT).as_posix(): prose(path)
    for path in [ROOT / "README.md", *sorted((ROOT / "notebooks").rglob("*.md"))]
}
README = PAGES["README.md"]
METHODS = PAGES["notebooks/how_it_works.md"]
BENCHMARKS = (ROOT / "tests" / "benchmarks" / "README.md").read_text()
CLAIMS = [
    claim
    for file in sorted((ROOT / "tests").glob("claims*.toml"))
    for claim in tomllib.loads(file.read_text()).get("claim", [])
]

NOT_FIGURES = (
    r"`[^`]*`",
    r"\(\.?[\w/.-]+\)",  # the target of a link
    r"Python 3\.\d+",
    r"\b\d+\.\d+\.\d+\b",  # a version
    r"(?:eqs?\.|[Ee]quations?|Tables?|CF) [\d.]+\d(?: (?:to|and) [\d.]+\d)?",
    r"\[1(?:/s)?\]",
    r"chapters? \d+(?: and \d+)?",
    r"\b[A-Za-z]+\d\w*\b",
    r"\bAVX-\d+|\b0-1 test\b",
)
"""Digits that are not figures: names, numbers of equations, symbols, versions."""


def figures_without_claim(page: str) -> list[str]:
    """Return the figures of a page that no claim covers, each with the surrounding words."""
    rest = page
    for claim in sorted(CLAIMS, key=lambda claim: -len(claim["text"])):
        rest = rest.replace(unwrapped(claim["text"]), " ")
    for pattern in NOT_FIGURES:
        rest = re.sub(pattern, " ", rest)
    return [rest[max(match.start() - 60, 0) : match.end() + 30] for match in re.finditer(r"\d[\d.,]*", rest)]


@pytest.mark.parametrize("name", PAGES)
def test_each_figure_has_a_claim(name):
    missing = figures_without_claim(PAGES[name])
    assert not missing, f"figures of {name} without a line in tests/claims.toml or tests/claims_site.toml: {missing}"


def test_figure_without_claim_is_reported(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("---\na: 1\n---\n# A\n1. `x = 3` and $y = 4$\n```{code-cell}\n5\n```\n<b id='6'>in 7.5 s</b>\n")
    assert [unwrapped(figure) for figure in figures_without_claim(prose(page))] == ["# A and in 7.5 s"]


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim["text"][:40])
def test_claim_holds(claim):
    assert any(unwrapped(claim["text"]) in page for page in PAGES.values()), "not, or no longer, in README or site"
    assert claim.keys() <= {"text", "test", "holds", "refresh", "kept", "cited"}
    assert claim.keys() & {"test", "refresh", "cited"}
    for test in claim.get("test", []):
        path, _, name = test.partition("::")
        functions = [
            node.name for node in ast.parse((ROOT / path).read_text()).body if isinstance(node, ast.FunctionDef)
        ]
        assert name in functions, test
    for script in re.findall(r"[\w/]+\.py\b", claim.get("refresh", "")):
        assert (ROOT / script).is_file(), script
    if "holds" in claim:
        kept = claim["kept"] if "kept" in claim else claim["test"][0].partition("::")[0]
        text = unwrapped((ROOT / kept).read_text())
        assert [part for part in claim["holds"] if part not in text] == [], f"not in {kept}"


# Claims that are cheap to check


def test_first_map_of_readme_is_bundled_sweep():
    sweep = vj.read_sweep("regime-map")
    seconds = sweep.run.settle + sweep.run.observe
    assert f"{sweep.lanes:,} lanes, each with {seconds:g} s of simulated time" in README
    assert sweep.axes["delta"].tolist() == [-0.005, 0.005] and len(sweep.starts) == 2
    assert "for a preload and a gap of 5 mm, from two starts" in README


def test_readme_names_all_bundled_sweeps():
    names = README.partition("runs a bundled sweep (")[2].partition(")")[0]
    assert sorted(re.findall(r"`([\w-]+)`", names)) == bundled_names()


def test_counts_of_cases():
    counts = {name: len(json.loads((ROOT / "tests" / "data" / name).read_text())) for name in CASES}
    assert all(f"On the {counts[CASES[0]]} reference cases in" in page for page in (README, METHODS))
    assert f"of the {counts[CASES[1]]} reference cases of penetration" in METHODS


CASES = ("vibro_impact_cases.json", "penetration_cases.json")


def test_settings_of_the_stepper():
    stepper = Located()
    assert f"a Taylor series of order {stepper.order}" in METHODS
    assert stepper.coarser_by == 10 and "ten times coarser" in METHODS


def test_table_of_hard_cases():
    """Compare with `tests/hard/README.md`, which `tests/hard/check.py` refreshes. Each row adds up to its lanes."""
    hard_cases = unwrapped((ROOT / "tests" / "hard" / "README.md").read_text())
    rows = [
        [int(x) for x in re.findall(r"\d+", cells)]
        for cells in re.findall(r"\| drill, float\d\d \|((?: \d+ \|)+)", PAGES["notebooks/reliability.md"])
    ]
    lanes, *double = rows[0]
    assert sum(double) == lanes == sum(rows[1][1:]) == rows[1][0] == vj.read_sweep("hard-cases").lanes
    single = ", ".join(map(str, rows[1][1:3])) + f" and {rows[1][3]}"
    assert (
        f"of {lanes} lanes {double[0]} are exact, {double[1]} refused and {double[2]} flagged (float32: {single})"
        in hard_cases
    )
    rock = re.search(r"\| rock, three scenes \| (\d+) \| (\d+), and one to 2e-5 \|", PAGES["notebooks/reliability.md"])
    assert f"Of {rock[1]} on rock {rock[2]} are exact" in hard_cases and int(rock[2]) == int(rock[1]) - 1
    assert "within 1e-5 (float32: 3e-3)" in hard_cases


def row(start: str) -> list[float]:
    """Return the numbers of a row of the table of times, without their spreads: on Python 3.13, then on 3.11."""
    line = next(line for line in BENCHMARKS.splitlines() if line.startswith(f"| {start}"))
    return [float(cell.split("±")[0]) for cell in line.split("|")[2:4]]


def test_times_match_benchmarks():
    new, old = row("`vibrojax sweep regime-map` from a fresh process")
    assert round(new) == round(old)
    assert f"takes {new:.0f} s from nothing on two cores, on Python 3.11 as on 3.13" in README
    lane_seconds = 12_096 * 48.0
    full, early = (row(start) for start in ("12,096 lanes of the inner box", "the same, settled lanes ended early"))
    slowest = peers()["vibrojax"][0]
    words = {3: "three", 4: "four", 5: "five", 6: "six", 7: "seven"}
    least, most = (words[round(1e6 * early[0] / lane_seconds)], words[round(slowest)])
    assert f"costs {least} to {most} microseconds" in README
    for python in (0, 1):
        assert 3 < 1e6 * early[python] / lane_seconds <= 1e6 * full[python] / lane_seconds <= slowest


def peers() -> dict[str, tuple[float, float]]:
    """Return microseconds per lane-second at 1e-4, and the ratio to ours, for each peer in the table of the race."""
    cells = [
        [cell.strip() for cell in line.split("|")] for line in BENCHMARKS.splitlines() if line.startswith("| 1e-04")
    ]
    return {row[2]: (float(row[3]), float(row[5])) for row in cells if row[3] != "–"}


def test_ratios_match_race():
    ratio = {name: ratio for name, (_, ratio) in peers().items()}
    for name, text in {
        "SciPy, solve_ivp with events": "{:.0f} times faster than SciPy with events",
        "diffrax, smoothed, adaptive": "{:.0f} times faster than diffrax with smoothed friction",
        "diffrax with its events": "{:.0f} times faster than diffrax with its events in a loop of ours",
        "C++ SIMD, RK4, smoothed": "{:.0f} times faster than a smoothed loop in SIMD",
    }.items():
        assert text.format(ratio[name]) in METHODS, name
    assert ratio["numba, Dormand-Prince 5(4)"] == pytest.approx(1.0, abs=0.05)
    assert "one by Dormand-Prince is as fast" in METHODS
    assert f"one of the same Taylor steps {1 / ratio['numba, Taylor series']:.1f} times faster" in METHODS


def test_limits_of_systems():
    from vibrojax.measures.since_start import LEAST_MAGNITUDE, LEAST_SWING, REST_SWING
    from vibrojax.systems.equations import AT_REST
    from vibrojax.systems.system import CYCLES_OBSERVED, CYCLES_SETTLING

    assert (CYCLES_SETTLING, CYCLES_OBSERVED, REST_SWING) == (100, 40, 1e-6)
    assert (LEAST_SWING, LEAST_MAGNITUDE) == (1e-3, 1e-9)
    assert AT_REST * np.finfo(float).eps ** 0.5 == pytest.approx(2.4e-7, rel=0.02)


def test_limits_of_large_sweeps():
    page = PAGES["notebooks/large_sweeps.md"]
    assert f"chunks of {CHUNK:,} lanes, or {CHUNK_SHARING_ORBITS:,} if they share orbits" in page
    assert f"over {LAZY_FROM / 1e6:g} MB is opened without being read" in page
    assert f"draws {MOST_LANES:,} lanes at most" in page


def test_exit_statuses():
    page = PAGES["notebooks/commands.md"]
    assert f"Exit status: {cli.DONE} done; {cli.BAD_INPUT} bad input" in page
    assert f"{cli.INTERRUPTED} interrupted" in page and f"{cli.TERMINATED} terminated" in page
