"""Compile sweeps otherwise than they are, one choice at a time, and print by how much their results move.

    python tests/compiled_otherwise.py [SCENE ...] [--choice CHOICE ...]

With jax before 0.11.2 "no options" and "barriers expanded" take minutes to compile. What differs by more than roundings
(which grow, along 1.2 s of an impacting motion, by some powers of ten) is a fault of a compiler, or of ours. Friction
laws are all in one sweep (see test_sweep_against_simulate.py); pulses have both shapes.
"""

from argparse import ArgumentParser
from contextlib import contextmanager

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from test_sweep_against_simulate import DRILLS, LANES, all_laws, columns, swept  # noqa: E402

from vibrojax.engine import batch, compiler, programs  # noqa: E402
from vibrojax.errors import InputError  # noqa: E402
from vibrojax.physics.friction import FRICTION_LAWS  # noqa: E402

WIDTH, PASSES = "xla_cpu_prefer_vector_width", "xla_disable_hlo_passes"
USUAL = compiler.compiler_options("cpu")
CHOICES = {
    "no options": (dict[str, int | str](), programs.BLOCK),
    "vectors of 128 bits": (USUAL | {WIDTH: 128}, programs.BLOCK),
    "vectors of 512 bits": (USUAL | {WIDTH: 512}, programs.BLOCK),
    "barriers expanded": ({name: x for name, x in USUAL.items() if name != PASSES}, programs.BLOCK),
    "barriers kept": (USUAL | {PASSES: "cse_barrier_expander"}, programs.BLOCK),
    "blocks of 16": (USUAL, 16),
    "blocks of 128": (USUAL, 128),
}


@contextmanager
def compiled_with(options: dict, block: int):
    usual = compiler.compiler_options, batch.BLOCK
    compiler.compiler_options = programs.compiler_options = lambda platform: options
    batch.BLOCK = block
    programs.compiled.cache_clear()
    compiler.check_arithmetic.cache_clear()
    try:
        yield
    finally:
        compiler.compiler_options, batch.BLOCK = usual
        programs.compiler_options = usual[0]
        programs.compiled.cache_clear()
        compiler.check_arithmetic.cache_clear()
        jax.clear_caches()


def results(scene: str) -> list:
    """Datasets of all lanes: of a drill under every law, of penetration under each shape of pulse."""
    if scene == "penetration":
        points = columns(scene)
        return [swept(scene, points, {}, force=250e3, pulse_shape=shape) for shape in ("rectangular", "half-sine")]
    lanes = {name: np.tile(column, len(FRICTION_LAWS) - 1) for name, column in columns(scene).items()}
    lanes["law"] = np.repeat(np.arange(len(FRICTION_LAWS) - 1.0), LANES)
    return [swept(scene, lanes, {"keep_returns": 25}, friction="all-laws")]


def difference(one, other) -> tuple[float, str]:
    """The greatest relative difference of rates, and of the times of returns; what it is of."""
    found = {}
    for name in ("rate_of_penetration", "return_time"):
        if name in one:
            a, b = one[name].values, other[name].values
            if np.any(np.isnan(a) != np.isnan(b)):
                return np.inf, f"{name} is known for other lanes"
            found[name] = float(np.nanmax(np.abs(a - b) / np.maximum(np.abs(a), 1e-9)))
    name = max(found, key=lambda name: found[name])
    return found[name], name


def main() -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", default=[*DRILLS, "penetration"])
    parser.add_argument("--choice", action="append", choices=CHOICES, help="only these")
    options = parser.parse_args()
    FRICTION_LAWS["all-laws"] = all_laws()
    print(f"jax {jax.__version__}, usually {USUAL}, blocks of {programs.BLOCK}")
    for scene in options.scenes:
        usual = results(scene)
        for name in options.choice or CHOICES:
            if CHOICES[name] == (USUAL, programs.BLOCK):
                continue
            try:
                with compiled_with(*CHOICES[name]):
                    found = [difference(*pair) for pair in zip(usual, results(scene), strict=True)]
                text = ", ".join(f"{size:.1e} of {of}" for size, of in found)
            except InputError as refusal:  # its arithmetic is wrong, and was found so before any lane
                text = str(refusal)
            except jax.errors.JaxRuntimeError as error:
                text = str(error).splitlines()[0]
            print(f"{scene:<18}{name:<22}{text}", flush=True)


if __name__ == "__main__":
    main()
