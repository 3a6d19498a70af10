"""Test the registry of the source's results, the verdicts, and the page and table of a quick run."""

import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from source.computations import SourceAnswers, Unanswered
from source.page import write_reproduction
from source.reproduction import FINDINGS, GROUPS, READINGS, Entry, judged, run_reproduction
from source.rules import AGREES, DIFFERS, IN_TREND, VERDICTS, number, printed, trend, within_range

SOURCE = Path(__file__).parent
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
