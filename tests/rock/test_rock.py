"""Test the physics of rock: closed forms, the rocks of Table 4.5, and the drill on rock."""

import jax
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.physics.rock import ROCKS, resistance

K3, D = 300e6, 150e3
SHORT = {"settle": 0.3, "observe": 0.2}


@pytest.mark.parametrize(
    ("rock", "force", "gradient"),
    [
        (-1.0, 0.0, (0.0, 0.0, 0.0)),  # off the rock: no tension
        (0.0, 6e4, (K3, 2e-4, 0.0)),  # elastic: k3 e; derivatives by (e, k3, D)
        (1.0, D, (0.0, 0.0, 1.0)),  # yielding: D
    ],
)
def test_resistance(rock, force, gradient):
    """N = k3 e, D or 0 (6.2), with its derivatives within each part."""
    value, slopes = jax.value_and_grad(resistance, argnums=(0, 1, 2))(2e-4, K3, D, rock)
    assert float(value) == pytest.approx(force, rel=1e-15)
    np.testing.assert_allclose(slopes, gradient, rtol=1e-15)


def test_table_4_5():
    """D [kN], k3 [MN/m], UCS [MPa], E [GPa], density [kg/m³] as printed."""
    printed = {
        "sandstone": (61.9, 100.68, 84.9, 4.7, 2382),
        "limestone": (140.3, 175.32, 192.4, 8.2, 2480),
        "granite": (204.5, 224.24, 280.5, 10.5, 2687),
    }
    units = np.array([1e3, 1e6, 1e6, 1e9, 1.0])
    assert set(ROCKS) == set(printed)
    for name, values in printed.items():
        rock = ROCKS[name]
        actual = (rock.threshold, rock.k3, rock.ucs, rock.modulus, rock.density)
        np.testing.assert_allclose(actual, np.array(values) * units, rtol=1e-12)


def test_rock_as_an_axis():
    """`rock` along the grid gives the same as D and k3 written out, and a harder rock is drilled more slowly."""
    names = ["granite", "sandstone", "limestone"]
    fixed = {"force": 300e3, "zeta": 0.6}
    sweep = {"scene": "penetration", "parameters": fixed, "run": SHORT}
    by_name = vj.run_sweep(sweep | {"grid": {"rock": names}}, progress=False)
    assert by_name.rate_of_penetration.dims == ("rock",)
    assert list(by_name.rock.values) == names
    points = {"threshold": [ROCKS[name].threshold for name in names], "k3": [ROCKS[name].k3 for name in names]}
    by_number = vj.run_sweep(sweep | {"points": points}, progress=False)
    for name in ("rate_of_penetration", "relief", "deepest_gap"):
        np.testing.assert_array_equal(by_name[name].values, by_number[name].values)
    granite, sandstone, limestone = by_name.rate_of_penetration.values
    assert sandstone > limestone > granite > 0
    np.testing.assert_allclose(by_name.relief, by_name.mean_force / points["threshold"], rtol=1e-15)


# The drill on rock: one-way coupling, and feedback

ON_ROCK = {
    "grid": {"gamma": [0.6, 0.7, 0.8], "beta": [0.25, 0.4], "v": [1.0, 2.0]},
    "starts": ["stuck"],
    "run": {"settle": 10.0, "observe": 4.0, "error": 1e-5},
}
DRILL = ("period", "impact_velocity", "impact_phase", "peak_impact_force", "stick_fraction", "bit_amplitude")
DRILL += ("striker_amplitude", "settling_time", "drive_power")


@pytest.fixture(scope="module")
def sweeps():
    scenes = ("vibro-impact", "drilling", "coupled-drilling")
    return {scene: vj.run_sweep(ON_ROCK | {"scene": scene}, progress=False) for scene in scenes}


def test_one_way_coupling_leaves_drill_unchanged(sweeps):
    """The equations for x1 and x2 are the same, so labels and counts are equal. Steps also end on the rock's switches,
    so the other quantities agree to the error of the steps, 1e-8."""
    free, drilling = sweeps["vibro-impact"], sweeps["drilling"]
    assert np.all(free.cycles > 0)
    for name in ("regime", "cycles", "impacts", "returns", "striker_turns", "status", "reason"):
        if name in free:
            np.testing.assert_array_equal(drilling[name], free[name])
    for name in DRILL:
        scale = 1.0 if name in ("stick_fraction", "reverse_fraction", "impact_phase") else free[name].values
        difference = (drilling[name].values - free[name].values) / scale
        assert np.nanmax(np.abs(difference)) < 1e-8, name
    np.testing.assert_allclose(drilling.phase_lag, free.phase_lag, atol=1e-4)
    assert set(drilling.data_vars) > set(free.data_vars)
