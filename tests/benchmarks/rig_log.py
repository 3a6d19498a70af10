"""Measure the processor time to read and fit a rig log of 7,310 rows: `python tests/benchmarks/rig_log.py`.

The first fit includes imports and first calls. The goal was 3 s.
"""

import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "notebooks"))

import rig_logs

import vibrojax as vj

with tempfile.TemporaryDirectory() as folder:
    path = rig_logs.write(Path(folder) / "log.csv", "pason-processed", rig_logs.with_traps(rig_logs.drilling(7304))[0])
    for turn in ("first", "second", "third"):
        begin = time.process_time()
        rows = vj.fit_rop(path, progress=False).attrs["rows_read"]
        print(f"{turn} fit of {rows} rows: {time.process_time() - begin:.2f} s")
