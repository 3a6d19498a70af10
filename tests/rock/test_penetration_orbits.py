"""Test orbits under pulses, stroboscopic at the pulse, against closed forms: the flow is linear within each mode."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

import vibrojax as vj

M1 = 250.0
FOUND = 0
COLUMNS = ("force", "frequency", "pulse_width", "zeta", "threshold", "k3")
POINTS = {
    "pressed without a pause": (5e3, 200.0, 2e-3, 1.1, 1e7, 300e6),
    "jumps off": (5e3, 100.0, 2e-3, 0.3, 1e7, 300e6),
    "yields, and comes to rest": (200e3, 20.0, 4e-3, 1.1, 150e3, 300e6),
    "yields and jumps off": (300e3, 150.0, 3e-3, 0.2, 150e3, 300e6),
    "never stops to yield": (207e3, 212.0, 3.7e-3, 0.3925, 85e3, 14.2e6),
    "two pulses": (24774.87, 169.046, 2.46e-3, 0.03131, 112879.0, 140.4925e6),
    "two pulses, one of which yields": (98373.2, 54.5255, 8.11e-3, 0.112, 240579.0, 267.12e6),
}


class Rock:
    """The bit on rock in one of its modes: [e, x3', 1]' = A [e, x3', 1], e = x3 - x4 (eqs. 6.1 to 6.3)."""

    def __init__(self, point):
        self.force, self.frequency, self.width, zeta, self.D, self.k3 = point
        self.c3 = 2 * zeta * np.sqrt(M1 * self.k3)
        self.slope = np.eye(2)
        self.growth = 0.0

    def matrix(self, mode, force):
        moves, stiffness, held = {"elastic": (1, self.k3, 0), "off": (1, 0, 0), "yielding": (0, 0, self.D)}[mode]
        return np.array([[0, moves, 0], [-stiffness / M1, -self.c3 / M1, (force - held) / M1], [0, 0, 0]])

    def ends(self, mode):
        """Return, by following mode, the rows over [e, x3', 1] whose values are positive within a mode."""
        full = self.D / self.k3
        return {
            "elastic": {"yielding": [-1, 0, full], "off": [1, 0, 0]},
            "off": {"elastic": [-1, 0, 0]},
            "yielding": {"elastic": [0, 1, 0]},
        }[mode]

    def go(self, mode, y, force, time):
        """Return the mode and state after `time` under a constant force. Accumulate the derivative and the growth."""
        while True:
            # A mode begins on the surface of its ends and is clear of it shortly after.
            A, times = self.matrix(mode, force), time * np.array([1e-7, *np.arange(1, 301) / 300])
            states, roots = expm(A * times[:, None, None]) @ y, []
            for follows, row in self.ends(mode).items():
                fallen = np.flatnonzero(states @ row < 0)
                if len(fallen) and (first := fallen[0]) > 0:
                    root = brentq(lambda t, row=row, A=A, y=y: row @ expm(A * t) @ y, times[first - 1], times[first])
                    roots.append((root, follows))
            until, follows = min(roots, default=(time, mode))
            flow = expm(A * until)
            self.slope = flow[:2, :2] @ self.slope
            if mode == "yielding":  # the integral of x3', from the equation of motion
                velocity = (flow @ y)[1]
                self.growth += ((force - self.D) * until - M1 * (velocity - y[1])) / self.c3
            y, time = flow @ y, time - until
            if follows == "yielding" != mode:
                # The rate of e jumps from x3' to 0: the saltation 1 + (f+ - f-) n/(n f-) with n = (1, 0).
                self.slope = np.diag([0.0, 1.0]) @ self.slope
            if follows == mode:
                return mode, y
            mode = follows

    def pulse(self, mode, y):
        mode, y = self.go(mode, y, self.force, self.width)
        return self.go(mode, y, 0.0, 1 / self.frequency - self.width)


def run_points(**more):
    columns = dict(zip(COLUMNS, map(list, zip(*POINTS.values(), strict=True)), strict=True))
    run = {"orbits": True, "settle": 4.0, "observe": 1.0}
    return vj.run_sweep(
        {"scene": "penetration", "points": columns, "parameters": more, "run": run, "unusual": True}, progress=False
    )


@pytest.fixture(scope="module")
def orbits():
    return run_points()


@pytest.mark.parametrize("name", POINTS)
def test_orbits_agree_with_closed_form(orbits, name):
    lane, rock = orbits.isel(point=list(POINTS).index(name)), Rock(POINTS[name])
    assert lane.orbit_reason == FOUND and lane.orbit_residual < 1e-10 and lane.stable == 1
    assert lane.orbit_cycles == (2 if "two" in name else 1)
    begin = np.array([lane.orbit_compression.item(), lane.orbit_v3.item(), 1.0])
    mode = "off" if begin[0] < 0 else "elastic"
    if name == "never stops to yield":  # e is D/k3 there, whatever it was before
        mode, rock.slope = "yielding", np.diag([0.0, 1.0])
    y = begin
    for _ in range(int(lane.orbit_cycles)):
        mode, y = rock.pulse(mode, y)
    scale = np.abs(begin).max()
    np.testing.assert_allclose(y, begin, rtol=0, atol=1e-9 * scale)
    values = np.linalg.eigvals(rock.slope)
    values = values[np.argsort(-np.abs(values))]
    np.testing.assert_allclose(lane.multiplier_abs, np.abs(values), rtol=0, atol=1e-8)
    time = int(lane.orbit_cycles) / rock.frequency
    np.testing.assert_allclose(lane.rate_of_penetration, rock.growth / time, rtol=1e-8, atol=1e-12)
    if "yield" in name:
        assert lane.rate_of_penetration > 0 and lane.multiplier_abs[1] < 1e-14


def test_multipliers_under_constant_contact_do_not_depend_on_pulses(orbits):
    """The flow is linear throughout, so the multipliers are exp(r/frequency), m1 r² + c3 r + k3 = 0, for any pulse."""
    rock = Rock(POINTS["pressed without a pause"])
    expected = np.sort(np.exp(np.roots([M1, rock.c3, rock.k3]) / rock.frequency))[::-1]
    for dataset in (orbits, run_points(pulse_shape="half-sine")):
        np.testing.assert_allclose(dataset.multiplier_abs[0], expected, rtol=1e-9)


def test_variables_of_orbits(orbits):
    assert "period" not in orbits and "cycles" not in orbits
    assert {"orbit_compression", "orbit_v3", "grazing_margin"} <= set(orbits.data_vars)
    assert {"multiplier_abs", "orbit_v3"} <= set(vj.list_variables("penetration").index)
