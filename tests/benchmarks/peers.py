"""Time per simulated lane-second at the same error: vibrojax and its peers in one run, as one table.

    python tests/benchmarks/peers.py [--quick] [-o FILE] [--only NAME ...]

Nothing else should run meanwhile. It takes several minutes on two cores; --quick is a trial run under one minute.
"""

import argparse
import os
import sys
from pathlib import Path

from peers._peer import CORES
from peers.diffrax_events import DiffraxEvents
from peers.diffrax_smoothed import DiffraxAdaptive, DiffraxFixed
from peers.heyoka_batch import Heyoka
from peers.lanes import judged
from peers.numba_loop import NumbaDormandPrince, NumbaTaylor
from peers.ours import Ours
from peers.race import raced
from peers.scipy_events import Scipy
from peers.simd import Simd
from peers.table import table

from vibrojax.studies.accuracy import machine

PEERS = (NumbaTaylor, NumbaDormandPrince, Heyoka, Simd, DiffraxAdaptive, DiffraxFixed, DiffraxEvents, Scipy)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few settings and lanes, short times")
    parser.add_argument("-o", metavar="FILE", type=Path, help="also write the table there, as Markdown")
    parser.add_argument("--only", nargs="+", metavar="NAME", default=[""], help="peers whose names hold one of these")
    asked = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:CORES])
    settle, observe = (4.0, 2.0) if asked.quick else (12.0, 4.0)
    ours = Ours()  # compiled first, since the reference uses the same program
    known = judged(32, 8, settle, observe, settled=1e-2) if asked.quick else judged(192, 32, settle, observe)
    peers = [ours] + [peer() for peer in PEERS if any(name in peer.name for name in asked.only)]
    results = [raced(peer, known, settle, observe, asked.quick) for peer in peers]
    text = table(results, known, settle, observe, machine(), CORES)
    print(text)
    if asked.o:
        asked.o.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
