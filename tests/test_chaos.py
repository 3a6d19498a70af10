"""The greatest Lyapunov exponent through events, and the natures of lanes that do not repeat."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from known_scenes import ImpactOscillator, Lorenz

import vibrojax as vj
from vibrojax.analyses.chaos.growth import TANGENT_ACCURACY, exponents, grow, zero_one
from vibrojax.errors import InputError
from vibrojax.io.variables import NATURES
from vibrojax.measures.labels import IRREGULAR
from vibrojax.periodic.lane_orbits import last_returns
from vibrojax.periodic.return_map import Segments
from vibrojax.sweep.engine.chunks import Chunks

GAP = {"scene": "vibro-impact", "starts": ["stuck"], "parameters": {"delta": 0.005}}
# An irregular, a quasi-periodic and two periodic lanes; see test_natures.
LANES = GAP | {"points": {"beta": [0.5, 0.5, 0.4, 0.3], "gamma": [0.7, 0.67, 0.59, 0.6]}, "run": {"lyapunov": True}}


@pytest.fixture(scope="module")
def found():
    return vj.run_sweep(LANES, progress=False).squeeze("start")


def unit(scale):
    return np.full(scale.shape, len(scale) ** -0.5)


def irregular(grid):
    """Lanes that do not repeat: sweep, parameters, states at the last return and scales, (states, lanes)."""
    kept = {}
    sweep = vj.read_sweep(GAP | {"grid": grid})
    Chunks(sweep, lambda first, end, features: kept.update(features) or {}).compute(0)
    lanes = np.flatnonzero((kept["cycles"] == 0) & (kept["returns"] > 8))
    states, scale = last_returns(sweep.system, lanes, 1, kept)
    values = {name: x[lanes] for name, x in sweep.lane_values(0, sweep.lanes)[0].items()}
    return sweep, values, states[:, 0].T, scale.T


@pytest.mark.long
def test_lorenz():
    """0.9056 (Sprott, Chaos and Time-Series Analysis, 2003), here the mean of 64 lanes; through the same code."""
    starts = {"sample": "random", "count": 64, "seed": 0, "box": {"x": [1, 10], "y": [1, 10], "w": [-10, 10]}}
    run = {"settle": 20.0, "observe": 20.0, "lyapunov": True}
    lanes = vj.run_sweep({"scene": Lorenz(), "starts": starts, "run": run}, progress=False)
    assert abs(float(lanes.lyapunov.mean()) / 0.9056 - 1) < 0.01
    assert (lanes.nature == NATURES.index("chaotic")).all() and (lanes.zero_one > 0.9).all()
    apart = (lanes.lyapunov - 0.9056) / lanes.lyapunov_stderr
    assert float(np.abs(apart).max()) < 4 and 0.3 < float(apart.std()) < 1.5


def test_a_linear_impact_oscillator():
    """One impact a period takes e² exp(-2 zeta T) of an area, whatever the saltation does with directions: where the
    multipliers are a pair, ln|multiplier|/T = ln(e)/T - zeta."""
    grid = {"damping": [0.02, 0.05], "restitution": [0.3, 0.6, 0.8], "frequency": [1.5, 2.0]}
    run = {"settle": 200.0, "observe": 60.0, "lyapunov": True, "orbits": True}
    lanes = vj.run_sweep({"scene": ImpactOscillator(), "grid": grid, "run": run}, progress=False)
    pair = lanes.multiplier_arg.isel(multiplier=0)
    assert ((pair > 0) & (pair < np.pi) & (lanes.cycles == 1)).all()
    expected = np.log(lanes.restitution) * lanes.frequency / (2 * np.pi) - lanes.damping
    assert float(np.abs(lanes.lyapunov - expected).max()) < 1e-6
    # The tangent alone, which goes round.
    sweep = vj.read_sweep({"scene": ImpactOscillator(), "grid": grid})
    state = np.stack([lanes[f"orbit_{name}"].values.ravel() for name in ("c", "x", "v")])
    gone = grow(sweep.system, sweep.lane_values(0, 12)[0], state, unit(state), np.ones_like(state), 8192)
    assert np.abs(exponents(gone.rate, gone.time)[0] - expected.transpose(*grid).values.ravel()).max() < 1e-6


def test_the_tangent_of_periodic_lanes_grows_as_their_multipliers_say():
    grid = {"beta": {"start": 0.25, "stop": 0.6, "num": 9}, "gamma": {"start": 0.6, "stop": 0.8, "num": 8}}
    tables = GAP | {"parameters": {"delta": -0.005}, "grid": grid}
    sweep = vj.read_sweep(tables | {"run": {"orbits": True}})
    lanes = vj.run_sweep(sweep, progress=False).stack(lane=("beta", "gamma", "start"))
    some = np.flatnonzero((lanes.orbit_reason == 0) & (lanes.cycles == 1))[:64]
    assert len(some) == 64
    at = lanes.isel(lane=some)
    state = np.stack([at[name].values for name in ("orbit_x1", "orbit_x2", "orbit_v2")])
    amplitudes = at.bit_amplitude.values, at.striker_amplitude.values
    scale = np.stack([*amplitudes, amplitudes[1] * 2 * np.pi / at.period.values])
    values = {name: x[some] for name, x in sweep.lane_values(0, sweep.lanes)[0].items()}
    gone = grow(sweep.system, values, state, unit(state), scale, 4096)
    expected = np.log(at.multiplier_abs.isel(multiplier=0).values) / at.period.values
    assert np.abs(exponents(gone.rate, gone.time)[0] - expected).max() < 1e-4


def test_two_trajectories_part_as_the_tangent_grows():
    """The other road: no derivative, two lanes a little apart, drawn together again at each return."""
    sweep, values, state, scale = irregular(
        {"beta": [0.35, 0.4, 0.45, 0.5, 0.55], "gamma": {"start": 0.62, "stop": 0.8, "num": 41}}
    )
    assert state.shape[1] >= 50
    values, state, scale = {name: x[:50] for name, x in values.items()}, state[:, :50], scale[:, :50]
    fine = TANGENT_ACCURACY._replace(tolerance=1e-9)  # below the distance that the two are drawn together to
    gone = grow(sweep.system, values, state, unit(state), scale, 256, steps=fine)
    one, other, apart = state, state + 1e-7 * scale * unit(scale), 1e-7
    growth, seconds = [], []
    both = {name: np.concatenate([x, x]) for name, x in values.items()}
    returns = Segments(sweep.system, steps=fine)
    for _ in range(256):
        there = returns(both, np.concatenate([one, other], axis=1))
        one, other = np.split(np.asarray(there.state), 2, axis=1)
        distance = np.sqrt(np.sum(((other - one) / scale) ** 2, axis=0))
        other = one + (other - one) * apart / distance
        growth.append(np.log(distance / apart))
        seconds.append(np.asarray(there.time)[:50])
    (first, error), (second, its_error) = (
        exponents(gone.rate, gone.time),
        exponents(np.array(growth), np.array(seconds)),
    )
    assert (np.abs(first - second) < 3 * np.hypot(error, its_error)).all()
    assert np.median(np.abs(first - second)) < 1e-4  # the motions are the same


def test_natures(found):
    names = [NATURES[flag] for flag in found.nature.values]
    assert names == ["chaotic", "quasi-periodic", "periodic", "periodic"]
    assert found.regime.values[:2].tolist() == [IRREGULAR] * 2
    assert float(found.lyapunov[0]) > 6 * float(found.lyapunov_stderr[0]) > 0
    assert abs(float(found.lyapunov[1])) < 3 * float(found.lyapunov_stderr[1]) < 0.03
    assert (found.lyapunov[2:] < 0).all() and (found.lyapunov_stderr[2:] == 0).all()
    assert float(found.zero_one[0]) > 0.95 and np.isnan(found.zero_one.values[2:]).all()
    assert found.lyapunov.attrs["units"] == "1/s" and "natural logarithm" in found.attrs["lyapunov"]


def test_they_need_no_orbits_in_the_dataset_and_change_nothing_else(found):
    assert "orbit_reason" not in found
    plain = vj.run_sweep(LANES | {"run": {}}, progress=False).squeeze("start")
    for name in plain.data_vars:
        np.testing.assert_array_equal(found[name], plain[name], err_msg=str(name))
    with_orbits = vj.run_sweep(LANES | {"run": {"lyapunov": True, "orbits": True}}, progress=False).squeeze("start")
    np.testing.assert_array_equal(with_orbits.lyapunov, found.lyapunov)


def test_a_lane_that_is_only_slow_is_not_settled():
    """Observed early it repeats in no way yet; the exponent is that of the orbit which it comes to."""
    early = GAP | {"grid": {"beta": [0.5], "gamma": [0.66]}, "run": {"lyapunov": True, "settle": 20.0}}
    late = early | {"run": {"lyapunov": True, "settle": 300.0}}
    early, late = (vj.run_sweep(tables, progress=False).squeeze() for tables in (early, late))
    assert NATURES[int(early.nature)] == "not-settled" and NATURES[int(late.nature)] == "periodic"
    assert abs(float(early.lyapunov - late.lyapunov)) < 0.02 < -float(late.lyapunov)


def test_a_bit_that_sticks_leaves_a_finite_exponent():
    stuck = vj.run_sweep(
        {"scene": "rotary", "starts": ["stuck"], "grid": {"gamma": [0.7]}, "run": {"lyapunov": True, "orbits": True}},
        progress=False,
    ).squeeze()
    assert float(stuck.stick_fraction) > 0.001 and float(stuck.multiplier_abs[-1]) < 1e-12
    assert np.isfinite(float(stuck.lyapunov))


def test_the_0_1_test_tells_maps_apart():
    """Gottwald and Melbourne's example: the logistic map at mu = 3.55, regular, and 3.97, chaotic; and a rotation."""
    x = np.full(2, 0.3)
    series = []
    for _ in range(1200):
        x = np.array([3.55, 3.97]) * x * (1 - x)
        series.append(x)
    regular, chaotic = zero_one(np.array(series)[200:])
    assert abs(regular) < 0.1 and chaotic > 0.95
    turn = np.cos(2 * np.pi * 0.3819660112501051 * np.arange(1000))[:, None]
    assert abs(zero_one(turn)[0]) < 0.15


def test_refused_and_failed_lanes_have_none():
    failing = vj.run_sweep(
        {"scene": "vibro-impact", "starts": ["stuck"], "unusual": True, "grid": {"k0": [5e7, 1e300]}}
        | {"run": {"lyapunov": True, "settle": 5.0}},
        progress=False,
    ).squeeze()
    assert np.isnan(float(failing.lyapunov[1])) and int(failing.nature[1]) == NATURES.index("unknown")


@pytest.mark.parametrize(
    ("tables", "line"),
    [
        ({"run": {"lyapunov": 1}}, "run.lyapunov: 1 is neither true nor false"),
        ({"run": {"lyapunov": True, "method": "smoothed"}}, 'lyapunov: true has no use with method "smoothed"'),
        (
            {"scene": "penetration", "grid": {"force": [5e4]}, "run": {"lyapunov": True}},
            "true has no use in penetration",
        ),
    ],
)
def test_what_has_no_exponent_is_refused_in_one_line(tables, line):
    with pytest.raises(InputError) as caught:
        vj.read_sweep({"scene": "vibro-impact", "grid": {"gamma": [0.7]}} | tables)
    assert line in str(caught.value) and "\n" not in str(caught.value)


def test_a_wrong_saltation_would_show():
    """With the impact's jump of the velocity left out of the derivative the oscillator's exponent is another one."""

    class Blind(ImpactOscillator):
        def reset(self, c, mode, state, hits):
            mode, (rotor, s, x, v) = super().reset(c, mode, state, hits)
            return mode, (rotor, s, x, jnp.where(hits["wall"], jax.lax.stop_gradient(v), v))

    sweep = vj.read_sweep({"scene": Blind(), "grid": {"restitution": [0.6]}, "parameters": {"frequency": 1.5}})
    state = np.array([[1.0], [-0.5], [0.0]])
    right, wrong = (
        grow(scene, sweep.lane_values(0, 1)[0], state, unit(state), np.ones_like(state), 256)
        for scene in (ImpactOscillator(), Blind())
    )
    one, other = (float(exponents(gone.rate, gone.time)[0][0]) for gone in (right, wrong))
    assert abs(one - other) > 1e-2
