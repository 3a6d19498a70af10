"""Random hybrid systems against an independent event-driven integration, and that integration against closed forms."""

import numpy as np
import pytest
from exact.described import Described, Stop, Surface
from exact.hybrid import Hybrid
from exact.random_systems import draw, structure
from random_families import family_of, faults
from random_systems import compare, compare_sweep

FREE = {"x": ((1.0, "v"),), "v": ((-1.0, "g"),)}
WALL = Stop("wall", ((1.0, ""), (-1.0, "x")), velocity="v", restitution="r")


def motion(field, events, start, end, count=501, **p):
    system = Described("test", tuple(field), field, events, {})
    return Hybrid(system, {"m": 1.0} | p).run(start, np.linspace(0.0, end, count))


def kinds(result, kind):
    return [entry for entry in result.events if entry[2] == kind]


def test_reference_bounces_until_rest():
    floor = Stop("floor", ((1.0, "x"),), velocity="v", restitution="r")
    ball = motion(FREE, [floor], [1.0, 0.0], 4.0, g=9.81, r=0.5)
    fall = np.sqrt(2 / 9.81)
    hits = fall * (1 + 2 * np.cumsum(0.5 ** np.arange(1, 12)))
    assert [entry[0] for entry in kinds(ball, "impact")][1:12] == pytest.approx(hits, abs=1e-11)
    assert kinds(ball, "rest")[0][0] == pytest.approx(3 * fall, abs=2e-7) and np.all(ball.states[-1] == 0)
    t = ball.times[ball.times < fall]
    assert ball.states[: len(t), 0] == pytest.approx(1 - 9.81 * t**2 / 2, abs=1e-12)


def test_reference_reports_doubtful_points():
    side, circle = Surface("side", ((1.0, "x"),)), {"x": ((1.0, "v"),), "v": ((-1.0, "x"),)}
    unstable = motion({"x": ((1.0, "side"),)}, [side], [0.0], 1.0)
    assert unstable.doubt[0] == 0 and "unstable" in unstable.doubt[1]
    touch = motion(circle, [WALL], [0.0, 1.0 + 1e-12], 3.0, r=0.5)
    assert touch.doubt[0] == pytest.approx(np.pi / 2, abs=1e-3) and "grazing" in touch.doubt[1]
    assert np.isnan(touch.states[touch.times > touch.doubt[0]]).all()
    back = Stop("back", ((1.0, "x"), (1.0, "")), reset={"x": ((1.0, ""),)})
    forth = Stop("forth", ((1.0, ""), (-1.0, "x")), reset={"x": ((-1.0, ""),)})
    cascade = motion({"x": ((1.0, "side"),)}, [back, forth, Surface("side", ((1.0, "x"),))], [0.5], 1.0)
    assert "cascade" in cascade.doubt[1]


def verdicts(seed, draws, duration=20.0):
    """Return the outcomes of comparisons of one structure, with the seed and the draw of each."""
    described = structure(seed)
    return {(seed, index): compare(described, *draw(described, seed, index), duration) for index in draws}


@pytest.mark.parametrize("seed", [12] + [pytest.param(seed, marks=pytest.mark.long) for seed in (2, 17)])
def test_trajectories_of_random_systems(seed):
    """Impacts, a reset, switches and friction together; the second start is exactly on a surface."""
    outcomes = verdicts(seed, (0, 3), 12.0)
    assert {key: verdict for key, verdict in outcomes.items() if verdict[0] not in ("agree", "doubtful")} == {}
    assert sum(kind == "agree" for kind, _ in outcomes.values()) >= 2


@pytest.mark.long
@pytest.mark.parametrize("seed", range(200, 212))
def test_more_trajectories_of_random_systems(seed):
    assert {key: verdict for key, verdict in verdicts(seed, range(5)).items() if verdict[0] == "WRONG"} == {}


@pytest.mark.long
@pytest.mark.parametrize("seed", [301, 302, 304, 305, 309])
def test_families_of_random_systems(seed):
    """States, impacts and multipliers along a parameter, and stability that changes at special points only."""
    compared, found = faults(*family_of(seed, 0), points=6)  # those at grazes are doubtful
    assert found == [] and compared >= 3


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 5, 12, 17, 19])
def test_sweeps_of_random_systems(seed):
    """Cycles, impacts, period and impact velocity of certified lanes, of systems with more damping."""
    described = structure(seed)
    assert described.section is None and "q" not in described.states
    draws = [draw(described, seed, index)[0] for index in range(4)]
    points = [{name: x + 0.3 * name.startswith("c_") for name, x in p.items()} for p in draws]
    assert compare_sweep(described, points, [0.1, 0.2, -0.15, 0.05][: len(described.states)], settle=150.0) == []
