"""Mutated designs given to the command: each is refused in one line, or begins valid work, in little time and memory.

As a script, this file runs the command on a number of mutated designs in one process, and prints what happened to each.
"""

import contextlib
import copy
import io
import json
import math
import random
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from datetime import date
from pathlib import Path
from typing import Any

import pytest

DESIGN: dict[str, Any] = {
    "scene": "vibro-impact",
    "title": "mutated",
    "maximise": "impact_power",
    "starts": ["stuck"],
    "parameters": {"beta": 0.4, "delta": 0.005},
    "vary": {"gamma": [0.7, 0.9]},
    "tolerance": {"gamma": 0.004},
    "subject": {"regime": "single-impact", "peak_impact_force": {"most": 165e3}},
    "front": {"against": "peak_impact_force", "points": 3},
    "run": {"settle": 2.0, "observe": 2.0},
}
NUMBERS = (math.nan, math.inf, -math.inf, 0, -1, 1e308, -1e308, 5e-324, 10**18, 10**400)
PAIRS = ([0.9, 0.7], [0.7, 0.7], [-1e308, 1e308], [math.nan, 1.0], [0.1, math.inf], [1e-300, 1e-299], [1, 2, 3], [])
WORDS = ("", "0,4", "5 mm", "gamma", "tolerance", "rotary", "penetration", "drilling", "period", "regime", "x" * 9999)
TABLES = ({}, {"least": math.nan}, {"least": 2, "most": 1}, {"gamma": 1e9}, {"num": 10**18}, {"gamma": [0.0, 1e9]})
ODD = (*NUMBERS, *PAIRS, *WORDS, *TABLES, True, date(2020, 1, 1), [[0.1, 0.2]], ["stuck"] * 1000, "\u202egamma")
NAMES = (
    "beta",
    "v",
    "mu",
    "k0",
    "m1",
    "rpm",
    "bit_radius",
    "bit_frequency",
    "settle",
    "chunk",
    "carry",
    "points",
    "zz",
)
TIME_S, WORK_S, MEMORY_BYTES = 10.0, 20.0, 10**9


def mutated(rng: random.Random) -> str:
    """Return the text of a design with one or two changes of values, keys or lines."""
    from vibrojax.settings.toml import render

    tables = copy.deepcopy(DESIGN)
    for _ in range(rng.randint(1, 2)):
        table = rng.choice([tables, *(x for x in tables.values() if isinstance(x, dict))])
        key = rng.choice([*table, rng.choice(NAMES)])
        change = rng.choice(["value", "value", "value", "pair", "drop", "many"])
        if change == "value":
            table[key] = rng.choice(ODD)
        elif change == "pair":
            table[rng.choice(NAMES)] = rng.choice([[0.5, 1.0], [1e-3, 1e3], rng.choice(PAIRS), rng.choice(NUMBERS)])
        elif change == "drop":
            table.pop(key, None)
        else:
            table |= {f"{rng.choice(NAMES)}{k}": 1.0 for k in range(rng.choice([3, 1000]))}
    lines = render(tables).splitlines()
    if rng.random() < 0.2:  # a key or table that is there twice
        lines.insert(rng.randrange(len(lines)), rng.choice(lines))
    return "\n".join(lines) + "\n"


class Late(BaseException):
    """The time is over."""


class Begun(BaseException):
    """The design is accepted, and its work begins."""


def read_by_command(text: str, file: Path) -> dict[str, Any]:
    """Run the command on a design until its work begins, and return what happened."""
    from vibrojax.cli import main
    from vibrojax.studies import design_evaluation as evaluation

    def stop(kind: type[BaseException]) -> Any:
        def stopped(*_: Any, **__: Any) -> None:
            raise kind

        return stopped

    file.write_text(text, encoding="utf-8")
    outcome: dict[str, Any] = {"code": None, "trace": ""}
    error, begin = io.StringIO(), time.monotonic()
    signal.signal(signal.SIGALRM, stop(Late))
    signal.setitimer(signal.ITIMER_REAL, TIME_S)
    evaluation.run_sweep = stop(Begun)
    try:
        with contextlib.redirect_stderr(error), contextlib.redirect_stdout(io.StringIO()):
            outcome["code"] = main(["design", file.name, "--quiet"])
    except (Late, Begun) as end:
        outcome["code"] = type(end).__name__
    except SystemExit as end:
        outcome["code"] = end.code
    except BaseException:
        outcome["trace"] = traceback.format_exc()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    memory = peak_memory("self")
    seconds = time.monotonic() - begin
    return outcome | {"lines": errors(error.getvalue()), "seconds": seconds, "memory": memory, "text": text}


def peak_memory(process: int | str) -> int:
    """Return the greatest memory of a process so far [bytes]; 0 if unknown. (`ru_maxrss` includes its parent's.)"""
    try:
        status = Path(f"/proc/{process}/status").read_text()
    except OSError:
        return 0
    return 1024 * int(found[1]) if (found := re.search(r"VmHWM:\s*(\d+) kB", status)) else 0


def errors(text: str) -> list[str]:
    """Return the lines of an error; warnings about units have lines of their own."""
    return [
        line
        for line in text.splitlines()
        if "Warning" not in line and "UnusualValue" not in line and not line.startswith("  ")
    ]


def fault(outcome: dict[str, Any]) -> str:
    """Return what is wrong with an outcome; empty if nothing is."""
    if outcome["trace"] or any("Traceback" in line for line in outcome["lines"]):
        return "traceback"
    if outcome["seconds"] > TIME_S or outcome["code"] == "Late":
        return "hangs"
    if outcome["memory"] > MEMORY_BYTES:
        return "memory"
    refused = outcome["code"] == 2 and len(outcome["lines"]) == 1 and len(outcome["lines"][0]) < 1000
    return "" if refused or outcome["code"] == "Begun" else "not refused in one line"


def work_fault(text: str, folder: Path) -> str:
    """Run the command on an accepted design for some time, and return what is wrong; empty if nothing is."""
    (folder / "accepted.toml").write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "vibrojax", "design", "accepted.toml", "--quiet", "--fresh"]
    with (folder / "stderr").open("wb") as stderr:
        child = subprocess.Popen(command, cwd=folder, stderr=stderr, stdout=subprocess.DEVNULL)
        timer = threading.Timer(WORK_S, child.kill)
        timer.start()
        memory = 0
        while child.poll() is None:
            memory = max(memory, peak_memory(child.pid))
            time.sleep(0.05)
        timer.cancel()
    lines = errors((folder / "stderr").read_text(errors="replace"))
    ends = child.returncode in (0, -signal.SIGKILL) or (child.returncode == 2 and len(lines) == 1)
    return "" if ends and memory < MEMORY_BYTES else f"{child.returncode} {memory} {lines}"


@pytest.mark.parametrize(("seed", "count"), [(0, 15), pytest.param(1, 200, marks=pytest.mark.long)])
def test_mutated_designs_are_refused_or_begin(seed, count, tmp_path):
    command = [sys.executable, __file__, str(seed), str(count)]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60 + 15 * count, check=True)
    outcomes = [json.loads(line) for line in run.stdout.splitlines()]
    assert len(outcomes) == count and sum(outcome["code"] == 2 for outcome in outcomes) > count / 2
    assert [(fault(outcome), outcome) for outcome in outcomes if fault(outcome)] == []
    accepted = [outcome["text"] for outcome in outcomes if outcome["code"] == "Begun"]
    assert [(wrong, text) for text in accepted if (wrong := work_fault(text, tmp_path))] == []


if __name__ == "__main__":
    choices = random.Random(int(sys.argv[1]))
    with tempfile.TemporaryDirectory() as here, contextlib.chdir(here):
        for _ in range(int(sys.argv[2])):
            print(json.dumps(read_by_command(mutated(choices), Path(here, "mutated.toml"))), flush=True)
