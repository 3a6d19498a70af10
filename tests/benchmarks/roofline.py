"""Where the time of a step goes: operations and bytes of a step, what the processor could do, and lanes that wait.

    python tests/benchmarks/roofline.py

A printout, not a test: nothing is asserted. It takes half a minute. Instructions and bytes are counted in the
assembly of the time loop, which has no branches except its loops. The rates of the processor are measured with
kernels of one kind of operation each. Times are processor times of one thread.
"""

import re
import time
from collections import Counter
from statistics import median

import jax
import jax.numpy as jnp
import llvmlite.binding as llvm
import numpy as np
from lane_steps import sweep

from vibrojax.compile.kernels import native
from vibrojax.compile.xla import precision
from vibrojax.measures.recorder import STEPS_PER_PASS
from vibrojax.stepping.polynomial import ROOT_ITERATIONS
from vibrojax.sweep.engine.batch import Engine
from vibrojax.sweep.engine.chunks import Chunks

KINDS = {
    "divide": r"vdivp",
    "square root": r"vsqrtp",
    "move": r"vmov|vbroadcast|kmov|vgather|vscatter",
    "other": r"v|k",
}
"""Instructions by the beginning of their names; the first kind that fits counts."""

LANES, REPEATS, CHAINS, TURNS = 4096, 5, 16, 2000


def assembly(kernel: native.Kernel) -> list[str]:
    """The assembly of a kernel, line by line."""
    machine, module = native._machine(), llvm.parse_assembly(kernel.text.text)
    passes = llvm.create_new_module_pass_manager()
    for name in native.PASSES:
        getattr(passes, f"add_{name}_pass")()
    passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2)))
    return machine.emit_assembly(module).splitlines()


def step_of(kernel: native.Kernel) -> Counter:
    """Instructions on vectors of a step of a group of lanes by kind, and its bytes read and written.

    The time loop is a loop of passes of `STEPS_PER_PASS` steps, each of which has a loop that searches for roots.
    """
    lines, labels, loops = assembly(kernel), {}, {}
    counts = [Counter()]
    for number, line in enumerate(lines):
        if label := re.match(r"(\.LBB\w+):", line):
            labels[label[1]] = number
        jump = re.search(r"\sj\w+\s+(\.LBB\w+)", line)
        if jump and jump[1] in labels:
            loops[labels[jump[1]]] = number
        register, word = re.search(r"%(zmm|ymm|xmm)\d", line), line.strip().split("\t")[0]
        more: Counter = Counter()
        if register:
            more[next((kind for kind, names in KINDS.items() if re.match(names, word)), "other")] = 1
            if "(" in line:
                more["bytes"] = 8 if "1to" in line else {"zmm": 64, "ymm": 32, "xmm": 16}[register[1]]
        counts.append(counts[-1] + more)
    whole, step, turn = (
        Counter({kind: counts[end][kind] - counts[begin][kind] for kind in counts[end]})
        for begin, end in sorted(loops.items())[:3]
    )
    return Counter(
        {
            kind: (whole[kind] - step[kind]) / STEPS_PER_PASS + step[kind] + (ROOT_ITERATIONS - 1) * turn[kind]
            for kind in whole
        }
    )


def rate(operation) -> float:
    """Operations of one kind on a lane's numbers per second of a core."""

    def repeated(x: jax.Array) -> jax.Array:
        chains = tuple(x + k for k in range(CHAINS))
        return sum(jax.lax.fori_loop(0, TURNS, lambda _, each: tuple(operation(y) for y in each), chains))

    x = np.linspace(1.0, 2.0, 1024)
    with precision("float64"):
        kernel = native.Kernel(repeated, x)
    seconds = []
    for _ in range(REPEATS):
        began = time.thread_time()
        kernel(x)
        seconds.append(time.thread_time() - began)
    return len(x) * CHAINS * TURNS / min(seconds)


def main() -> None:
    rates = {
        "other": rate(lambda y: y * 0.999 + 0.001),  # one instruction
        "divide": rate(lambda y: 1.5 / y),
        "square root": rate(jnp.sqrt),
    }
    rates = {kind: x / 1e9 for kind, x in rates.items()}
    print("instructions per ns of a core, times lanes: " + ", ".join(f"{kind} {x:.2f}" for kind, x in rates.items()))
    chunks = Chunks(sweep(LANES, {"error": 1e-4}))
    chunks.engine.workers = chunks.engine.workers[:1]
    chunks.compile()
    time.sleep(1.0)
    spent, used, done = Counter(), Counter(), Counter()
    code = {}
    original = Engine._run

    def run(self, batches, program, report=lambda _: None):
        before = [None if b.underway is None else b.underway.steps for b in batches]
        began = time.process_time()
        results = original(self, batches, program, report)
        for batch, first, result in zip(batches, before, results, strict=True):
            if first is None:
                continue
            kind = "observe" if isinstance(result, dict) else "settle"
            steps = (result["steps"] if kind == "observe" else result.steps) - first
            bound = program(batch)
            code[kind], width = bound._kernel, bound._kernel.width
            for _, lanes in self._calls(bound, batch):
                groups = [steps[lanes[k : k + width]] for k in range(0, len(lanes), width)]
                done[kind] += sum(width * STEPS_PER_PASS * -(-int(x.max()) // STEPS_PER_PASS) for x in groups)
                used[kind] += int(sum(x.sum() for x in groups))
            spent[kind] += time.process_time() - began
        return results

    shares: dict[str, list[float]] = {}
    for _ in range(REPEATS):
        began = time.process_time()
        chunks.at(chunks.accuracy)
        shares.setdefault("all", []).append(time.process_time() - began)
    Engine._run = run
    chunks.at(chunks.accuracy)
    Engine._run = original
    for kind, kernel in code.items():
        each = 1e9 * spent[kind] / done[kind]
        print(f"\n{kind}: {kernel.width} lanes a group, {used[kind]:,} steps")
        print(f"  ns per step {1e9 * spent[kind] / used[kind]:.0f}, with those of waiting lanes {each:.0f}")
        print(f"  steps of lanes that do not wait: {used[kind] / done[kind]:.0%}")
        numbers = step_of(kernel)
        for name in (*KINDS, "bytes"):
            number = numbers[name] * (native.vector_bytes() / 8 if name != "bytes" else 1) / kernel.width
            text = f", at least {number / rates[name]:.0f} ns" if name in rates else f", {number / each:.0f} a ns"
            print(f"  {name}: {number:.0f} a step{text}")
    print(f"\nall: {1e9 * median(shares['all']) / sum(used.values()):.0f} ns per step")


if __name__ == "__main__":
    main()
