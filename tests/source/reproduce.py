"""Compare each table and figure of the source that the model can reproduce with its result: a page and a table.

    python tests/source/reproduce.py -o DIR [--quick]

This writes `DIR/index.html`, `DIR/table.md` and the datasets of the maps. It takes about one minute on two cores and
needs an installed vibrojax. `tests/source/table.md` is the table of the whole run, which the site shows.
"""

import argparse
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # the modules of this folder are the package `source`

from source.page import write_reproduction  # noqa: E402
from source.reproduction import run_reproduction  # noqa: E402
from vibrojax.errors import InputError  # noqa: E402


def main() -> int:
    """Return the exit status: 0, or 2 if the folder cannot be written."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", metavar="DIR", type=Path, default=Path("reproduction"), help="folder (reproduction)")
    parser.add_argument("--quick", action="store_true", help="only what half a minute answers")
    parser.add_argument("--quiet", action="store_true", help="neither progress nor score")
    options = parser.parse_args()
    try:
        options.o.mkdir(parents=True, exist_ok=True)
        reproduction = run_reproduction(quick=options.quick, progress=not options.quiet)
        write_reproduction(reproduction, options.o)
    except (InputError, OSError) as error:
        print(f"reproduce.py: {error}", file=sys.stderr)
        return 2
    if not options.quiet:
        score = ", ".join(f"{count} {verdict}" for verdict, count in reversed(reproduction.score.items()))
        print(f"{options.o / 'index.html'}: {len(reproduction.results)} results: {score}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
