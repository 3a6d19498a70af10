"""Smoothed, located and diffrax's adaptive steps give one motion, over a transient short enough to forbid chaos."""

import json

import diffrax
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.errors import InputError

STATES = ("x1", "v1", "x2", "v2")
STUCK = {"start": "stuck"}  # sticks, slips both ways, impacts; periodic in the end
IRREGULAR = {"k1": 625000.0, "gamma": 1.2, "start": "drive"}  # chaotic in the end (Fig. 5.77c)
WIDTHS = (1e-2, 1e-3, 1e-4)
SOLVERS = ["Tsit5", "Kvaerno5", diffrax.Dopri8()]


def motion(point, **how):
    return vj.simulate("vibro-impact", **point, **how, duration=0.8, sampling=1e-3, progress=False)


@pytest.fixture(scope="module")
def located():
    return {"stuck": motion(STUCK), "irregular": motion(IRREGULAR)}


def apart(one, other):
    """Greatest distance of the positions, over the swing."""
    return max(float(abs(one[x] - other[x]).max() / abs(other[x]).max()) for x in ("x1", "x2"))


def apart_in_the_mean(one, other):
    """The same of all states, on average over time: a velocity that turns round in a 4 ms blow is never close at all
    times."""
    return max(float(abs(one[y] - other[y]).mean() / abs(other[y]).max()) for y in STATES)


def bound(width):
    """What smoothing costs at least and at most about: w^(4/5) in units of 1 m/s (see stepping/test_smoothed.py)."""
    return width**0.8


def test_there_is_something_to_agree_on(located):
    kinds = located["stuck"].event_kind.attrs["flag_meanings"].split()
    happened = {kinds[kind] for kind in located["stuck"].event_kind.values}
    assert happened >= {"stick", "slip", "impact", "release", "section"}
    assert (located["irregular"].event_kind == kinds.index("impact")).sum() >= 2


@pytest.mark.parametrize("width", WIDTHS)
def test_smoothed_and_located(located, width):
    """Within the width's share, which falls as the width does."""
    smoothed = motion(STUCK, method="smoothed", smoothing=width, step=0.1 * width)
    assert apart(smoothed, located["stuck"]) < bound(width)
    assert apart_in_the_mean(smoothed, located["stuck"]) < bound(width)
    irregular = motion(IRREGULAR, method="smoothed", smoothing=width, step=0.1 * width)
    assert apart(irregular, located["irregular"]) < bound(width)


@pytest.mark.parametrize("solver", SOLVERS, ids=str)
@pytest.mark.long
def test_any_diffrax_solver(located, solver):
    """An adaptive run at width 1e-4 m/s keeps to the located one within the width's share, 6e-4 of the swing."""
    adaptive = motion(STUCK, solver=solver, smoothing=1e-4)
    assert apart(adaptive, located["stuck"]) < bound(1e-4)
    assert apart_in_the_mean(adaptive, located["stuck"]) < bound(1e-4)


def test_smoothed_and_diffrax():
    """They solve the same equations: at one width they differ by their step errors only, which are far smaller."""
    smoothed = motion(STUCK, method="smoothed", smoothing=1e-2, step=1e-4)
    adaptive = motion(STUCK, solver="Tsit5", smoothing=1e-2, error=1e-6)
    assert apart(smoothed, adaptive) < 1e-2 * bound(1e-2)


def test_forces_agree(located):
    """Friction and contact force of the sharp and the smoothed motion, on average over time."""
    smoothed = motion(STUCK, method="smoothed", smoothing=1e-3, step=1e-4)
    for name in ("friction_force", "impact_force"):
        difference = abs(smoothed[name] - located["stuck"][name]).mean()
        assert difference < 0.01 * abs(located["stuck"][name]).max()


def test_no_diffrax_solver():
    with pytest.raises(InputError, match="no diffrax solver"):
        motion(STUCK, solver="Tsit6")
    with pytest.raises(InputError, match="solver"):
        motion(STUCK, solver="Tsit5", method="located")


def test_samples_do_not_depend_on_sampling(located):
    """A trajectory is read off the steps' polynomials: other samples, the same motion."""
    finer = vj.simulate("vibro-impact", **STUCK, duration=0.8, sampling=2.5e-4, progress=False)
    for name in STATES:
        np.testing.assert_array_equal(finer[name][::4], located["stuck"][name])


def test_a_solver_with_fixed_steps(located):
    """One without an error estimate takes the steps it is given, or those that the width asks for."""
    euler = motion(STUCK, solver="Euler", smoothing=1e-2, step=2e-5)
    assert json.loads(euler.solver)["steps"] == 40_000
    np.testing.assert_allclose(euler.x1, located["stuck"].x1, atol=2e-3)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("duration", "a"),
        ("duration", 0),
        ("sampling", float("nan")),
        ("error", -1.0),
        ("step", True),
        ("smoothing", "x"),
    ],
)
def test_settings_that_are_no_numbers_above_zero(name, value):
    with pytest.raises(InputError, match=f"simulate: {name}: "):
        vj.simulate("rotary", **({"duration": 0.1} | {name: value}), progress=False)


def test_numpy_scalars_are_numbers():
    motion = vj.simulate("rotary", beta=np.float32(0.5), m1=np.int64(250), duration=np.float32(0.1), progress=False)
    assert float(motion.time[-1]) == pytest.approx(0.1)
