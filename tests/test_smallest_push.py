"""Test the smallest push out of the working cycle: it leaves, and all smaller ones of a fine scan return."""

import numpy as np
import pytest
import xarray as xr
from refusals import refusal
from systems import system

import vibrojax as vj
from vibrojax.explorer import contents_of
from vibrojax.measures.labels import IRREGULAR, SINGLE_IMPACT
from vibrojax.studies.push import Pushes, smallest_pushes

PARAMETERS = {"beta": 0.4, "delta": 0.005}
STATES = ("x1", "v1", "x2", "v2")


def smallest_push(scan=32, **more):
    return vj.smallest_push("vibro-impact", start="stuck", scan=scan, progress=False, **(PARAMETERS | more))


@pytest.fixture(scope="module")
def strong_cycle():
    """Return the pushes for the strong single impact, which coexists with a rattling motion."""
    return smallest_push(gamma=0.75)


def run_after_pushes(cycle, state, pushes, **parameters):
    """Return a sweep from the cycle with one state pushed, in which every lane runs to its end."""
    cycle_state = np.array([float(cycle[f"orbit_{name}"]) if f"orbit_{name}" in cycle else 0.0 for name in STATES])
    starts = [(cycle_state + push * np.eye(4)[STATES.index(state)]).tolist() for push in pushes]
    sweep = {"scene": "vibro-impact", "parameters": PARAMETERS | parameters, "starts": starts}
    return vj.run_sweep(sweep | {"run": {"settle": 120.0, "end_early": False}}, progress=False)


def test_fine_scan_finds_no_smaller_push(strong_cycle):
    assert strong_cycle.push_x1.dims == ("sign",) and strong_cycle.sign.values.tolist() == [-1, 1]
    assert int(strong_cycle.regime) == SINGLE_IMPACT and strong_cycle.push_v2.attrs["units"] == "m s-1"
    assert all({"units", "long_name"} <= set(variable.attrs) for variable in strong_cycle.variables.values())
    for name in STATES:
        has_push = np.isfinite(strong_cycle[f"push_{name}"].values)
        np.testing.assert_array_equal(strong_cycle[f"regime_{name}"].values > 0, has_push)
        push, bracket = strong_cycle[f"push_{name}"].values[has_push], strong_cycle[f"bracket_{name}"].values[has_push]
        assert (push > 0).all() and (push <= float(strong_cycle[f"bound_{name}"])).all()
        assert (bracket > 0).all() and (bracket <= 1e-3 * push).all()
    # Only a push of the bit against the drive leaves the cycle. Full runs three times as long return below it.
    has_push = {name: np.isfinite(strong_cycle[f"push_{name}"].values).tolist() for name in STATES}
    assert has_push == {"x1": [False, True], "v1": [False] * 2, "x2": [False] * 2, "v2": [False] * 2}
    push, bracket = float(strong_cycle.push_x1[1]), float(strong_cycle.bracket_x1[1])
    assert int(strong_cycle.regime_x1[1]) == IRREGULAR
    pushes = [*np.linspace(0.0, push - bracket, 96), push]
    velocity = run_after_pushes(strong_cycle, "x1", pushes, gamma=0.75).impact_velocity.values
    assert velocity[:-1] == pytest.approx(velocity[0], rel=1e-6) and velocity[-1] < 0.3 * velocity[0]


def test_summary_of_system_of_your_own():
    """States have any names. A push of Van der Pol's oscillator returns unless it leads to the unstable equilibrium."""
    field = lambda t, y, p: {"y": y["w"], "w": p["mu"] * (1 - y["y"] ** 2) * y["w"] - y["y"]}
    oscillator = system({"y": "m", "w": "m s-1"}, field, parameters={"mu": (1.0, "s-1")}, section="y")
    pushed = vj.smallest_push(oscillator, start=[1.0, 1.0], scan=4, progress=False)
    [part] = Pushes().summary(pushed)
    assert part.lines[0] == "working cycle: periodic, 6.6633 s" and len(part.lines) == 5


def test_page_shows_motions_on_cycle_and_after_push(strong_cycle):
    """The one push that leaves has a motion of its own; all other directions return to the working cycle."""
    contents = contents_of(strong_cycle, progress=False)
    on_cycle, after_push = contents.cells
    assert on_cycle.kind == "orbit" and on_cycle.duration == pytest.approx(float(strong_cycle.period), rel=1e-6)
    assert after_push.kind == "motion"
    bars = contents.document["figure"]["plots"][0]
    assert bars["x"]["direction"] == "sign" and bars["at"] == {"motion": 1}


def test_machines_over_two_parameters_have_one_line_for_each_value_of_the_second():
    """Of two frequency ratios and three mass ratios, the latter are the abscissa."""
    gamma, beta = np.repeat([0.7, 0.8], 3), np.tile([0.4, 0.3, 0.5], 2)
    shown = {"push_x1": (("sign", "point"), np.array([beta + gamma] * 2)), "bound_x1": ("point", 2 + 0 * beta)}
    machines = {"gamma": ("point", gamma), "beta": ("point", beta), "sign": [-1, 1]}
    sheet = smallest_pushes(xr.Dataset(shown, machines))
    line = sheet.plots[0].layers[0]
    np.testing.assert_allclose(line.x, [0.3, 0.4, 0.5, np.nan, 0.3, 0.4, 0.5])
    np.testing.assert_allclose(line.y, [1.0, 1.1, 1.2, np.nan, 1.1, 1.2, 1.3])
    assert "One line for each value of gamma" in sheet.note


def test_invalid_requests_are_refused():
    for scene, more, message in (
        ("penetration", {}, "has no working cycle to push"),
        ("vibro-impact", PARAMETERS | {"gamma": 0.75, "start": "drive"}, "no cycle to push; give another start"),
        ("vibro-impact", {"scan": 1}, "scan: 1 does not fit; a whole number from 2 to 10000 is needed"),
        ("vibro-impact", {"most": {"x9": 1.0}}, 'most.x9: unknown key; did you mean "x1"'),
    ):
        assert message in refusal(vj.smallest_push, scene, progress=False, **more)
