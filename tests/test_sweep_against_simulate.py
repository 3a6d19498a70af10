"""Test lanes compiled in blocks, as in sweeps, against single trajectories, for every scene, law and pulse shape.

A compiler transforms many lanes differently from one lane, and both runs of the certificate are compiled the same way.
"""

import json

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.physics.friction import FRICTION_LAWS

LANES = 96
COMPARED = (0, 63, 64, 95)
"""The first and the last lane, and the lanes on either side of the border between a full and a short block."""

SETTLE, OBSERVE, ERROR = 0.3, 0.9, 1e-4
DRILLS = ("rotary", "vibro-impact", "drilling", "coupled-drilling")
SHORT = ("vibro-impact", "stribeck"), ("vibro-impact", "hyperbolic"), ("coupled-drilling", "coulomb")


def columns(scene: str) -> dict:
    """Return lanes over the usual range of the parameters, all different."""
    rng = np.random.default_rng(96)
    if scene == "penetration":
        return {"zeta": rng.uniform(0.6, 1.5, LANES), "k3": rng.uniform(100e6, 400e6, LANES)}
    drill = {
        "beta": rng.uniform(0.25, 0.6, LANES),
        "gamma": rng.uniform(0.5, 0.9, LANES),
        "v": rng.uniform(0.5, 1.5, LANES),
    }
    if scene != "rotary":
        drill["delta"] = rng.uniform(-0.005, 0.005, LANES)
    return drill | {"start": np.array(["stuck", "drive"] * (LANES // 2))}


def run_points(scene: str, points: dict, run: dict, **parameters):
    run = {"settle": SETTLE, "observe": OBSERVE, "error": ERROR} | run
    points = {name: column.tolist() for name, column in points.items()}
    sweep = {"scene": scene, "points": points, "parameters": parameters, "run": run}
    dataset = vj.run_sweep(sweep, progress=False)
    assert json.loads(dataset.attrs["solver"])["compiler"] == "llvm"  # kernels support every scene, law and pulse shape
    return dataset


def section_times(motion) -> np.ndarray:
    kinds = motion.event_kind.attrs["flag_meanings"].split()
    times = motion.event_time.values[motion.event_kind.values == kinds.index("section")]
    return times[times > SETTLE]


def drill_cases():
    """Yield every drill with every law. A case is long if others, or `test_exact.py`, cover its drill and its law."""
    for scene in DRILLS:
        for law in FRICTION_LAWS:
            covered = (scene, law) not in SHORT
            yield pytest.param(scene, law, marks=[pytest.mark.long] * covered)


@pytest.mark.parametrize(("scene", "law"), list(drill_cases()))
def test_drill_agrees_with_trajectory(scene, law):
    """Every return to the section comes at the same time, and the hole grows by the same depth in between."""
    dataset = run_points(scene, columns(scene), {"keep_returns": 25}, friction=law)
    returns = 0
    for lane in COMPARED:
        point = {name: column[lane].item() for name, column in columns(scene).items()}
        setting = {"duration": SETTLE + OBSERVE, "error": ERROR, "sampling": 1e-3, "progress": False}
        motion = vj.simulate(scene, friction=law, **point, **setting)
        times = section_times(motion)
        lane_data = dataset.isel(point=lane)
        assert lane_data.status == 0
        kept = lane_data.return_time.values
        np.testing.assert_allclose(kept[np.isfinite(kept)], times, rtol=ERROR, err_msg=str(point))
        returns += len(times)
        if "x4" in motion and len(times) > 1:
            first, last = np.interp(times[[0, -1]], motion.time, motion.x4)
            rate = (last - first) / (times[-1] - times[0])
            np.testing.assert_allclose(lane_data.rate_of_penetration, rate, rtol=10 * ERROR, atol=1e-9)
    assert returns >= 6


@pytest.mark.parametrize("shape", ["rectangular", pytest.param("half-sine", marks=pytest.mark.long)])
def test_pulses_agree_with_trajectory(shape):
    """The hole grows by the same depth in 18 pulses."""
    points = columns("penetration")
    dataset = run_points("penetration", points, {}, force=500e3, pulse_shape=shape)
    for lane in COMPARED:
        point = {name: column[lane].item() for name, column in points.items()}
        motion = vj.simulate(
            "penetration", pulse_shape=shape, force=500e3, **point, duration=1.2, sampling=1e-3, progress=False
        )
        before, after = np.interp([0.29, 1.19], motion.time, motion.x4)  # outside the pulses
        assert after > before
        np.testing.assert_allclose(dataset.rate_of_penetration[lane], (after - before) / 0.9, rtol=ERROR)
