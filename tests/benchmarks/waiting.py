"""Measure what a user waits for, and the cost of a lane beside compiled loops, in rounds that alternate.

    python tests/benchmarks/waiting.py [ROUNDS]

A printout, not a test. Nothing else should run meanwhile; ten rounds take six minutes. It prints medians and ranges
of the time of fresh processes [s] and of lanes on one core [µs per lane-second]. Numba's loop and heyoka measure two
numbers and do not check themselves.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time

COMMAND = (sys.executable, "-m", "vibrojax")
RUN = {"end_early": False, "settle": 12.0, "observe": 4.0}
SYSTEM = """
import numpy as np, vibrojax as vj
system = vj.System("oscillator", states={"x": "m", "v": "m s-1"}, parameters={"omega": 2.0, "d": 0.5},
    field=lambda t, y, p: {"x": y["v"], "v": 0.5 * vj.elementary.cos(p["omega"] * t) - 0.1 * y["v"] - y["x"]},
    period=lambda p: 2 * np.pi / p["omega"],
    events=[vj.Impact("stop", gap=lambda t, y, p: p["d"] - y["x"], velocity="v", restitution=lambda p: 0.8)])
vj.simulate(system, start=[0.0, 0.0], duration=50.0)
"""
AS_JAX = """
import jax.numpy as jnp, vibrojax as vj
f = vj.as_jax("vibro-impact", of=["impact_velocity"], by=["beta", "gamma"], start="stuck", delta=0.005)
f(jnp.array([0.4, 0.75]))["impact_velocity"].block_until_ready()
"""


def lanes() -> None:
    """Print the rows of one process as JSON, each time it reads a line."""
    import numpy as np
    from peers import _peer

    _peer.CORES = 1
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:1])
    from peers import heyoka_batch, numba_loop
    from peers.lanes import box, columns

    import vibrojax as vj

    heyoka_batch.CORES = numba_loop.CORES = 1
    points = box()[np.arange(2048)]
    few = box()[np.arange(512)]

    def ours(error: float) -> float:
        table = {"scene": "vibro-impact", "points": columns(points), "run": RUN | {"error": error}}
        began = time.perf_counter()
        vj.run_sweep(table, progress=False)
        return (time.perf_counter() - began) / len(points) / 16

    def ended_early() -> float:
        table = {"scene": "vibro-impact", "points": columns(points)}
        began = time.perf_counter()
        vj.run_sweep(table, progress=False)
        return (time.perf_counter() - began) / len(points) / 48

    def small(number: int) -> float:
        axes = {"beta": (0.1, 1.2, 20), "gamma": (0.3, 1.2, number // 40)}
        grid = {name: dict(zip(("start", "stop", "num"), axis, strict=True)) for name, axis in axes.items()}
        run = {"settle": 3.0, "observe": 2.0}
        began = time.process_time()
        vj.run_sweep({"scene": "vibro-impact", "grid": grid, "starts": ["drive", "stuck"], "run": run}, progress=False)
        return 1e-6 * number / (time.process_time() - began)

    loop, batches = numba_loop.NumbaTaylor(), heyoka_batch.Heyoka()

    def peer(runner, setting, some) -> float:
        return runner.run(some, setting, 12.0, 4.0, 1).seconds / len(some) / 16

    rows = {f"ours, {error:g}": lambda error=error: ours(error) for error in (1e-4, 1e-9, 1e-12)}
    rows["ours, 0.0001, 48 s, settled lanes ended early"] = ended_early
    rows |= {"lanes per s, 1,000": lambda: small(1000), "lanes per s, 10,000": lambda: small(10000)}
    if not loop.missing():
        settings = [(8, 1.2), (12, 1.0), (16, 1.0)]
        rows |= {
            f"numba, order {o}, stride {s}": lambda o=o, s=s: peer(loop, numba_loop.Series(o, s), points)
            for o, s in settings
        }
    if not batches.missing():
        rows |= {f"heyoka, {t:g}": lambda t=t: peer(batches, heyoka_batch.Batch(t, 64), few) for t in (1e-5, 1e-9)}
    for row in rows.values():
        row()  # compiles
    for _ in sys.stdin:
        print(json.dumps({name: 1e6 * row() for name, row in rows.items()}), flush=True)


def process(command: tuple[str, ...], environment: dict[str, str], folder: str) -> float:
    began = time.perf_counter()
    subprocess.run(command, env=os.environ | environment, cwd=folder, check=True, capture_output=True)
    return time.perf_counter() - began


def main(rounds: int) -> None:
    found: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        caches = {"VIBROJAX_CACHE": f"{folder}/kernels", "JAX_COMPILATION_CACHE_DIR": f"{folder}/jax"}
        commands = {
            "import jax": (sys.executable, "-c", "import jax"),
            "vibrojax --help": (*COMMAND, "--help"),
            "default map, warm": (*COMMAND, "sweep", "regime-map", "--fresh"),
            "info FILE": (*COMMAND, "info", "regime-map.nc"),
            "scenes": (*COMMAND, "scenes"),
            "plot MAP": (*COMMAND, "plot", "regime-map.nc"),
            "second simulate": (*COMMAND, "simulate", "vibro-impact", "gamma=0.75", "--fresh"),
            "own system, second process": (sys.executable, "-c", SYSTEM),
            "as_jax, second process": (sys.executable, "-c", AS_JAX),
        }
        first = {
            "default map, cold": commands["default map, warm"],
            "own system, first": commands["own system, second process"],
            "as_jax, first": commands["as_jax, second process"],
        }
        for command in commands.values():
            process(command, caches, folder)
        child = subprocess.Popen(
            (sys.executable, __file__, "--lanes"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | caches,
        )
        for number in range(rounds):
            for name, command in commands.items():
                found.setdefault(name, []).append(process(command, caches, folder))
            for name, command in first.items():
                with tempfile.TemporaryDirectory() as empty:
                    bare = {"VIBROJAX_CACHE": f"{empty}/kernels", "JAX_COMPILATION_CACHE_DIR": f"{empty}/jax"}
                    found.setdefault(name, []).append(process(command, bare, folder))
            child.stdin.write("\n")
            child.stdin.flush()
            for name, value in json.loads(child.stdout.readline()).items():
                found.setdefault(name, []).append(value)
            print(f"round {number + 1}", file=sys.stderr, flush=True)
        child.stdin.close()
    for name, values in found.items():
        print(f"{name:32} {statistics.median(values):8.3g}  ({min(values):.3g} to {max(values):.3g})")


if __name__ == "__main__":
    lanes() if sys.argv[1:] == ["--lanes"] else main(int((sys.argv[1:] or ["10"])[0]))
