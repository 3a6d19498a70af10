"""Test the physics of rock: closed forms with gradients, the rocks of Table 4.5, and their choice by name."""

import jax
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.errors import InputError
from vibrojax.maps.read import read_sweep
from vibrojax.physics.rock import ROCKS, damping, ratchet, resistance

K3, D = 300e6, 150e3
SHORT = {"settle": 0.3, "observe": 0.2}


def test_damping():
    """c3 = 2 zeta sqrt(m1 k3); d/dm1 = zeta sqrt(k3/m1), d/dk3 = zeta sqrt(m1/k3), d/dzeta = 2 sqrt(m1 k3)."""
    m1, zeta = 250.0, 1.1
    value, gradient = jax.value_and_grad(damping, argnums=(0, 1, 2))(m1, K3, zeta)
    assert float(value) == pytest.approx(2 * zeta * np.sqrt(m1 * K3), rel=1e-15)
    exact = (zeta * np.sqrt(K3 / m1), zeta * np.sqrt(m1 / K3), 2 * np.sqrt(m1 * K3))
    np.testing.assert_allclose(gradient, exact, rtol=1e-14)


@pytest.mark.parametrize(
    ("compression", "force", "gradient"),
    [
        (-1e-4, 0.0, (0.0, 0.0, 0.0)),  # off the rock: no tension
        (2e-4, 6e4, (K3, 2e-4, 0.0)),  # elastic: k3 e; derivatives by (e, k3, D)
        (9e-4, D, (0.0, 0.0, 1.0)),  # yielding: D
    ],
)
def test_resistance(compression, force, gradient):
    """N = clip(k3 e, 0, D) (6.2), with its derivatives within each part."""
    value, slopes = jax.value_and_grad(resistance, argnums=(0, 1, 2))(compression, K3, D)
    assert float(value) == pytest.approx(force, rel=1e-15)
    np.testing.assert_allclose(slopes, gradient, rtol=1e-15)


@pytest.mark.parametrize(
    ("x3", "depth", "gradient"),
    [
        (6e-4, 2e-4, (0.0, 1.0, 0.0, 0.0)),  # x3 - D/k3 = 1e-4 < x4: x4 stays
        (9e-4, 4e-4, (1.0, 0.0, D / K3**2, -1 / K3)),  # x4 follows x3 - D/k3; derivatives by (x3, x4, k3, D)
    ],
)
def test_ratchet(x3, depth, gradient):
    """x4 = max(x4, x3 - D/k3) (6.3)."""
    value, slopes = jax.value_and_grad(ratchet, argnums=(0, 1, 2, 3))(x3, 2e-4, K3, D)
    assert float(value) == pytest.approx(depth, rel=1e-14)
    np.testing.assert_allclose(slopes, gradient, rtol=1e-14)


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


@pytest.mark.parametrize(
    "sweep", [{"scene": "penetration", "grid": {"rock": ["basalt"]}}, {"scene": "penetration", "grid": {"rock": []}}]
)
def test_wrong_rocks_are_refused(sweep):
    """The error is one line that names the key."""
    with pytest.raises(InputError, match="rock") as error:
        read_sweep(sweep)
    assert "\n" not in str(error.value)
