"""Plant faults in the package, one at a time, and run the tests that must find each. By hand, not in CI:

    python tests/planted_faults.py [WORD ...]      only faults whose names contain one of the words

A fault of `data/planted_faults.txt` is an error in one line that a person may well make. The tests, none of them marked
`long`, run in a copy of the repository. The script ends with the faults that were not found: there should be none.
"""

import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "tests" / "data" / "planted_faults.txt"


def main(*words: str) -> int:
    lines = [line for line in TABLE.read_text().splitlines() if line and not line.startswith("#")]
    rows = zip(lines[::3], lines[1::3], lines[2::3], strict=True)
    faults = [(*first.split(" | "), right[2:], wrong[2:]) for first, right, wrong in rows]
    chosen, missed = [fault for fault in faults if not words or any(word in fault[0] for word in words)], []
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "copy"
        unneeded = shutil.ignore_patterns(".git", ".venv", "build", "__pycache__", ".*_cache")
        shutil.copytree(ROOT, folder, ignore=unneeded, symlinks=True)
        environment = os.environ | {"PYTHONPATH": str(folder), "OPENBLAS_NUM_THREADS": "1"}
        environment |= {"PYTHONDONTWRITEBYTECODE": "1"}
        for name, file, tests, right, wrong in chosen:
            path = folder / "vibrojax" / file
            text = path.read_text()
            if text.count(right) != 1:
                raise SystemExit(f"{name}: {file} has this line {text.count(right)} times: {right}")
            path.write_text(text.replace(right, wrong))
            command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *shlex.split(tests)]
            done = subprocess.run(command, cwd=folder / "tests", env=environment, capture_output=True, text=True)
            path.write_text(text)
            if done.returncode not in (0, 1):
                raise SystemExit(f"{name}: {done.stdout[-2000:]}{done.stderr[-2000:]}")
            missed += [] if done.returncode else [name]
            print(f"{'found ' if done.returncode else 'MISSED'}  {name}: {tests}", flush=True)
    print(f"{len(chosen) - len(missed)} of {len(chosen)} faults found", *missed, sep="\n")
    return bool(missed)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
