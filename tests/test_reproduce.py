"""Test the registry of the source's results, the verdicts, and the page and table of a quick run."""

import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from source.computations import Need, SourceAnswers, Unanswered, read_needs
from source.page import write_reproduction
from source.reproduction import EXPRESSIONS, FINDINGS, GROUPS, READINGS, ROWS, Entry, compiled, judged, run_reproduction
from source.rules import AGREES, DIFFERS, FIELD, IN_TREND, VERDICTS, number, printed, trend, within_range
from wrong_signs import WRONG

from vibrojax.explorer.write import content_policy
from vibrojax.scenes import SCENES

SOURCE = Path(__file__).parent / "source"
ENTRIES = {entry.id: entry for group in GROUPS for entry in group.entries}

EXPECTED = {  # from an independent event-exact integrator (model, section 5): leading number of `here`, and tolerance
    "table-5.3.2": (29.11, 0.01),
    "table-5.3.3": (27.80, 0.01),
    "table-5.3.4": (26.82, 0.01),
    "table-5.3.5": (26.12, 0.01),
    "table-5.3.6": (25.30, 0.01),
    "table-5.3.7": (24.97, 0.01),
    "table-5.3.8": (38.44, 0.01),
    "table-5.3.9": (58.71, 0.01),
    "table-5.3.10": (77.48, 0.01),
    "table-5.3.11": (95.12, 0.01),
    "table-5.2": (6.1, 0.05),
    "fig-5.41": (3.2, 0.05),
    "fig-5.42": (np.pi, 0.1),
    "fig-5.43": (0.0, 0.1),
    "fig-5.47": (0.0241 / 0.0239, 0.02),
    "fig-5.53b": (3.86, 0.01),
    "fig-5.54a": (27.74, 0.02),
    "fig-5.66": (0.29, 0.03),  # irregular: a mean over 30 returns
    "fig-5.67b": (6.18, 0.01),
    "fig-5.70a": (3.52, 0.01),
    "fig-5.76b": (4.61, 0.01),
    "fig-5.77b": (1.5, 1e-9),
    "fig-5.77c": (1.61, 0.15),  # irregular
    "fig-5.83a": (1.0, 1e-9),
    "sec-5.6.1": (4.48, 0.01),
    "sec-5.6.2b": (0.97, 0.005),
}
EXPECTED_OF_MOTIONS = {"table-5.3.1": (30.73, 0.02), "fig-5.50a": (6.2, 0.03), "fig-5.50b": (12.35, 0.03)}
REGIMES = {  # expected text in `here`, from the same integrator
    "fig-5.65": "irregular",
    "fig-5.77a": "single-impact",
    "fig-5.77c": "irregular",
    "sec-5.6.1": "stuck` (single-impact)",
    "fig-5.80a": "1, 1, 1 impacts",
    "sec-5.6.3.3a": "single-impact",
    "fig-5.83a": "2 returns",
    "sec-5.6.2b": "1.74, 0.49",
}


@pytest.fixture(scope="module")
def quick():
    return run_reproduction(quick=True, progress=False)


@pytest.fixture(scope="module")
def folder(quick, tmp_path_factory):
    """Return the folder that is written for the quick run."""
    out = tmp_path_factory.mktemp("reproduction") / "made"
    write_reproduction(quick, out)
    return out


def table_rows(text):
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()[2:] if line.startswith("|")]


def first_number(text):
    return float(text.split()[0].rstrip(","))


def test_registry():
    ids = [entry.id for group in GROUPS for entry in group.entries]
    assert len(set(ids)) == len(ids) >= 60
    for entry in ENTRIES.values():
        assert re.fullmatch(r"(table|fig|eq|sec|app|listing)-[a-z0-9.-]+", entry.id), entry.id
        assert "|" not in entry.id + entry.what + entry.source
        assert entry.what and entry.source and entry.tolerance
        assert set(entry.readings) <= set(READINGS), entry.id
    assert {name for entry in ENTRIES.values() for name in entry.readings} == set(READINGS)
    explained = [
        name for finding in FINDINGS for name in finding.ids
    ]  # each result is explained once, under its own name
    assert len(set(explained)) == len(explained) and set(explained) <= set(ENTRIES)


def test_expressions_are_valid():
    """Braces are balanced, and expressions call only functions that exist."""
    for row in ROWS:
        assert None not in row and None not in row.values(), row["id"]  # caused by a comma without quotes
        texts = row["here"] + row["remark"]
        assert "{" not in FIELD.sub("", texts) and "}" not in FIELD.sub("", texts), row["id"]
        for expression in filter(None, [row["value"], row["rule"], *(field[1] for field in FIELD.finditer(texts))]):
            assert compiled(expression)
            called = set(re.findall(r"(?<![.\w])([a-z_]\w*)\(", expression))
            assert called <= set(EXPRESSIONS.globals), (row["id"], expression)


def test_parsing_of_needs():
    """Test lists, ranges, abbreviations, labels and maps."""
    abbreviations, maps = {"slow": "v=0.5 c2=75", "both": "one; two", "one": "rotary", "two": "rotary v=1"}, {}
    labelled = read_needs("rotary slow gamma=1:2:0.5; late: rotary slow v=2 settle=300", abbreviations, maps)
    assert [label for label, _ in labelled] == ["", "", "", "late"]
    assert [dict(need.parameters)["gamma"] for _, need in labelled[:3]] == [1.0, 1.5, 2.0]
    assert labelled[3][1] == Need("lanes", "rotary", (("c2", 75.0), ("v", 2.0)), settle=300.0)
    assert [need.parameters for _, need in read_needs("both", abbreviations, maps)] == [(), (("v", 1.0),)]
    [(_, map_need)] = read_needs("a map", {}, {"a map": "penetration zeta=1.1 k3=1e6,2e6 frequency=10:10:1"})
    assert map_need.axes == (("k3", (1e6, 2e6)), ("frequency", (10.0,))) and map_need.parameters == (("zeta", 1.1),)


@pytest.mark.parametrize(
    ("here", "verdict"),
    [
        (number(1.01, 1.0, "m", 0.02), AGREES),
        (number(1.03, 1.0, "m", 0.02), DIFFERS),
        (number(1.03, 1.0, "m", 0.02, trend=True), IN_TREND),
        (number(np.nan, 1.0, "m", 0.02), DIFFERS),
        # A value counts as agreeing from half a unit of the last digit below (rounded) to a whole unit above
        # (truncated).
        (printed(4.54, "4.6", "Hz"), DIFFERS),
        (printed(4.56, "4.6", "Hz"), AGREES),
        (printed(4.69, "4.6", "Hz"), AGREES),
        (printed(4.71, "4.6", "Hz"), DIFFERS),
        (printed(np.nan, "4.6", "Hz"), DIFFERS),
        (printed(35156.9, "35156", "N/m"), AGREES),
        (printed(35157.2, "35156", "N/m"), DIFFERS),
        (printed(4.8, "4.6", "Hz", trend=True), IN_TREND),
        (within_range(2, 3, (1, 4), "m"), AGREES),
        (within_range(3, 4.9, (1, 4), "m"), IN_TREND),
        (within_range(3, 5.1, (1, 4), "m"), DIFFERS),  # less than half of our range lies within the source's
        (within_range(5, 6, (1, 4), "m"), DIFFERS),
        (within_range(np.nan, np.nan, (1, 4), "m"), DIFFERS),
        (trend(False), DIFFERS),
    ],
)
def test_verdicts(here, verdict):
    assert here.verdict == verdict


def test_texts_of_numbers():
    assert number(1.03, 1.0, "m", 0.02).text == "1.03 m (+3.0%)"
    assert number(1.0, 1.0, "m", 0.02).text == "1 m (±0.0%)"
    assert number(35156.25, 35156.0, "N/m", 0.02).text.startswith("35156 N/m")


def test_verdict_without_data_is_differs():
    def raise_no_return(dataset):
        raise IndexError("no return")

    entry = Entry("fig-0", "what", "source", (), raise_no_return, "none")
    assert judged(entry, [xr.Dataset()]).verdict == DIFFERS
    assert judged(entry, [Unanswered("too many steps")]).verdict == DIFFERS
    assert "too many steps" in judged(entry, [Unanswered("too many steps")]).note


def test_quick_run_agrees_with_independent_integrator(quick):
    texts = {result.entry.id: result.here.text for result in quick.results}
    for name, (value, within) in EXPECTED.items():
        assert abs(first_number(texts[name]) - value) <= within, (name, texts[name])
    for name, text in REGIMES.items():
        assert text in texts[name], (name, texts[name])
    assert sum(quick.score.values()) == len(quick.results) >= 60


def test_motions_agree_with_independent_integrator():
    messages = []
    answers = SourceAnswers((need for name in EXPECTED_OF_MOTIONS for need in ENTRIES[name].needs), messages.append)
    assert [line.split()[0] for line in messages] == ["1/2", "2/2"]  # progress
    for name, (value, within) in EXPECTED_OF_MOTIONS.items():
        here = judged(ENTRIES[name], [answers[need] for need in ENTRIES[name].needs])
        assert abs(first_number(here.text) - value) <= within, (name, here.text)
        assert here.verdict == AGREES
    share = re.search(r"is ([\d.]+) of", judged(ENTRIES["fig-5.50a"], [answers[ENTRIES["fig-5.50a"].needs[0]]]).note)
    assert abs(float(share[1]) - 0.10) < 0.02


def test_table_and_datasets(quick, folder):
    assert {path.stem for path in folder.glob("*.nc")} == set(quick.datasets)
    lines = (folder / "table.md").read_text().splitlines()
    assert lines[0] == "| id | what | source | here | verdict | reading |"
    rows = table_rows("\n".join(lines))
    assert [row[0] for row in rows] == [result.entry.id for result in quick.results]
    for row in rows:
        assert len(row) == 6
        assert re.match(r"[-+]?\d", row[3]), row
        assert row[4] in VERDICTS


def test_quick_run_agrees_with_kept_table(folder):
    """The site shows `table.md` of `tests/source`; numbers of irregular motions may differ, verdicts may not."""
    kept = {row[0]: row for row in table_rows((SOURCE / "table.md").read_text())}
    assert list(kept) == list(ENTRIES)
    for row in table_rows((folder / "table.md").read_text()):
        assert [*row[:3], *row[4:]] == [*kept[row[0]][:3], *kept[row[0]][4:]]


class Page(HTMLParser):
    """Parser that checks the nesting of tags and collects references, tags and anchors."""

    VOID = ("meta", "img", "br", "link", "input")

    def __init__(self, text):
        super().__init__()
        self.open, self.references, self.tags, self.anchors = [], [], [], set()
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.references += [value for name, value in attrs if name in ("src", "href", "srcset", "data", "action")]
        self.anchors |= {value for name, value in attrs if name == "id"}
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_page_is_self_contained_and_complete(quick, folder):
    text = (folder / "index.html").read_text()
    page = Page(text)
    assert not page.open
    assert "script" not in page.tags and "link" not in page.tags
    assert "url(" not in text and "@import" not in text
    [style] = re.findall(r"<style>(.*?)</style>", text, flags=re.DOTALL)
    assert f'content="{content_policy([], [style])}"' in text and " style=" not in text
    for reference in page.references:
        assert reference.startswith("data:image/png;base64,") or reference[0] == "#"
        assert reference[0] != "#" or reference[1:] in page.anchors
    assert page.tags.count("img") >= 1
    differing = [result.entry.id for result in quick.results if result.here.verdict == DIFFERS]
    assert all(text.count(f'id="{result.entry.id}"') == 1 for result in quick.results)
    means = text[text.index("What the differences mean") : text.index("What differs")]
    assert differing and all(f'href="#{name}"' in means for name in differing)
    first = quick.score[DIFFERS] + quick.score["cannot be compared"]
    assert page.tags.count("tr") == len(quick.results) + first + text.count("<thead>")
    assert text.index("What differs") < text.index(GROUPS[0].title + "</h2>")


def test_script_refuses_invalid_folder(tmp_path):
    """The script runs from any folder and says in one line what is wrong."""
    (tmp_path / "file").write_text("")
    command = [sys.executable, str(SOURCE / "reproduce.py"), "-o", str(tmp_path / "file" / "below")]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2 and "Not a directory" in done.stderr and len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("term", ["friction", pytest.param("contact", marks=pytest.mark.long)])
def test_wrong_sign_is_detected(quick, monkeypatch, term):
    """At least a third of the results with impact turn red.

    Many lanes with a wrong sign never end, so steps are limited. With these limits, nothing turns red under the right
    signs.
    """
    monkeypatch.setattr("vibrojax.lanes.engine.LANE_MAX_STEPS", 1e4)
    monkeypatch.setattr("vibrojax.lanes.engine.LANE_MAX_RATE", 300.0)
    monkeypatch.setitem(SCENES, "vibro-impact", WRONG[term])
    groups = [group for group in GROUPS if group.name in ("frequency-ratio", "mass-ratio")]
    wrong = run_reproduction(groups, quick=True, progress=False)
    right = {result.entry.id: result.here.verdict for result in quick.results}
    red = [
        outcome.entry.id
        for outcome in wrong.results
        if outcome.here.verdict == DIFFERS and right[outcome.entry.id] != DIFFERS
    ]
    assert len(red) >= len(wrong.results) / 3
