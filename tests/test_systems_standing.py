"""Labels of systems in which some states stand still or decay, and units of their impact velocities."""

import numpy as np
import pytest
from systems import names_of

import vibrojax as vj

DAMPING, RATE, DECAY, PERIOD = 0.2, 0.7, 0.05, np.pi
OSCILLATOR = {"x": "m", "v": "m s-1"}


def oscillation(t, y):
    return {"x": y["v"], "v": vj.elementary.cos(2.0 * t) - DAMPING * y["v"] - y["x"]}


# z decays, and w approaches an equilibrium; some starts have w there at once.
BESIDE = vj.System(
    "beside",
    states={"z": "m", "w": "1"} | OSCILLATOR,
    parameters={"q": 0.3},
    field=lambda t, y, p: oscillation(t, y) | {"z": -DECAY * y["z"], "w": p["q"] - RATE * y["w"]},
    period=PERIOD,
)


def test_states_that_stand_still_or_decay_do_not_decide():
    starts = [[1.0, 3 / 7, 0.0, 0.0], [1.0, 0.0, 0.3, 1.0], [0.0] * 4]
    sweep = {"scene": BESIDE, "grid": {"q": [0.3]}, "starts": starts, "run": {"orbits": True}}
    ds = vj.run_sweep(sweep, progress=False)
    assert ds.cycles.values.ravel().tolist() == [1, 1, 1] and set(names_of(ds)) == {"periodic"}
    assert (ds.error_estimate < 2e-6).all() and (ds.orbit_reason == 0).all() and (ds.stable == 1).all()
    own = np.exp(-PERIOD * np.array([DECAY, DAMPING / 2, DAMPING / 2, RATE]))
    np.testing.assert_allclose(ds.multiplier_abs.values[0], np.tile(own, (3, 1)), atol=1e-9)
    np.testing.assert_allclose(ds.orbit_w, 3 / 7, rtol=1e-9)


def pendulum(name, *events):
    return vj.System(
        name,
        states={"angle": "rad", "speed": "rad s-1"},
        parameters={"w": 1.5, "L": (2.0, "m")},
        field=lambda t, y, p, s: {
            "angle": y["speed"],
            "speed": 0.5 * vj.elementary.cos(p["w"] * t) - 0.1 * y["speed"] - vj.elementary.sin(y["angle"]),
        },
        period=lambda p: 2 * np.pi / p["w"],
        events=events,
    )


@pytest.mark.parametrize(
    "unit, events",
    [
        ("rad s-1", [vj.Impact("stop", gap=lambda t, y, p: 0.3 - y["angle"], velocity="speed", restitution=0.6)]),
        ("rad s-1", [vj.Switch("stop", lambda t, y, p: p["L"] * y["angle"] - 0.3, impact=True)]),
        ("rad s-2", [vj.Switch("stop", lambda t, y, p: y["speed"] - 0.3, impact=True)]),
    ],
)
def test_impact_velocity_has_unit_of_rate_of_gap(unit, events):
    assert pendulum("unit", *events).impact_unit == unit
