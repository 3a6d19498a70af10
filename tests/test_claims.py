"""Check figures and links of the README and of the site, and the actions and commands of CI.

The rows of `KEPT` name a sentence, and the file that records its figures, with the text that holds them there."""

import json
import re
from pathlib import Path
from urllib.parse import unquote

import pytest

import vibrojax as vj
from vibrojax import cli
from vibrojax.io.dataset import LAZY_FROM
from vibrojax.lanes import certificate
from vibrojax.periodic import lane_stages
from vibrojax.pictures.selection import MOST_LANES
from vibrojax.settings.toml import bundled_names

ROOT = Path(__file__).parents[1]


def text_of(name: str) -> str:
    """Return the text of a file of the repository, or of a page of the site, with line breaks replaced by spaces."""
    path = ROOT / name if "/" in name or "." in name else ROOT / "notebooks" / f"{name}.md"
    return " ".join(path.read_text().split())


BENCHMARKS, HARD, SOURCE = "tests/benchmarks/README.md", "tests/hard/README.md", "tests/source/source.toml"
KEPT = [
    ("accuracy", "311 of the 4,820 periodic lanes are sensitive", HARD,
     ["311 of 4,820", "second runs take 9 %", "the other 4,318 certified", "3,037 lanes", "(0.6 %)"]),
    ("regimes", "irregular or undecided | 1,556 | 588", HARD, ["599 of 4096", "11 are", "1556", "197", "194"]),
    ("regimes", "Of 2,670 irregular lanes of the default map, 52 %", BENCHMARKS,
     ["of 2,670 irregular lanes 52.1 % chaotic, 38.8 % not settled, 7.0 % periodic"]),
    ("attractors", "67 % of the points have one attractor, 30 % two, and 2 %", BENCHMARKS,
     ["(67.4 %)", "(30.3 %)", "(1.5 %)", "`drive` at 18.9 %", "`stuck` at 4.9 %"]),
    ("rig_log", "above 500 ft/h, 180 klbf or 500 rpm", "vibrojax/io/riglog.py",
     ["500 * 0.3048 / 3600", "500 * RPM"]),
    ("rig_log", "the evidence against it exceeds 5.4", "vibrojax/studies/rop_forms.py", ["BLOCK_LIMIT = 5.4"]),
    ("large_sweeps", "kills a sweep two hundred times; no chunk has been lost", HARD,
     ["Seen: 200 kills", "no chunk lost"]),
    ("reproduction", "with at most a third of the 470 kN", SOURCE, ["strikes with at most a third of the 470 kN"]),
    ("reproduction", "in up to six tenths of the recommended region", SOURCE,
     ["in up to six tenths of the recommended region"]),
]  # fmt: skip


@pytest.mark.parametrize(("page", "sentence", "file", "held"), KEPT, ids=lambda value: str(value)[:40])
def test_figures_are_kept(page, sentence, file, held):
    assert sentence in text_of(page)
    assert [part for part in held if part not in text_of(file)] == []


def test_readme_describes_bundled_sweeps():
    readme, sweep = text_of("README.md"), vj.read_sweep("regime-map")
    seconds = sweep.run.settle + sweep.run.observe
    assert f"{sweep.lanes:,} lanes, each with {seconds:g} s of simulated time" in readme
    assert sweep.axes["delta"].tolist() == [-0.005, 0.005] and len(sweep.starts) == 2
    names = readme.partition("runs a bundled sweep (")[2].partition(")")[0]
    assert sorted(re.findall(r"`([\w-]+)`", names)) == bundled_names()
    names = ("vibro_impact_cases.json", "penetration_cases.json")
    drill, rock = (len(json.loads((ROOT / "tests" / "data" / name).read_text())) for name in names)
    assert f"On the {drill} reference cases in" in text_of("README.md")
    assert f"The {drill} reference cases in" in text_of("how_it_works")
    assert f"On {rock} reference cases of penetration" in text_of("how_it_works")


def test_constants():
    methods, accuracy, large = map(text_of, ("how_it_works", "accuracy", "large_sweeps"))
    assert f"a Taylor series of order {vj.Located().order}" in methods
    assert f"at least {lane_stages.EARLY_END_MIN_SECONDS:,.0f} simulated seconds, or" in methods
    starts = f"at least {lane_stages.SHARING_MIN_STARTS} starts"
    assert f"or {lane_stages.SHARING_MIN_SECONDS:,.0f} if each point has {starts}" in methods
    assert f"If a point has {starts}, its lanes share" in methods
    assert vj.Located().coarser_by == 10 and "ten times coarser" in accuracy
    assert f"more than {certificate.GROWTH_RETURNS:g} returns" in accuracy and certificate.CHANGE == 1e-9
    assert f"chunks of {lane_stages.CHUNK:,} lanes" in large
    assert f"of over {LAZY_FROM / 1e6:g} MB is opened" in large and f"draws {MOST_LANES:,} lanes at most" in large
    commands = text_of("commands")
    assert f"is {cli.DONE} after success, {cli.BAD_INPUT} after bad input, {cli.INTERRUPTED} after" in commands
    assert f"and {cli.TERMINATED} after termination" in commands


def row(start: str) -> list[float]:
    """Return the numbers of a row of the tables of times, without their ranges: on Python 3.11, then on 3.13."""
    line = next(line for line in (ROOT / BENCHMARKS).read_text().splitlines() if line.startswith(f"| {start}"))
    return [float(cell.split("(")[0]) for cell in line.split("|")[2:4] if cell.strip()]


def test_times_match_benchmarks():
    """Compare with the time of the default map, and with the time per simulated second at an error of 1e-4."""
    old, new = row("`vibrojax sweep regime-map` with an empty cache")
    [early], whole = row("the same for 48 s"), row("vibrojax with certificate and dataset")
    costs = f"costs {early:.0f} to {whole[0]:.0f} microseconds of one core"
    readme, methods = text_of("README.md"), text_of("how_it_works")
    assert round(new) == round(old) and f"takes {new:.0f} s on two cores" in readme
    assert costs in readme and costs in methods


# Links, names in the reference, and the actions and commands of CI
PAGES = sorted((ROOT / "notebooks").rglob("*.md"))
TEXTS = ["README.md", "CHANGELOG.md", ".github/CONTRIBUTING.md", "tests/benchmarks/README.md", "tests/hard/README.md"]


def heading_anchors(text: str) -> set[str]:
    """Return the anchors of a text's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("name", TEXTS)
def test_links_of_texts_have_targets(name):
    text = (ROOT / name).read_text()
    for link in re.findall(
        r"\]\(([^)\s]+)\)", re.sub(r"`[^`]*`|^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    ):
        if link.startswith(("http://", "https://", "mailto:")):
            continue
        path, _, anchor = unquote(link).partition("#")
        target = (ROOT / name).parent / path if path else ROOT / name
        assert target.exists(), link
        assert not anchor or anchor in heading_anchors(target.read_text()), link


def test_every_public_name_is_in_reference():
    text = "".join(path.read_text() for path in PAGES if path.parent.name == "api")
    documented = {
        name.rpartition(".")[2] for name in re.findall(r"^\.\. auto\w+:: ([\w.]+)$", text, flags=re.MULTILINE)
    }
    assert sorted(set(vj.__all__) - documented) == [], "write these onto a page of notebooks/api"


def test_gallery_shows_every_script_with_its_picture():
    """The build of the site runs the scripts, and an error in one of them ends it."""
    names = sorted(script.stem for script in (ROOT / "notebooks" / "gallery").glob("*.py"))
    page = (ROOT / "notebooks" / "gallery.md").read_text()
    assert len(names) >= 12
    assert sorted(re.findall(r"\{literalinclude\} gallery/(\w+)\.py", page)) == names
    assert sorted(re.findall(r'^made_by\("(\w+)"\)$', page, re.MULTILINE)) == names
    assert len(re.findall(r'^    alt: "[^"]+"$', page, re.MULTILINE)) == len(names)


def test_actions_are_pinned_by_commit():
    texts = [path.read_text() for path in (ROOT / ".github/workflows").glob("*.yml")]
    used = [action for text in texts for action in re.findall(r"uses: (\S+)", text)]
    assert len(texts) == 2 and used and all(re.fullmatch(r"[\w/-]+@[0-9a-f]{40}", action) for action in used)
    assert [path.name for path in (ROOT / "notebooks").glob("*.ipynb") if '"output_type"' in path.read_text()] == []
