"""Test lanes compiled by XLA, as on an accelerator or where kernels are not available, against lanes of kernels."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

import vibrojax as vj

RUN = {"settle": 12.0, "observe": 6.0, "error": 1e-4}
SWEEPS = {
    "vibro-impact": {"beta": [0.3, 0.4, 0.6, 0.9], "gamma": [0.6, 0.75, 0.9], "delta": [-0.005, 0.005]},
    "penetration": {"force": [200e3, 300e3], "frequency": [20.0, 40.0]},
}
WITHIN = {"vibro-impact": 1e-8, "penetration": 1e-9}
"""Rounding errors grow over twenty seconds of impacts before the motion repeats, and shrink afterwards."""


def without_kernel(name):
    """Return the scene with a function for which kernels have no rule."""

    class Untranslated(vj.SCENES[name]):
        def constants(self, p):
            m1 = p["m1"]
            return super().constants(p | {"m1": m1 + 0.0 * jnp.argmax(jnp.stack([m1, m1]), axis=0).astype(m1.dtype)})

    return Untranslated()


@pytest.mark.long
@pytest.mark.parametrize("scene", SWEEPS)
def test_xla_matches_kernels(scene):
    """Compare all labels, and the features of lanes that repeat within the growth of rounding errors."""
    sweep = {"scene": scene, "grid": SWEEPS[scene], "run": RUN if scene == "vibro-impact" else {}}
    kernels = vj.run_sweep(sweep, progress=False)
    xla = vj.run_sweep(sweep | {"scene": without_kernel(scene)}, progress=False)
    compilers = [json.loads(dataset.attrs["solver"])["compiler"] for dataset in (kernels, xla)]
    assert compilers == ["llvm", "xla"]
    if scene == "vibro-impact":
        repeats = (kernels.cycles > 0).values
        assert repeats.mean() > 0.4
        np.testing.assert_array_equal(xla.regime.values[repeats], kernels.regime.values[repeats])
        names = ["period", "impact_velocity", "phase_lag", "peak_impact_force", "drive_power"]
    else:
        repeats, names = np.ones(kernels.rate_of_penetration.shape, bool), ["rate_of_penetration", "slip_per_impact"]
    for name in names:
        by_kernels, by_xla = (dataset[name].values[repeats] for dataset in (kernels, xla))
        np.testing.assert_allclose(
            by_kernels, by_xla, rtol=WITHIN[scene], atol=WITHIN[scene] * np.nanmax(np.abs(by_kernels))
        )
