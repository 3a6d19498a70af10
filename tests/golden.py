"""Compare the results of two versions of the package, bit for bit: `python tests/golden.py --against COMMIT`.

Both versions run with this interpreter, one after the other, each run in a process of its own. A variable is equal if
its dimensions, data type and bytes are. Where it is not, the largest difference is printed, relative to the greatest
magnitude of the variable. Restructuring must leave every line equal; other changes say which lines they move.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]

SHORT = {"settle": 20.0, "observe": 5.0}
GRID = {"beta": [0.3, 0.45, 0.6], "gamma": [0.6, 0.75, 0.9], "delta": [-0.005, 0.005]}
VIBRO = {"scene": "vibro-impact", "grid": GRID, "run": SHORT}
SOBOL = {
    "sample": "sobol",
    "count": 64,
    "seed": 0,
    "box": {"x1": [-0.05, 0.05], "x2": [-0.05, 0.05], "v2": [-2.0, 2.0]},
}
POINT = {"beta": 0.4, "gamma": 0.75, "delta": 0.005}
STARTS = {"scene": "vibro-impact", "parameters": POINT, "starts": SOBOL, "run": SHORT}
FAR = [[0.01, 0.0, 0.0, -1.0], [0.0, 0.0, 0.02, 0.0]]
VECTORS = {"beta": [0.3, 0.4], "gamma": [0.7, 0.8]}
REFUSED = {"mu": [0.3, 1e300], "beta": [1e-300, 0.4]}


def sweep(vj: Any, **changes: Any) -> Any:
    return vj.run_sweep(VIBRO | changes, progress=False)


def impact_oscillator(vj: Any) -> Any:
    """Return an impact oscillator as an own system."""
    return vj.System(
        "golden-impact-oscillator",
        states={"x": "m", "v": "m s-1"},
        parameters={"zeta": 0.05, "a": 0.5, "omega": 2.0, "r": 0.8, "d": 0.5},
        field=lambda t, y, p: {
            "x": y["v"],
            "v": p["a"] * vj.elementary.cos(p["omega"] * t) - 2 * p["zeta"] * y["v"] - y["x"],
        },
        period=lambda p: 2 * np.pi / p["omega"],
        events=[vj.Impact("stop", gap=lambda t, y, p: p["d"] - y["x"], velocity="v", restitution=lambda p: p["r"])],
    )


def own_system(vj: Any) -> Any:
    grid = {"omega": {"start": 1.5, "stop": 3.0, "num": 16}}
    run = {"settle": 200.0, "observe": 100.0, "lyapunov": True}
    return vj.run_sweep(
        {"scene": impact_oscillator(vj), "grid": grid, "run": run, "starts": [[0.0, 0.0]]}, progress=False
    )


def family(vj: Any) -> Any:
    fixed = {"beta": 0.4, "delta": 0.005, "start": "stuck"}
    return vj.follow("vibro-impact", along="gamma", at=0.75, span=(0.5, 1.0), progress=False, **fixed)


def gradients(vj: Any) -> dict[str, np.ndarray]:
    import jax

    jax.config.update("jax_enable_x64", True)
    function = vj.as_jax(
        "vibro-impact", of=["impact_velocity", "period"], by=["beta", "gamma"], start="stuck", delta=0.005
    )
    points = np.array([[0.4, 0.75], [0.35, 0.7], [0.53, 0.72]])
    values = {f"value_{name}": np.asarray(x) for name, x in jax.vmap(function)(points).items()}
    slopes = jax.vmap(jax.jacfwd(lambda point: function(point)["impact_velocity"]))(points)
    return values | {"gradient": np.asarray(slopes)}


def calibration(vj: Any) -> Any:
    data = {"v": [1.2, 1.35, 1.5, 1.65, 1.8], "period": [0.230586, 0.2301, 0.229602, 0.22924, 0.228930]}
    about = {"scene": "vibro-impact", "start": "stuck", "parameters": {"delta": 0.005, "gamma": 0.75}}
    return vj.calibrate({**about, "data": data, "unknown": {"beta": [0.3, 0.5]}, "searches": 1}, progress=False)


def law(vj: Any) -> Any:
    forces = {"start": 120e3, "stop": 260e3, "num": 12}
    rates = vj.run_sweep({"scene": "penetration", "grid": {"force": forces, "frequency": [30.0, 40.0]}}, progress=False)
    return vj.fit_rop(rates, along="force")


def design(vj: Any) -> Any:
    best = vj.design({
        "scene": "vibro-impact", "maximise": "impact_energy", "vary": {"beta": [0.2, 0.7], "gamma": [0.5, 1.0]},
        "parameters": {"delta": 0.005}, "starts": ["stuck"], "subject": {"regime": "single-impact"},
        "tolerance": {"beta": 0.0025, "gamma": 0.0025},
    }, progress=False)  # fmt: skip
    return {"optimum": best["objective"].values[:1]}


def study(vj: Any) -> Any:
    vary = {"beta": [0.3, 0.5], "gamma": [0.6, 0.8], "v": [1.0, 2.0]}
    about = {"scene": "vibro-impact", "of": ["impact_energy", "blow_frequency"], "starts": ["stuck"], "vary": vary}
    return vj.study({**about, "samples": 32, "seed": 1}, progress=False)


ROTARY = {"v": [0.5, 1.0, 1.5], "gamma": [0.5, 0.8]}
ROCK = {"force": [150e3, 250e3, 350e3], "zeta": [0.05, 0.5, 1.1]}
SPEEDS = {"v": [1.0, 1.5, 2.0]}

RUNS: dict[str, Callable[[Any], Any]] = {
    "grid": lambda vj: sweep(vj),
    "chunks": lambda vj: sweep(vj, run=SHORT | {"chunk": 7}),
    "full": lambda vj: sweep(vj, run=SHORT | {"end_early": False}),
    "shared-orbits": lambda vj: vj.run_sweep(STARTS | {"run": SHORT | {"orbits": True}}, progress=False),
    "carry": lambda vj: sweep(vj, run=SHORT | {"carry": "gamma"}, starts=["stuck"]),
    "vectors": lambda vj: vj.run_sweep(
        {"scene": "vibro-impact", "points": VECTORS, "starts": FAR, "run": SHORT}, progress=False
    ),
    "penetration": lambda vj: vj.run_sweep({"scene": "penetration", "grid": ROCK}, progress=False),
    "drilling": lambda vj: vj.run_sweep(
        {"scene": "drilling", "grid": SPEEDS, "run": SHORT | {"keep_returns": 3}}, progress=False
    ),
    "coupled": lambda vj: vj.run_sweep({"scene": "coupled-drilling", "grid": SPEEDS, "run": SHORT}, progress=False),
    "float32": lambda vj: vj.run_sweep(
        {"scene": "rotary", "grid": ROTARY, "run": SHORT | {"precision": "float32"}}, progress=False
    ),
    "smoothed": lambda vj: sweep(vj, grid={"gamma": [0.7, 0.75]}, run=SHORT | {"method": "smoothed"}),
    "refused": lambda vj: vj.run_sweep(
        {"scene": "vibro-impact", "points": REFUSED, "unusual": True, "run": SHORT}, progress=False
    ),
    "own-system": own_system,
    "simulate": lambda vj: vj.simulate("vibro-impact", start="stuck", duration=5.0, progress=False, **POINT),
    "orbits": lambda vj: vj.orbits(sweep(vj), progress=False),
    "follow": family,
    "curves": lambda vj: vj.curves(family(vj), by="delta", span=(0.002, 0.01), progress=False),
    "borders": lambda vj: vj.borders(sweep(vj, grid={
        "beta": {"start": 0.3, "stop": 0.5, "num": 7}, "gamma": {"start": 0.6, "stop": 0.9, "num": 7},
    }), progress=False),
    "attractors": lambda vj: vj.attractors(vj.run_sweep(STARTS, progress=False), progress=False),
    "push": lambda vj: vj.smallest_push("vibro-impact", start="stuck", scan=32, progress=False, **POINT),
    "tolerance": lambda vj: vj.tolerance(
        "vibro-impact", progress=False, start="stuck", beta=(0.4, 0.004), gamma=(0.75, 0.008), delta=0.005
    ),
    "sensitivity": lambda vj: vj.sensitivity(sweep(vj, grid=VECTORS), progress=False),
    "as-jax": gradients,
    "study": study,
    "calibrate": calibration,
    "fit": law,
    "design": design,
}  # fmt: skip


def run(name: str, out: Path) -> None:
    """Run one entry of `RUNS` with the package that is imported, and store its variables and identity."""
    import vibrojax as vj

    result = RUNS[name](vj)
    if isinstance(result, dict):
        np.savez(out, **result)
        return
    arrays = {
        str(key): value.values if value.dtype != object else value.values.astype(str)
        for key, value in result.variables.items()
    }
    dims = {str(key): list(value.dims) for key, value in result.variables.items()}
    np.savez(out, **arrays, _dims=json.dumps(dims, sort_keys=True), _identity=str(result.attrs.get("identity", "")))


def results(tree: Path, names: list[str], folder: Path) -> None:
    """Run `names` with the package of `tree`; a file of `folder` holds each result, or the end of its error."""
    folder.mkdir(exist_ok=True)
    alike = {"OPENBLAS_NUM_THREADS": "1", "VIBROJAX_CACHE": str(folder.parent / "kernels"), "PYTHONPATH": str(tree)}
    for name in names:
        command = [sys.executable, __file__, "--run", name, "-o", str(folder / f"{name}.npz")]
        done = subprocess.run(command, env=os.environ | alike, cwd=folder, capture_output=True, text=True)
        if done.returncode:
            (folder / f"{name}.error").write_text(done.stderr.strip().splitlines()[-1])


def difference(before: np.ndarray, after: np.ndarray) -> str:
    """Return how two variables differ; empty if dimensions, data type and bytes are equal."""
    if before.dtype != after.dtype or before.shape != after.shape:
        return f"{before.dtype} {before.shape} -> {after.dtype} {after.shape}"
    if before.tobytes() == after.tobytes():
        return ""
    if before.dtype.kind not in "fiub":
        return f"{before} -> {after}"[:200]
    gap = np.abs(before.astype(float) - after.astype(float))
    undefined = int(np.sum(np.isnan(before.astype(float)) != np.isnan(after.astype(float))))
    scale = np.nanmax(np.abs(before.astype(float)), initial=0.0) or 1.0
    return f"{int(np.sum(gap > 0))} of {gap.size} differ, at most by {np.nanmax(gap, initial=0.0) / scale:.1e}" + (
        f"; {undefined} are NaN in one of them" if undefined else ""
    )


def differences(before: Path, after: Path, name: str) -> Iterator[str]:
    """Yield one line for each variable of a run that differs."""
    errors = [(tree / f"{name}.error") for tree in (before, after)]
    if any(error.exists() for error in errors):
        yield "; ".join(f"{e.parent.name}: {e.read_text() if e.exists() else 'a result'}" for e in errors)
        return
    with np.load(before / f"{name}.npz") as one, np.load(after / f"{name}.npz") as other:
        for key in sorted({*one.files, *other.files}):
            if key not in one.files or key not in other.files:
                yield f"{key}: only {'before' if key in one.files else 'after'}"
            elif text := difference(one[key], other[key]):
                yield f"{key}: {text}"


def compare(against: str, names: list[str]) -> int:
    """Print how the runs differ between a commit and this tree; return the number of runs that do."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        subprocess.run(
            ["git", "worktree", "add", "--quiet", "--detach", folder / "tree", against], cwd=ROOT, check=True
        )
        try:
            results(folder / "tree", names, folder / "before")
            results(ROOT, names, folder / "after")
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", folder / "tree"], cwd=ROOT, check=True)
        moved = 0
        for name in names:
            lines = list(differences(folder / "before", folder / "after", name))
            moved += bool(lines)
            print(f"{name}: {'equal' if not lines else ''}", *lines, sep="\n    " if lines else "", flush=True)
    return moved


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="RUN", help=f"of {', '.join(RUNS)}; all by default")
    parser.add_argument("--against", metavar="COMMIT", help="the version to compare with")
    parser.add_argument("--run", choices=RUNS, help=argparse.SUPPRESS)
    parser.add_argument("-o", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.run:
        run(options.run, options.o)
        return 0
    if not options.against or set(options.names) - set(RUNS):
        parser.error("--against COMMIT is needed, and each RUN must be one of the names above")
    return int(compare(options.against, options.names or list(RUNS)) > 0)


if __name__ == "__main__":
    sys.exit(main())
