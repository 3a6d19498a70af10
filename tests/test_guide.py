"""Tests of the guide and the README: their commands run as written, their figures are those of the code and of the
benchmarks, and links have targets. The build of the site executes Python."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import vibrojax as vj
from vibrojax import cli
from vibrojax.cli import main
from vibrojax.io.dataset import LAZY_FROM
from vibrojax.lanes import certificate
from vibrojax.periodic import lane_stages
from vibrojax.pictures.selection import MOST_LANES
from vibrojax.settings.toml import bundled_names

ROOT = Path(__file__).parents[1]
NOTEBOOKS = ROOT / "notebooks"
REFERENCE = ("index", "commands", "files_and_symbols", "reproduction")
PAGES = sorted(path.stem for path in NOTEBOOKS.glob("*.md") if path.stem not in REFERENCE)
FENCE = re.compile(r"^```(?P<info>[^\n`]*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)
START, LARGE = (
    {match["info"]: match["text"] for match in FENCE.finditer((NOTEBOOKS / f"{name}.md").read_text())}
    for name in ("start", "large_sweeps")
)


def run(block, page=START) -> list[int]:
    """Run the commands of a block, and return their exit statuses."""
    lines = [shlex.split(line) for line in page[block].splitlines()]
    assert all(line[0] == "vibrojax" for line in lines)
    return [main(line[1:]) for line in lines]


def test_first_motion(here, capsys):
    assert run("sh run=motion") == [0]
    assert capsys.readouterr().out.splitlines()[0] == START[""].strip()
    assert Path("vibro-impact.nc").is_file() and Path("vibro-impact.png").is_file()
    assert run("sh run=wrong status=2") == [2]
    (line,) = capsys.readouterr().err.splitlines()
    assert 'did you mean "gamma"?' in line


def test_first_map(here, capsys):
    Path("map.toml").write_text(START["toml file=map.toml"].replace("num = 24", "num = 2"))
    assert run("sh run=map") == [0, 0, 0]
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[:4]] == ["lanes", "memory", "disk", "time"]
    ds = vj.open_dataset("map.nc")
    assert dict(ds.sizes) | {"beta": 2, "gamma": 2, "start": 2} == dict(ds.sizes)
    assert run("sh run=plot") == [0] and run("sh run=explore") == [0]
    assert Path("map.png").is_file() and Path("stick.png").is_file()
    assert Path("map.html").read_text().startswith("<!doctype html>")


@pytest.mark.long
def test_large_sweep(here, capsys):
    pytest.importorskip("distributed")
    Path("map.toml").write_text(LARGE["toml file=map.toml"])
    assert run("sh run=plan", LARGE) == [0]
    assert capsys.readouterr().out.startswith("lanes   60 (6 beta x 5 gamma x 2 start) in 8 chunks\n")
    Path("by_dask.py").write_text(LARGE["python file=by_dask.py"])
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, *LARGE["sh run=dask"].split()[1:]], env=environment, check=True)
    expected = vj.run_sweep("map.toml", progress=False)
    xr.testing.assert_equal(vj.open_dataset("dask.nc"), expected)


@pytest.mark.parametrize("page", [page for page in PAGES if page != "large_sweeps"])
def test_all_code_of_page_is_run(page):
    """Python is executed. Commands and files are run here, except the installation and a table of another project.
    Another test runs those of the page that is left out."""
    blocks = [match for match in FENCE.finditer((NOTEBOOKS / f"{page}.md").read_text())]
    code = [match["info"] for match in blocks if re.match(r"(python|sh|toml)\b", match["info"])]
    assert [info for info in code if "=" not in info] == {"start": ["sh"], "your_own": ["toml"]}.get(page, [])
    assert not [match["info"] for match in blocks if match["info"].startswith("python")]


# The commands of the README's table, on small files of the reader's own
README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
TABLE = README.split("## I want to …")[1].split("\n\n")[1]
COMMANDS = [words for words in re.findall(r"`vibrojax ([^`]+)`", TABLE) if not words.startswith("accuracy")]
"""Without `accuracy`, which takes minutes and has tests of its own."""

MAP = """scene = "vibro-impact"
[grid]
beta = {start = 0.35, stop = 0.5, num = 4}
gamma = {start = 0.6, stop = 0.75, num = 4}
delta = [-0.005, 0.005]
"""
STARTS = """scene = "vibro-impact"
parameters = {beta = 0.4, delta = 0.0}
grid = {gamma = [0.6, 0.7]}
starts = {sample = "sobol", count = 8, box = {x2 = [-0.02, 0.0]}}
"""
ROCK = """scene = "drilling"
starts = ["stuck"]
parameters = {rock = "granite"}
grid = {v = [1.4, 1.5, 1.6]}
"""
DRILL = """scene = "vibro-impact"
start = "stuck"
data = {v = [1.2, 1.5, 1.8], period = [0.230586, 0.229602, 0.228930]}
unknown = {beta = [0.3, 0.5]}
parameters = {delta = 0.005, gamma = 0.75}
searches = 1
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with the files that the table names."""
    folder = tmp_path_factory.mktemp("readme")
    for name, text in {"map": MAP, "starts": STARTS, "rock": ROCK, "drill": DRILL}.items():
        (folder / f"{name}.toml").write_text(text)
    vj.run_sweep(str(folder / "map.toml"), progress=False).to_netcdf(folder / "map.nc")
    rates = vj.run_sweep(str(folder / "rock.toml"), progress=False)
    for name in ("speeds", "rates"):
        rates.to_netcdf(folder / f"{name}.nc")
    point = {"along": "gamma", "at": 0.75, "span": (0.55, 0.8), "delta": 0.005, "start": "stuck"}
    vj.follow("vibro-impact", **point, progress=False).to_netcdf(folder / "family.nc")
    weight = np.linspace(40.0, 120.0, 200)
    log = {"depth (m)": 1000 + np.arange(200.0), "WOB (kN)": weight, "ROP (m/h)": 15 * np.log(weight / 30)}
    pd.DataFrame(log | {"RPM": 120.0, "torque (kN m)": 0.05 * weight}).to_csv(folder / "log.csv", index=False)
    return folder


@pytest.mark.long
@pytest.mark.parametrize("words", COMMANDS)
def test_command_of_the_readme(words, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    before = {path.name for path in folder.iterdir()}
    assert main(shlex.split(words)) == 0, capsys.readouterr().err
    quiet = words.split()[0] in ("info", "scenes") or "--dry-run" in words
    assert quiet or {path.name for path in folder.iterdir()} > before


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
    lines = (ROOT / "tests" / "benchmarks" / "README.md").read_text().splitlines()
    line = next(line for line in lines if line.startswith(f"| {start}"))
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
SOURCES = sorted((ROOT / "notebooks").rglob("*.md"))
TEXTS = ["README.md", "CHANGELOG.md", ".github/CONTRIBUTING.md", "tests/benchmarks/README.md", "tests/hard/README.md"]


def heading_anchors(text: str) -> set[str]:
    """Return the anchors of a text's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("name", TEXTS)
def test_links_of_texts_have_targets(name):
    text = (ROOT / name).read_text()
    for to in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`]*`|^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)):
        if to.startswith(("http://", "https://", "mailto:")):
            continue
        path, _, anchor = unquote(to).partition("#")
        target = (ROOT / name).parent / path if path else ROOT / name
        assert target.exists(), to
        assert not anchor or anchor in heading_anchors(target.read_text()), to


def test_every_public_name_is_in_reference():
    text = "".join(path.read_text() for path in SOURCES if path.parent.name == "api")
    known = {name.rpartition(".")[2] for name in re.findall(r"^\.\. auto\w+:: ([\w.]+)$", text, flags=re.MULTILINE)}
    assert sorted(set(vj.__all__) - known) == [], "write these onto a page of notebooks/api"


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
