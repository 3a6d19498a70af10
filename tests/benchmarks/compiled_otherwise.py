"""Compile sweeps with other choices, one at a time, and print how much their results change.

    python tests/benchmarks/compiled_otherwise.py [SCENE ...] [--choice CHOICE ...]

With jax before 0.11.2, "XLA, no options" takes minutes to compile. Along 1.2 s of an impacting motion, rounding errors
grow by several powers of ten. A larger difference is a fault of a compiler or of the package. Kernels of another width,
or with other passes, give the same bits, but not those without fused multiply-add. Drills run under each friction law,
penetration under both pulse shapes.
"""

import sys
from argparse import ArgumentParser
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)
sys.path.insert(0, str(Path(__file__).parents[1]))

from test_sweep_against_simulate import DRILLS, columns, run_points  # noqa: E402

from vibrojax.compile import agreement, elementwise, native, xla  # noqa: E402
from vibrojax.compile.assembly import Untranslatable  # noqa: E402
from vibrojax.compile.elementwise import NUMBERS, Rule  # noqa: E402
from vibrojax.compile.native import kernels  # noqa: E402
from vibrojax.errors import InputError  # noqa: E402
from vibrojax.lanes import compiler  # noqa: E402
from vibrojax.physics.friction import FRICTION_LAWS  # noqa: E402

WIDTH, PASSES = "xla_cpu_prefer_vector_width", "xla_disable_hlo_passes"
OF_XLA = xla.compiler_options("cpu")
MORE_PASSES = ("sroa", "instruction_combine", "new_gvn", "aggressive_instcombine", "simplify_cfg", "aggressive_dce")


def no_kernel(*given: Any, **options: Any) -> Any:
    raise Untranslatable("on purpose")


def patches_for_xla(options: dict[str, Any], block: int = compiler.XLA_BLOCK) -> list[Any]:
    return [
        patch.object(compiler, "kernel_for", no_kernel),
        patch.object(xla, "compiler_options", lambda platform: options),
        patch.object(compiler, "compiler_options", lambda platform: options),
        patch.object(compiler, "XLA_BLOCK", block),
    ]


WITHOUT_FUSED = native.processor()._replace(features=native.processor().features.replace("+fma", "-fma"))

CHOICES: dict[str, list[Any]] = {
    "vectors of 128 bits": [
        patch.object(compiler, "KERNEL_REGISTERS", {}),
        patch.object(native, "vector_bytes", lambda: 16),
    ],
    "vectors of 512 bits": [patch.object(native, "vector_bytes", lambda: 64)],
    "no fused multiply-add": [patch.object(native, "processor", lambda: WITHOUT_FUSED)],
    "four registers": [patch.object(compiler, "KERNEL_REGISTERS", dict.fromkeys(compiler.KERNEL_REGISTERS, 4))],
    "more passes": [patch.object(native, "PASSES", MORE_PASSES)],
    "sums rounded apart": [
        patch.dict(
            elementwise.RULES,
            {name: Rule(partial(elementwise._arithmetic, f"f{name}", name), NUMBERS) for name in ("add", "sub", "mul")},
        )
    ],
    "XLA": patches_for_xla(OF_XLA),
    "XLA, no options": patches_for_xla({}),
    "XLA, 128 bits": patches_for_xla(OF_XLA | {WIDTH: 128}),
    "XLA, 512 bits": patches_for_xla(OF_XLA | {WIDTH: 512}),
    "XLA, blocks of 16": patches_for_xla(OF_XLA, 16),
}


@contextmanager
def compiled_with(changes: list[Any]) -> Iterator[None]:
    """Compile sweeps again with these changes."""
    caches = (xla.evaluation, agreement.check)
    for change in changes:
        change.start()
    try:
        kernels.clear()
        for cache in caches:
            cache.cache_clear()
        yield
    finally:
        for change in changes:
            change.stop()
        kernels.clear()
        for cache in caches:
            cache.cache_clear()
        jax.clear_caches()


def results(scene: str) -> list:
    """Return datasets of all lanes: a drill under every law, or penetration under each pulse shape."""
    if scene == "penetration":
        points = columns(scene)
        return [run_points(scene, points, {}, force=250e3, pulse_shape=shape) for shape in ("rectangular", "half-sine")]
    return [run_points(scene, columns(scene), {"keep_returns": 25}, friction=law) for law in FRICTION_LAWS]


def difference(reference, other) -> tuple[float, str]:
    """Return the largest relative difference of rates and return times, and the quantity's name."""
    differences = {}
    for name in ("rate_of_penetration", "return_time"):
        if name in reference:
            a, b = reference[name].values, other[name].values
            if np.any(np.isnan(a) != np.isnan(b)):
                return np.inf, f"{name} is known for other lanes"
            differences[name] = float(np.nanmax(np.abs(a - b) / np.maximum(np.abs(a), 1e-9)))
    name = max(differences, key=lambda name: differences[name])
    return differences[name], name


def main() -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", default=[*DRILLS, "penetration"])
    parser.add_argument("--choice", action="append", choices=CHOICES, help="only these")
    options = parser.parse_args()
    print(f"jax {jax.__version__}, kernels for {native.processor().name}")
    for scene in options.scenes:
        usual = results(scene)
        for name in options.choice or CHOICES:
            try:
                with compiled_with(CHOICES[name]):
                    differences = [difference(*pair) for pair in zip(usual, results(scene), strict=True)]
                text = ", ".join(f"{size:.1e} of {quantity}" for size, quantity in differences)
            except InputError as refusal:  # the arithmetic check failed before any lane ran
                text = str(refusal)
            except jax.errors.JaxRuntimeError as error:
                text = str(error).splitlines()[0]
            print(f"{scene:<18}{name:<22}{text}", flush=True)


if __name__ == "__main__":
    main()
