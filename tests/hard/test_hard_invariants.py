"""Tests of invariants, at every instant and over any time, for any parameters: on the hard lanes and on a random box.

Energy and momenta are summed over every step by Gauss' rule of 12 points, which is exact for products of two of the
step's polynomials. The forces are written down here from eqs. 5.9 to 5.18.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import DRILL, ROCK, USUAL, lanes
from flat import Flat

import vibrojax as vj
from vibrojax.compile.native import Kernel
from vibrojax.scenes.vibro_impact import VibroImpact
from vibrojax.stepping import Accuracy, Goal, Located, keep, lane_at

SCENE = VibroImpact()
DURATION = 0.5
SETTINGS = Accuracy(tolerance=1e-10, stride=2.0, step=np.inf)
REFUSED = [{"c2": 1e10}, {"v": 5e-324}, *DRILL["beyond all scales"]]
NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)


def box(count, seed=20):
    """Return points of a wide box, from both starts in turn."""
    rng = np.random.default_rng(seed)
    spans = {"beta": (0.05, 2), "gamma": (0.2, 3), "v": (0.05, 5), "mu": (0.05, 1), "c2": (1, 1e4)}
    spans |= {"k0": (1e6, 1e9), "c0": (0.1, 1e5)}
    drawn = {name: np.exp(rng.uniform(*np.log(span), count)) for name, span in spans.items()}
    drawn["delta"] = rng.uniform(-0.01, 0.01, count)
    return [{name: x[i] for name, x in drawn.items()} | {"start": ("drive", "stuck")[i % 2]} for i in range(count)]


POINTS = [USUAL | changes for _, changes in lanes(DRILL) if changes not in REFUSED]
POINTS += box(128 - len(POINTS))


def forces(p, mode, y):
    """Return F and J [N] in the mode, and k0 (x2 - delta) + c0 x2' (eqs. 5.9 to 5.12, 5.18)."""
    x1, v1, x2, v2 = y
    slip, touching = mode
    raw = p["k0"] * (x2 - p["delta"]) + p["c0"] * v2
    J, ratio = touching * raw, slip * (v1 + p["v"]) / p["v_cr"]
    sliding = slip * (p["mu"] * p["m1"] * p["g"] * (1 - ratio + ratio**3 / 3) + p["mu"] * J)
    return jnp.where(slip == 0, p["k2"] * (x2 - x1) - p["k1"] * x1, sliding), J, raw


def integrate(constants, state):
    """Return the end state, the remaining time, sums over time, and least values, each (lanes,).

    The sums are of F, J, x1, x2, F v and what F v is spent on. The least values are of F u, J, and J less
    k0 (x2 - delta) + c0 x2' where x2 >= delta.
    """

    def add_step(step, sums, least):
        tau = step.tau[None] * (jnp.asarray(NODES)[:, None] + 1) / 2
        y = []
        for series in step.polynomials:
            value = series[-1][None]
            for c in series[-2::-1]:
                value = value * tau + c[None]
            y.append(value)
        x1, v1, x2, v2 = y = keep(y)
        each = {name: q[None] for name, q in Flat(constants).items()}
        mode = tuple(m[None] for m in step.mode)
        F, J, raw = keep(forces(each, mode, y))
        u = v1 + each["v"]
        spent = F * u + each["c2"] * v2**2 + J * v2
        integrands = {
            "F": F,
            "J": J,
            "x1": x1,
            "x2": x2,
            "given": F * each["v"],
            "spent": spent,
            "sizes": jnp.abs(spent),
        }
        weights = jnp.asarray(WEIGHTS)[:, None] * (step.h * step.tau)[None] / 2
        sums = {name: sums[name] + jnp.sum(weights * integrand, axis=0) for name, integrand in integrands.items()}
        has_moved = (step.tau > 0)[None]
        lows = {"F u": F * u, "J": J, "J - raw": jnp.where(x2 >= each["delta"], J - raw, 0.0)}
        lows = {name: jnp.min(jnp.where(has_moved, low, 0.0), axis=0) for name, low in lows.items()}
        return sums, {name: jnp.minimum(least[name], low) for name, low in lows.items()}

    def continues(carry):
        lane, *_, steps = carry
        return jnp.any(lane.clock.until(DURATION) > 0) & (steps < 50_000)

    def take_step(carry):
        lane, sums, least, steps = carry
        moving = lane.clock.until(DURATION) > 0
        goal = Goal(jnp.asarray(DURATION), moving)
        lane, step = Located().step(SCENE, constants, lane, SETTINGS, goal, marked=False)
        return lane, *add_step(keep(step), sums, least), steps + 1

    zeros = jnp.zeros_like(state[0])
    sums = dict.fromkeys(("F", "J", "x1", "x2", "given", "spent", "sizes"), zeros)
    least = dict.fromkeys(("F u", "J", "J - raw"), zeros)
    lane, sums, least, _ = jax.lax.while_loop(continues, take_step, (lane_at(SCENE, constants, state), sums, least, 0))
    return lane.state, lane.clock.until(DURATION), sums, least


@pytest.fixture(scope="module")
def motions():
    """Return constants, first and last states, sums and least values of all lanes, as numpy arrays."""
    values = {name: q.default for name, q in SCENE.parameters().items()}
    parameters = {name: jnp.asarray([float(point.get(name, x)) for point in POINTS]) for name, x in values.items()}
    p = SCENE.constants(parameters)
    stuck = jnp.asarray([point["start"] == "stuck" for point in POINTS])
    starts = [SCENE.start(p, name, stuck.shape) for name in ("stuck", "drive")]
    state = tuple(jnp.where(stuck, *both) for both in zip(*starts, strict=True))
    arguments = SCENE.scaled(p, state), state
    end, remaining, sums, least = Kernel(integrate, *arguments)(*arguments)
    assert np.all(np.asarray(remaining) <= 0), [POINTS[i] for i in np.flatnonzero(np.asarray(remaining) > 0)]
    return jax.tree.map(np.asarray, (dict(Flat(p)), state, end, sums, least))


def wrong_points(wrong):
    """Return the points of the first lanes that are wrong."""
    return [POINTS[i] for i in np.flatnonzero(wrong)[:3]]


def test_energy(motions):
    """F v = F u + c2 x2'^2 + J x2' + change of energy, which does not include the contact's spring."""
    p, first, last, sums, _ = motions

    def energy(x1, v1, x2, v2):
        return (p["m1"] * v1**2 + p["m2"] * v2**2 + p["k1"] * x1**2 + p["k2"] * (x1 - x2) ** 2) / 2

    defect = sums["given"] - sums["spent"] - energy(*last) + energy(*first)
    size = sums["sizes"] + np.abs(sums["given"]) + energy(*first) + energy(*last)
    assert np.sum(np.abs(sums["given"]) > 1.0) > 100
    assert not wrong_points(np.abs(defect) > 1e-7 * size)


def test_friction_brakes_and_contact_pushes(motions):
    """F u >= 0 (5.9); J >= 0; and J is no less than k0 (x2 - delta) + c0 x2' while x2 >= delta (5.18)."""
    p, _, _, _, least = motions
    speed = p["speed_scale"] + np.sqrt(p["k0"] / p["m2"]) * np.abs(p["delta"])
    noise = 1e-11 * (p["k0"] * p["period"] + p["c0"]) * speed
    assert not wrong_points(least["F u"] < -1e-11 * (p["mu"] * p["weight"] * speed + noise * speed))
    assert not wrong_points(least["J"] < -noise)
    assert not wrong_points(least["J - raw"] < -noise)


@pytest.mark.parametrize("scene", ["penetration", "coupled-drilling"])
def test_hole_never_fills(scene):
    """x4 is the running maximum of x3 - D/k3 and of 0 (6.3): it never falls and never lags."""
    usual = {"duration": 0.25, "sampling": 2.5e-4} | (
        {} if scene == "penetration" else {"gamma": 0.6, "start": "stuck"}
    )
    deepened = 0
    for name, changes in lanes(ROCK):
        point = {"zeta": 1.1, "threshold": 61.9e3, "k3": 100.68e6} | changes
        motion = vj.simulate(scene, **usual, **point, progress=False)
        x3, x4 = motion.x3.values, motion.x4.values
        grows = np.diff(x4, prepend=0.0)
        noise = 1e-12 * (np.abs(x3).max() + x4[-1])
        assert np.all(grows >= -noise), (name, changes, grows.min())
        assert np.all(x4 - (x3 - point["threshold"] / point["k3"]) >= -noise), (name, changes)
        deepened += x4[-1] > 0
    assert deepened >= 4
