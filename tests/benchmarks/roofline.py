"""Print the operations and memory accesses of the compiled loops, waiting lanes, and the resulting bound.

    python tests/benchmarks/roofline.py

A printout, not a test. It needs objdump. With numba, it also runs the loop that is compiled for this scene alone, on
the same lanes in turn. All times are processor times of one thread.
"""

import os

os.environ |= {"VIBROJAX_THREADS": "1", "VIBROJAX_CACHE": "off"}  # a kernel found in the cache has no text

import re
import statistics
import subprocess
import tempfile
import time
from collections import Counter
from pathlib import Path

import lane_steps
import numpy as np
from peers.lanes import box, columns
from peers.numba_loop import NumbaTaylor, Series, numba

from vibrojax.compile import native
from vibrojax.lanes.compiler import KERNEL_REGISTERS
from vibrojax.lanes.programs import observe_lanes, settle_lanes
from vibrojax.lanes.run import LaneRun
from vibrojax.maps.read import read_sweep
from vibrojax.measures.recorder import STEPS_PER_PASS, STEPS_PER_TURN
from vibrojax.stepping.polynomial import ROOT_ITERATIONS

REPEATS, LANES = 5, 2048
SETTLE, OBSERVE = 12.0, 4.0  # s
STRIDES = (1.6, 1.2, 0.7)
VECTOR_PORTS, DIVISION = 2, {64: 16, 32: 8, 16: 4}
"""Vector operations that start per cycle, and cycles of a division of doubles by the bytes of the vector, on Intel's
processors since Ice Lake (uops.info)."""

KINDS = {
    "products and sums": r"vf(n)?m(add|sub)|v(add|sub|mul)[ps]",
    "divisions and roots": r"v(div|sqrt)p",
    "comparisons, choices, masks": r"v(cmp|min|max|blend|range|pcmp|ptest)|k(and|or|not|xor|unpck|shift|mov)",
    "other vector operations": r"v(?!mov|broadcast)",
}


def loops(code: bytes) -> list[tuple[int, list[tuple[str, str]]]]:
    """Return the loops of a kernel in the order of their code: address and instructions with their operands."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "kernel.o"
        path.write_bytes(code)
        text = subprocess.run(["objdump", "-d", "--no-show-raw-insn", path], capture_output=True, text=True, check=True)
    body = text.stdout.split("<lanes>:")[0]
    lines = [(int(a, 16), op, rest) for a, op, rest in re.findall(r"^\s*([0-9a-f]+):\s+(\S+)\s*(.*)$", body, re.M)]
    jumps = [(a, int(rest.split()[0], 16)) for a, op, rest in lines if op.startswith("j") and "<group" in rest]
    backwards = dict(sorted((target, a) for a, target in jumps if target < a))  # the last jump ends a loop
    return [(first, [(op, rest) for a, op, rest in lines if first <= a <= last]) for first, last in backwards.items()]


def operations(instructions: list[tuple[str, str]]) -> Counter:
    counts: Counter = Counter()
    for op, rest in instructions:
        kind = next((kind for kind, pattern in KINDS.items() if re.match(pattern, op)), None)
        counts[kind or "other"] += 1
        counts["accesses"] += "(" in rest and not op.startswith("lea")
    return counts


def per_step(kernel: native.Kernel, steps: int) -> Counter:
    """Return the operations of a group's step, with its share of the outer loop and all of Newton's iterations."""
    (_, outer), (_, step), (_, newton), *_ = loops(native._object_code(kernel.description.text.text))
    counts = [operations(part) for part in (outer, step, newton)]

    def total(name: str) -> float:
        outside, inside, iteration = (count[name] for count in counts)
        return (outside - inside) / steps + inside + (ROOT_ITERATIONS - 1) * iteration

    return Counter({name: total(name) for name in set().union(*counts)})  # type: ignore[arg-type]


def timed(work):
    began = time.process_time()
    result = work()
    return time.process_time() - began, result


def waiting(recent: np.ndarray, order: np.ndarray, width: int) -> float:
    """Return the share of a kernel's lane-steps in which a lane only waits for the slowest of its group."""
    groups = recent[order][: len(order) // width * width].reshape(-1, width)
    return 1 - groups.sum() / (groups.max(axis=1) * width).sum()


def kernels() -> None:
    """Print both loops' operations, their bound, and the measured cost."""
    sweep = lane_steps.sweep(LANES, {"method": "located", "error": 1e-2})
    inputs = sweep.inputs()
    lanes = LaneRun(inputs, sweep.plan)
    engine = lanes.engine
    lanes.compile(inputs)
    engine.observe([engine.settle([engine.start(inputs, lanes.accuracy)])[0]])
    rows: dict[str, list[tuple[float, float, float]]] = {"settle": [], "observe": []}
    group = max(KERNEL_REGISTERS.values()) * native.vector_bytes() // 8
    for _ in range(REPEATS):
        # lanes are then sorted by speed
        batch = engine.settle([engine.start(inputs, lanes.accuracy)], SETTLE / 4)[0]
        order, before = np.argsort(-batch.recent, kind="stable"), batch.underway.steps.sum()
        seconds, [batch] = timed(lambda batch=batch: engine.settle([batch]))
        rows["settle"].append((seconds, batch.underway.steps.sum() - before, waiting(batch.recent, order, group)))
        order, before = np.argsort(-batch.recent, kind="stable"), batch.underway.steps
        seconds, [features] = timed(lambda batch=batch: engine.observe([batch]))
        steps = features["steps"] - before
        rows["observe"].append((seconds, steps.sum(), waiting(steps, order, native.vector_bytes() // 8)))
    by_function = {key[0]: kernel for key, kernel in native.kernels.items()}
    for name, function, turn in (("settle", settle_lanes, STEPS_PER_PASS), ("observe", observe_lanes, STEPS_PER_TURN)):
        kernel = by_function[function]
        counts, width = per_step(kernel, turn), kernel.description.width
        vectors = sum(counts[kind] for kind in KINDS)
        divisions = counts["divisions and roots"] * DIVISION[native.vector_bytes()]
        seconds, steps, idle = (statistics.median(x) for x in zip(*rows[name], strict=True))
        print(f"{name}: groups of {width} lanes")
        for kind in KINDS:
            print(f"  {kind:<30}{counts[kind] / width:>8.1f} instructions per lane-step")
        print(f"  {'memory accesses':<30}{counts['accesses'] / width:>8.1f}")
        ports = vectors / VECTOR_PORTS
        print(f"  bound by vector ports {ports / width:.0f} cycles, by divisions {divisions / width:.0f}")
        memory = kernel.description.text
        print(f"  workspace {memory.fixed / 1024:.0f} KiB and {memory.per_lane} bytes per lane of a call")
        print(f"  measured {1e9 * seconds / steps:.1f} ns per lane-step, {idle:.0%} of it waiting for the group\n")


def loop() -> None:
    """Print the times of the loop compiled for this scene and of ours, without certificate, on the same lanes."""
    points = box()[np.arange(LANES)]
    run = {"error": 1e-1, "settle": SETTLE, "observe": OBSERVE, "chunk": LANES}
    sweep = read_sweep({"scene": "vibro-impact", "points": columns(points), "run": run})
    inputs = sweep.inputs()
    lanes = LaneRun(inputs, sweep.plan)
    lanes.compile(inputs)
    numba.set_num_threads(1)
    peer, programs = NumbaTaylor(), {}
    for stride in STRIDES:
        programs[stride] = peer.program_of(Series(8, stride))
        programs[stride][0](*points[np.arange(2)].columns, 0.01, 0.01, stride)
    lanes.at(inputs, lanes.accuracy)
    times: dict[str, list[float]] = {}
    steps: dict[str, float] = {}
    for _ in range(REPEATS):
        seconds, features = timed(lambda: lanes.at(inputs, lanes.accuracy))
        times.setdefault("here", []).append(seconds)
        steps["here"] = features["steps"].sum()
        for stride, (program, value) in programs.items():
            name = f"loop, stride {stride}"
            arguments = (*points.columns, SETTLE, OBSERVE, value)
            seconds, table = timed(lambda program=program, arguments=arguments: program(*arguments))
            times.setdefault(name, []).append(seconds)
            steps[name] = table[:, 2].sum()
    lane_seconds = LANES * (SETTLE + OBSERVE)
    for name, seconds in times.items():
        median = statistics.median(seconds)
        ratio, rate = statistics.median(times["here"]) / median, steps[name] / lane_seconds
        cost = f"{1e6 * median / lane_seconds:.2f} µs per lane-second, {1e9 * median / steps[name]:.0f} ns per step"
        print(f"{name:<18}{cost}, {rate:.1f} steps per second, ratio {ratio:.2f}")


if __name__ == "__main__":
    kernels()
    if numba is None:
        print("the compiled loop: numba is not installed")
    else:
        loop()
