"""Lanes compiled in blocks, as sweeps are, move as single trajectories do: for every scene, law and pulse shape.

What a compiler does to many lanes at once it does not do to one, and the certificate's two runs are compiled alike.
"""

import json

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.models.physics.friction import FRICTION_LAWS

LANES = 96
COMPARED = (0, 63, 64, 95)
"""The first and the last lane, and those at the borders of a whole block and a short one."""

SETTLE, OBSERVE, ERROR = 0.3, 0.9, 1e-4
DRILLS = ("rotary", "vibro-impact", "drilling", "coupled-drilling")


def columns(scene: str) -> dict:
    """Lanes over the usual parameters, all different."""
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


def swept(scene: str, points: dict, run: dict, **parameters):
    run = {"settle": SETTLE, "observe": OBSERVE, "error": ERROR} | run
    points = {name: column.tolist() for name, column in points.items()}
    sweep = {"scene": scene, "points": points, "parameters": parameters, "run": run}
    dataset = vj.run_sweep(sweep, progress=False)
    assert json.loads(dataset.attrs["solver"])["compiler"] == "llvm"  # kernels translate every scene, law and pulse
    return dataset


def section_times(motion) -> np.ndarray:
    kinds = motion.event_kind.attrs["flag_meanings"].split()
    times = motion.event_time.values[motion.event_kind.values == kinds.index("section")]
    return times[times > SETTLE]


def combinations():
    """Every drill and every law; those of a drill and a law that others here have are long."""
    for scene in DRILLS:
        for law in FRICTION_LAWS:
            met = scene != "vibro-impact" and law != "stribeck"
            yield pytest.param(scene, law, marks=[pytest.mark.long] * met)


@pytest.mark.parametrize(("scene", "law"), list(combinations()))
def test_drill(scene, law):
    """Every return to the section comes at its time, and the hole has grown as much in between."""
    dataset = swept(scene, columns(scene), {"keep_returns": 25}, friction=law)
    returns = 0
    for lane in COMPARED:
        point = {name: column[lane].item() for name, column in columns(scene).items()}
        setting = {"duration": SETTLE + OBSERVE, "error": ERROR, "sampling": 1e-3, "progress": False}
        motion = vj.simulate(scene, friction=law, **point, **setting)
        times = section_times(motion)
        found = dataset.isel(point=lane)
        assert found.status == 0
        kept = found.return_time.values
        np.testing.assert_allclose(kept[np.isfinite(kept)], times, rtol=ERROR, err_msg=str(point))
        returns += len(times)
        if "x4" in motion and len(times) > 1:
            first, last = np.interp(times[[0, -1]], motion.time, motion.x4)
            rate = (last - first) / (times[-1] - times[0])
            np.testing.assert_allclose(found.rate_of_penetration, rate, rtol=10 * ERROR, atol=1e-9)
    assert returns >= 6


@pytest.mark.parametrize("shape", ["rectangular", "half-sine"])
def test_pulses(shape):
    """The hole grows as much in 18 pulses."""
    points = columns("penetration")
    dataset = swept("penetration", points, {}, force=500e3, pulse_shape=shape)
    for lane in COMPARED:
        point = {name: column[lane].item() for name, column in points.items()}
        motion = vj.simulate(
            "penetration", pulse_shape=shape, force=500e3, **point, duration=1.2, sampling=1e-3, progress=False
        )
        before, after = np.interp([0.29, 1.19], motion.time, motion.x4)  # where nothing pushes
        assert after > before
        np.testing.assert_allclose(dataset.rate_of_penetration[lane], (after - before) / 0.9, rtol=ERROR)
