"""Labels of systems in which some states stand still or decay, and units of their impact velocities."""

import numpy as np
import pytest
from systems import names_of

import vibrojax as vj

DAMPING, RATE, DECAY, PERIOD = 0.2, 0.7, 0.05, np.pi
OSCILLATOR = {"x": "m", "v": "m s-1"}


def oscillation(t, y):
    return {"x": y["v"], "v": vj.elementary.cos(2.0 * t) - DAMPING * y["v"] - y["x"]}


HELD = vj.System(
    "held",
    states=OSCILLATOR | {"x2": "m", "v2": "m s-1"},
    parameters={"N": 1.0},
    field=lambda t, y, p: oscillation(t, y) | {"x2": y["v2"], "v2": -0.01 * y["x2"]},
    period=PERIOD,
    events=[
        vj.Friction("base", lambda t, y, p: y["v2"], lambda t, y, p: p["N"], law=0.3, acts_on="v2", mass=lambda p: 1.0)
    ],
)

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


@pytest.mark.long
def test_mass_that_friction_holds_does_not_decide():
    """Every position of the held mass belongs to an orbit, so that one multiplier is 1."""
    run = {"orbits": True}
    starts = [[0.0] * 4, [0.5, 0.0, 0.2, 0.5]]
    ds = vj.run_sweep({"scene": HELD, "grid": {"N": [1.0]}, "starts": starts, "run": run}, progress=False)
    assert ds.cycles.values.ravel().tolist() == [1, 1] and set(names_of(ds)) == {"periodic"}
    assert (ds.orbit_reason == 0).all() and (ds.stable == 1).all()
    own = [1.0, *np.exp(-PERIOD * np.array([DAMPING / 2, DAMPING / 2, np.inf]))]
    np.testing.assert_allclose(ds.multiplier_abs.values[0], np.tile(own, (2, 1)), atol=1e-9)
    assert len(np.unique(ds.orbit_x2)) == 2


@pytest.mark.long
def test_motions_on_standing_states_match_one_attractor():
    rates = lambda t, y, p: {"x": y["v"], "v": (1 - y["x"] * y["x"]) * y["v"] - y["x"], "z": p["q"] - RATE * y["z"]}  # noqa: E731
    scene = vj.System("relaxes", states=OSCILLATOR | {"z": "1"}, parameters={"q": 0.3}, field=rates, section="x")
    starts = [[0.1, 0.0, 0.0], [2.0, 1.0, 3 / 7], [1.0, 0.0, -1.0]]
    attractors = vj.attractors({"scene": scene, "grid": {"q": [0.0, 0.3]}, "starts": starts}, progress=False)
    assert attractors.sizes["attractor"] == 1 and (attractors.share == 1).all()
    assert attractors.attrs["kind"] == "attractors"
