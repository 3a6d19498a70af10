"""Compare the time to join finished chunks into a dataset with that of writing the same bytes alone.

    python tests/benchmarks/joining.py [LANES [FOLDER]]

The chunks of a map of LANES lanes (2,000,000) are written to FOLDER (the current one), as repeated copies of the first
ones. Then, three times in turn, the bytes of the dataset are written to a file as `dd conv=fsync` does, and the chunks
are joined. A printout, not a test: bytes per second of wall time, and the processor time.

Nothing else should run meanwhile. The chunks should still be in the file cache, as after a sweep; otherwise they are
read from disk.
"""

import os
import sys
import tempfile
import time
from pathlib import Path

from vibrojax.io.targets import file_target
from vibrojax.maps.joining import join
from vibrojax.maps.read import read_sweep
from vibrojax.maps.shards import Shards
from vibrojax.maps.work import Work

COMPUTED = 16
"""Number of chunks that are computed."""


def taken(what, *given) -> tuple[float, float]:
    """Return the wall time and the processor time of a call [s]."""
    clock, processor = time.monotonic(), time.process_time()
    what(*given)
    return time.monotonic() - clock, time.process_time() - processor


def written(path: Path, size: int) -> None:
    """Write `size` bytes that no disk can compress."""
    block = os.urandom(1 << 20)
    with open(path, "wb") as file:
        for _ in range(size >> 20):
            file.write(block)
        file.flush()
        os.fsync(file.fileno())


def main(lanes: int = 2_000_000, at: str = ".") -> None:
    grid = {
        "beta": {"start": 0.25, "stop": 0.6, "num": lanes // 1000},
        "gamma": {"start": 0.6, "stop": 0.8, "num": 1000},
    }
    sweep = read_sweep({"scene": "vibro-impact", "starts": ["stuck"], "grid": grid})
    work = Work(sweep)
    count = work.chunks.count
    some = [work.compute(index) for index in range(0, count, -(-count // COMPUTED))]
    with tempfile.TemporaryDirectory(dir=at) as folder:
        out = Path(folder) / "out.nc"

        def joined() -> None:
            with file_target(out) as target:
                join(sweep, work.chunks, shards.read, target, lambda seconds: seconds)

        with Shards(Path(folder) / "out.nc.chunks", sweep.identity()) as shards:
            shards.open(resume=False)
            for index in range(count):
                width = work.chunks.width(index)
                features = {name: x[:width] if x.ndim else x for name, x in some[index % len(some)].items()}
                shards.write(index, features)
            read = sum(path.stat().st_size for path in shards.folder.iterdir())
            joined()  # the first call compiles
            size = out.stat().st_size
            print(f"{lanes} lanes, {count} chunks of {read / 1e6:.0f} MB together; dataset {size / 1e6:.0f} MB")
            for _ in range(3):
                for name, what, given in (
                    ("plain write", written, (Path(folder) / "plain", size)),
                    ("joining", joined, ()),
                ):
                    clock, processor = taken(what, *given)
                    print(
                        f"{name:12} {clock:6.2f} s, {size / clock / 1e6:5.0f} MB/s; processor {processor:6.2f} s",
                        flush=True,
                    )
            shards.remove()


if __name__ == "__main__":
    main(*(int(one) if one.isdecimal() else one for one in sys.argv[1:]))
