"""Measure ns per lane-step and lane-seconds per second, for both steppers, on one and two cores.

    python tests/benchmarks/lane_steps.py [--platform NAME]

A printout, not a test. The lanes cover the regime map. With `--platform`, XLA compiles the lanes for jax's devices of
that platform, such as gpu, with the settings for accelerators. `--platform cpu` thus shows on a CPU what an accelerator
would run.
"""

import argparse
import platform
import statistics
import time
from pathlib import Path

import jax
import numpy as np

import vibrojax as vj
from vibrojax.compile.xla import usable_cores
from vibrojax.lanes.compiler import Programs
from vibrojax.lanes.inputs import LaneInputs
from vibrojax.lanes.run import LaneRun
from vibrojax.maps.read import read_sweep

REPEATS = 3
SETTLE, OBSERVE = 12.0, 8.0  # s
CASES = {  # name: lanes, [run]
    "located, error 1e-2": (2048, {"method": "located", "error": 1e-2}),
    "located, error 1e-4": (2048, {"method": "located", "error": 1e-4}),
    "smoothed, width 1e-3 m/s, step 1e-4 s": (128, {"method": "smoothed", "smoothing": 1e-3, "step": 1e-4}),
}


ROTARY = vj.System(
    "own-rotary",
    states={"x1": "m", "v1": "m s-1", "x2": "m", "v2": "m s-1"},
    parameters={"m1": 250.0, "beta": 0.4, "gamma": 0.75, "k1": 156250.0, "c2": 250.0, "v": 1.5},
    field=lambda t, y, p: {
        "x1": y["v1"],
        "v1": (-p["k1"] * y["x1"] - p["beta"] * p["gamma"] ** 2 * p["k1"] * (y["x1"] - y["x2"])) / p["m1"],
        "x2": y["v2"],
        "v2": (-p["c2"] * y["v2"] - p["beta"] * p["gamma"] ** 2 * p["k1"] * (y["x2"] - y["x1"]))
        / (p["beta"] * p["m1"]),
    },
    section="v1",
    events=[
        vj.Friction(
            "bit",
            relative=lambda t, y, p: y["v1"] + p["v"],
            normal=lambda t, y, p: 9.81 * p["m1"],
            law="stribeck",
            acts_on="v1",
            mass=lambda p: p["m1"],
        )
    ],
)
"""The scene `rotary`, written as a system."""


def sweep(lanes: int, run: dict):
    """Return a sweep of `lanes` points over the regime map, with the two starts in turn."""
    rows = 16
    columns = lanes // rows
    beta, gamma = np.meshgrid(np.linspace(0.1, 1.2, rows), np.linspace(0.3, 1.2, columns), indexing="ij")
    starts = ["stuck" if (row + column) % 2 else "drive" for row in range(rows) for column in range(columns)]
    points = {"beta": beta.ravel().tolist(), "gamma": gamma.ravel().tolist(), "start": starts}
    times = {"settle": SETTLE, "observe": OBSERVE, "chunk": lanes}
    return read_sweep({"scene": "vibro-impact", "points": points, "run": times | run})


def once(run: LaneRun, inputs: LaneInputs) -> tuple[float, float]:
    """Return the time of one run of the lanes [s], without a check run, and its number of lane-steps."""
    began = time.perf_counter()
    found = run.at(inputs, run.accuracy)
    return time.perf_counter() - began, float(found["steps"].sum())


def as_on_accelerator(run: LaneRun) -> LaneRun:
    """Return the run, set up for XLA with the settings for accelerators, on all devices of jax's platform."""
    engine, devices = run.engine, jax.local_devices()
    engine.workers, engine.accelerated = devices, True
    engine.programs = Programs(engine.programs.kind, np.dtype(run.settings.precision), "accelerator")
    return run


def rotary(scene, lanes: int = 3000):
    """Return a sweep of `rotary`, or of the same equations as a system."""
    grid = {"gamma": {"start": 0.4, "stop": 1.2, "num": 60}, "beta": {"start": 0.2, "stop": 0.8, "num": lanes // 60}}
    starts, times = [[0.0, -1.5, 0.0, 0.0]], {"settle": SETTLE, "observe": OBSERVE, "error": 1e-4, "chunk": lanes}
    return read_sweep({"scene": scene, "grid": grid, "starts": starts, "run": times})


def measured(definition, cores: int, accelerator: bool = False) -> dict:
    """Return the compile time, and the cost of a lane-step and the lane-seconds per second of the median run."""
    inputs, lanes = definition.inputs(), definition.lanes
    run = LaneRun(inputs, definition.plan)
    if accelerator:
        as_on_accelerator(run)
    run.engine.workers = run.engine.workers[:cores]
    began = time.perf_counter()
    run.compile(inputs)
    compiling = time.perf_counter() - began
    found = [once(run, inputs) for _ in range(REPEATS)]
    seconds, steps = [time for time, _ in found], found[0][1]
    median = statistics.median(seconds)
    return {
        "lanes": lanes,
        "compile_s": compiling,
        "run_s": median,
        "spread": (max(seconds) - min(seconds)) / median,
        "ns": 1e9 * median / steps,
        "lane_seconds": lanes * (SETTLE + OBSERVE) / median,
        "steps_per_second": steps / lanes / (SETTLE + OBSERVE),
    }


def processor() -> str:
    """Return the name of the processor."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--platform")
    if chosen := parser.parse_args().platform:
        jax.config.update("jax_platforms", chosen)
    most = len(jax.local_devices()) if chosen else min(2, usable_cores())
    found = {}
    where = f"{jax.devices()[0].device_kind}, {len(jax.local_devices())} devices" if chosen else processor()
    print(f"{where}, {usable_cores()} cores, Python {platform.python_version()}, jax {jax.__version__}")
    print(f"{SETTLE + OBSERVE:g} s of each lane, float64, median of {REPEATS} runs\n")
    titles = ("", "cores", "lanes", "compile s", "run s", "spread", "steps/s", "ns/lane-step", "lane-s/s")
    print("{:<40}{:>8}{:>7}{:>11}{:>8}{:>8}{:>9}{:>14}{:>10}".format(*titles))
    for name, (lanes, run) in CASES.items():
        for cores in range(1, most + 1):
            it = found[name, cores] = measured(sweep(lanes, run), cores, bool(chosen))
            print(
                f"{name:<40}{cores:>8}{it['lanes']:>7}{it['compile_s']:>11.1f}{it['run_s']:>8.2f}"
                f"{it['spread']:>8.0%}{it['steps_per_second']:>9.0f}{it['ns']:>14.0f}{it['lane_seconds']:>10.0f}"
            )
    _, located, smoothed = CASES
    print()
    for name in CASES:
        if (name, 2) in found:
            gain = found[name, 2]["lane_seconds"] / found[name, 1]["lane_seconds"]
            print(f"two cores over one, {name}: {gain:.2f}")
    for cores in sorted({cores for _, cores in found}):
        gain = found[located, cores]["lane_seconds"] / found[smoothed, cores]["lane_seconds"]
        print(f"lane-seconds per second, located over smoothed, on {cores}: {gain:.1f}")
    if chosen:
        return
    system, scene = (measured(rotary(scene), 1)["run_s"] for scene in (ROTARY, "rotary"))
    print(f"time of the same lanes, rotary as a System over the scene rotary, on 1: {system / scene:.2f}")


if __name__ == "__main__":
    main()
