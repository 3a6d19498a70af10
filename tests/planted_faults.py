"""Plant faults in the package, one at a time, and run the tests that must find each. By hand, not in CI:

    python tests/planted_faults.py [WORD ...]      only faults whose names contain one of the words

A fault of `data/planted_faults.txt` is one line of the source with an error that a person may well make: a sign, a law,
an order of events, a unit, a rule of a kernel, a check of stored results. The tests run in a copy of the repository,
and none of them is marked `long`. The script ends with the faults that were not found, of which there should be none.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]


class Fault(NamedTuple):
    name: str
    file: str  # in vibrojax/
    tests: str  # in tests/, with options of pytest
    right: str
    wrong: str


TABLE = ROOT / "tests" / "data" / "planted_faults.txt"


def faults() -> list[Fault]:
    lines = [line for line in TABLE.read_text().splitlines() if line and not line.startswith("#")]
    rows = zip(lines[::3], lines[1::3], lines[2::3], strict=True)
    return [Fault(*first.split(" | "), right[2:], wrong[2:]) for first, right, wrong in rows]


def is_found(fault: Fault, folder: Path) -> bool:
    """Return whether a test fails with the fault."""
    path = folder / "vibrojax" / fault.file
    text = path.read_text()
    if text.count(fault.right) != 1:
        raise SystemExit(f"{fault.name}: {fault.file} has this line {text.count(fault.right)} times: {fault.right}")
    path.write_text(text.replace(fault.right, fault.wrong))
    command = f"{sys.executable} -m pytest -x -q -p no:cacheprovider {fault.tests}"
    environment = os.environ | {"PYTHONPATH": str(folder), "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(
            command, shell=True, cwd=folder / "tests", env=environment, capture_output=True, text=True, check=False
        )
    finally:
        path.write_text(text)
    if done.returncode not in (0, 1):
        raise SystemExit(f"{fault.name}: {done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.returncode == 1


def main(*words: str) -> int:
    chosen = [fault for fault in faults() if not words or any(word in fault.name for word in words)]
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "copy"
        unneeded = shutil.ignore_patterns(".git", ".venv", "build", "__pycache__", ".*_cache")
        shutil.copytree(ROOT, folder, ignore=unneeded, symlinks=True)
        missed = []
        for fault in chosen:
            found = is_found(fault, folder)
            missed += [] if found else [fault.name]
            print(f"{'found ' if found else 'MISSED'}  {fault.name}: {fault.tests}", flush=True)
    print(f"{len(chosen) - len(missed)} of {len(chosen)} faults found", *missed, sep="\n")
    return bool(missed)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
