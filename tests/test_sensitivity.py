"""Test derivatives at periodic orbits against central differences of other converged orbits and closed forms.

The second half tests `as_jax`, in the same file because both use the same compiled programs.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize
from systems import IMPACT_OSCILLATOR, oscillator_orbits

import vibrojax as vj
from vibrojax.errors import InputError
from vibrojax.periodic.derivatives import DERIVATIVE_REASONS, orbit_variables
from vibrojax.periodic.orbits import Orbits
from vibrojax.periodic.return_map import Segments
from vibrojax.scenes import SCENES

BY = ("beta", "gamma")  # as `as_jax` below
STEP = 1e-6
MOTIONS = {  # by name: beta, gamma, v, delta, start, cycles
    "single impact": (0.4, 0.75, 1.5, 0.005, "stuck", 1),
    "no impact": (0.4, 0.75, 1.5, 0.5, "stuck", 1),
    "two returns": (0.6, 0.3, 1.5, -0.005, "drive", 2),
    "irregular": (0.601, 0.818, 1.5, 0.005, "stuck", 0),
}


@pytest.fixture(scope="module")
def map_of_motions():
    """Return the sweep and sensitivities of the motions and of copies with a parameter changed: (change, motion)."""
    moves = [np.array([0.0, 0.0, 0.0, 0.0])]
    moves += [sign * STEP * (np.arange(4) == place) for place in range(len(BY)) for sign in (1, -1)]
    rows = [np.array(motion[:4]) * (1 + move) for move in moves for motion in MOTIONS.values()]
    points = dict(zip(("beta", "gamma", "v", "delta"), np.transpose(rows).tolist(), strict=True))
    points["start"] = [motion[4] for _ in moves for motion in MOTIONS.values()]
    sweep = {"scene": "vibro-impact", "points": points, "run": {"orbits": True}, "unusual": True}
    ds = vj.run_sweep(sweep, progress=False)
    return ds, vj.sensitivity(ds, by=BY, progress=False)


def test_derivatives_agree_with_central_differences_of_lanes(map_of_motions):
    _, s = map_of_motions
    count = len(MOTIONS)
    names = [str(name) for name in s.data_vars if f"d_{name}" in s]
    assert {"period", "impact_power", "peak_impact_force", "impact_phase", "multiplier_abs", "grazing_margin"} <= {
        *names
    }
    for place, name in enumerate(BY):
        up, down = (s.isel(point=slice((2 * place + k) * count, (2 * place + k + 1) * count)) for k in (1, 2))
        for variable in names:
            values = s["parameter_value"].isel(point=slice(0, count)).sel(parameter=name).values
            values = values.reshape(-1, *[1] * (s[variable].ndim - 1))
            slope = (up[variable].values - down[variable].values) / (2 * STEP * values)
            derivative = s[f"d_{variable}"].isel(point=slice(0, count)).sel(parameter=name).values
            scale = np.abs(derivative) + 0.1 * np.abs(s[variable].values[:count]) / values
            deviation = np.abs(slope - derivative) / np.where(scale > 0, scale, 1)
            assert np.nanmax(deviation) < 1e-6, (variable, name, deviation)


def test_missing_derivatives_have_reason(map_of_motions):
    ds, s = map_of_motions
    count = len(MOTIONS)
    reasons = np.array(DERIVATIVE_REASONS)[s.reason.values[:count]]
    assert dict(zip(MOTIONS, reasons, strict=True)) == {**dict.fromkeys(MOTIONS, "none"), "irregular": "no-orbit"}
    assert ds.orbit_cycles.values[:count].tolist() == [motion[5] for motion in MOTIONS.values()]
    assert ((s.valid == 1) == (s.reason == 0)).all()
    for name in s.data_vars:
        if str(name).startswith("d_"):
            alike = s[name].isnull() == s[str(name).removeprefix("d_")].isnull()
            assert alike.where(s.valid == 1, True).all(), name
            assert s[name].isel(point=3).isnull().all()
    assert s.d_impact_velocity.isel(point=1).isnull().all() and (s.d_impact_power.isel(point=1) == 0).all()


def converged_lane(scene, values, returns=200):
    """Return the parameters of one lane and the state to which the return map converges."""
    p = {name: np.array([parameter.default]) for name, parameter in scene.parameters().items()}
    p |= {name: np.array([x]) for name, x in values.items()}
    driving = scene.driving_part()
    own = {name: p[name] for name in driving.parameters()}
    go, state = Segments(driving), np.array([[-0.05], [-0.05], [0.0]])
    for _ in range(returns):
        state = np.asarray(go(own, state).state)
    return p, state.T[None]


def orbit_at(scene, p, guess):
    return Orbits.find(scene, p, guess).refined()


def test_derivatives_near_grazing_are_marked_invalid():
    """The grazing margin of a striker that turns before the bit is linear in the gap. Its slope predicts the graze."""
    scene, of = SCENES["vibro-impact"](), ("grazing_margin", "period")
    p, guess = converged_lane(scene, {"beta": 0.4, "gamma": 0.75, "delta": 0.034})
    orbit = orbit_at(scene, p, guess)
    far = orbit.derivatives(of, ("delta",))
    assert orbit.impacts == 0 and not far.reason.any()
    margin, slope = far.values[0, 0], far.derivatives[0, 0, 0]
    for close, reason in ((1e-3, "none"), (1e-5, "near-grazing")):
        near = orbit_at(scene, p | {"delta": p["delta"] - (margin - close) / slope}, guess).derivatives(of, ())
        assert near.values[0, 0] == pytest.approx(close, rel=1e-6)
        assert near.reason[0].tolist() == [DERIVATIVE_REASONS.index(reason)] * 2


@pytest.mark.long
def test_derivatives_with_rock_agree_with_central_differences_of_orbits():
    values, by = {"beta": 0.4, "gamma": 0.6, "zeta": 0.5, "threshold": 1e5}, ("beta", "threshold")
    scene = SCENES["drilling"]()
    p, guess = converged_lane(scene, values)
    of = ("rate_of_penetration", "relief", "deepest_gap", "impact_energy", "log_multiplier")
    whole = orbit_at(scene, p, guess)
    orbit = whole.derivatives(of, by)
    assert set(of) <= set(orbit_variables(scene)) and not orbit.reason.any()
    for place, varied in enumerate(by):
        step = STEP * values[varied]
        moved = (orbit_at(scene, p | {varied: p[varied] + h}, whole.states) for h in (step, -step))
        up, down = (orbit.derivatives(of, ()) for orbit in moved)
        slope, scale = (up.values - down.values)[0] / (2 * step), 0.1 * np.abs(orbit.values[0]) / values[varied]
        np.testing.assert_array_less(np.abs(slope - orbit.derivatives[0, :, place]), 1e-6 * scale)


# One point


DRILL = {"beta": 0.4, "gamma": 0.75, "v": 1.5, "delta": 0.005, "start": "stuck"}


def at_point(scene="vibro-impact", **given):
    return vj.sensitivity(scene, progress=False, **given)


def impact_speed(**point):
    return oscillator_orbits(R=point.pop("r"), stiffness=1.0, **point)[-1].speed


def test_own_system_agrees_with_closed_form():
    point, step = {"a": 1.0, "w": 0.9, "damping": 0.1, "stop": 1.0, "r": 0.7}, 1e-6
    s = at_point(IMPACT_OSCILLATOR, of=["impact_velocity", "period"], by=["w", "r"], **point)
    assert s["valid"] == 1 and s.impact_velocity == pytest.approx(impact_speed(**point), rel=1e-8)
    for name in ("w", "r"):
        x = point[name]
        up, down = (impact_speed(**point | {name: x + sign * step}) for sign in (1, -1))
        assert s.d_impact_velocity.sel(parameter=name) == pytest.approx((up - down) / (2 * step), rel=1e-7)
    assert s.d_period.values == pytest.approx([-2 * np.pi / point["w"] ** 2, 0], abs=1e-9)


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"beta": 0.601, "gamma": 0.818}, "no-orbit"),  # irregular
        ({"delta": 0.5}, "undefined"),  # no impact
    ],
)
def test_point_without_derivative_has_reason(given, reason):
    s = at_point(of=["impact_velocity"], by=["v"], **DRILL | given)
    assert DERIVATIVE_REASONS[int(s.reason)] == reason and s["valid"] == 0 and s.d_impact_velocity.isnull().all()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"of": ["peroid"]}, 'of: the scene has no "peroid" to differentiate; did you mean "period"'),
        ({"of": ["impacts"]}, 'of: the scene has no "impacts" to differentiate'),
        ({"beta": [0.4, 0.5]}, "beta: .* is not a number"),
    ],
)
def test_wrong_points_are_refused(given, message):
    with pytest.raises(InputError, match=message):
        at_point(**given)


# Functions of JAX arrays


OF = ("impact_power", "period")
FIXED = {"start": "stuck", "delta": 0.005}
HERE = np.array([0.4, 0.75])
BEYOND = np.array([0.6, 0.5])  # on the path from HERE the stick phase vanishes, and the orbit with it


def jax_function(**arguments):
    f = vj.as_jax("vibro-impact", of=OF, by=["beta", "gamma"], **FIXED | arguments)
    f(HERE)
    return f


@pytest.fixture(scope="module")
def f():
    return jax_function()


def test_values_and_gradients_agree_with_sensitivity(f):
    sweep = {"scene": "vibro-impact", "parameters": {"beta": 0.42, "gamma": 0.7, "delta": 0.005}, "starts": ["stuck"]}
    s = vj.sensitivity(sweep, by=["beta", "gamma"], progress=False)
    x = jnp.array([0.42, 0.7])
    values = f(x)
    assert bool(values["valid"]) and values["margin"] == pytest.approx(np.log(s.multiplier_abs.values.max()), rel=1e-9)
    for name in (*OF, "grazing_margin"):
        assert values[name] == pytest.approx(s[name].item(), rel=1e-9)
        gradient = jax.grad(lambda x, name=name: f(x)[name])(x)
        np.testing.assert_allclose(gradient, s[f"d_{name}"].values.ravel(), rtol=1e-8)


def test_transformations_and_precisions(f):
    points = jnp.array([[0.4, 0.75], [0.41, 0.73], BEYOND])
    alone = [jax.value_and_grad(lambda x: f(x)["impact_power"])(x) for x in points]
    values, gradients = jax.jit(jax.vmap(jax.value_and_grad(lambda x: f(x)["impact_power"])))(points)
    np.testing.assert_allclose(values, [value for value, _ in alone], rtol=1e-12)
    np.testing.assert_allclose(gradients, [gradient for _, gradient in alone], rtol=1e-9)
    assert jax.jit(jax.vmap(f))(points)["valid"].tolist() == [True, True, False]
    nested = jax.jacrev(jax.vmap(jax.vmap(lambda x: f(x)["period"])))(points[None])
    np.testing.assert_allclose(nested[0, 1, 0, 1], jax.jacfwd(lambda x: f(x)["period"])(points[1]), rtol=1e-12)
    with jax.enable_x64(False):
        single = jax.value_and_grad(lambda x: f(x)["impact_power"])(jnp.array([0.4, 0.75]))
        assert single[1].dtype == jnp.float32
        np.testing.assert_allclose(single[1], alone[0][1], rtol=1e-4)
    with pytest.raises(InputError, match=r"as_jax: second derivatives are not available; use finite differences"):
        jax.hessian(lambda x: f(x)["period"])(HERE)


@pytest.mark.long
def test_results_do_not_depend_on_other_calls_or_neighbours_in_a_batch():
    """Each function is new, so that no result is a stored one; the results agree bit for bit."""
    points = np.random.default_rng(5).uniform([0.3, 0.5], [0.7, 1.1], (6, 2))
    points[0] = [0.5941523925535459, 0.7872783245445198]  # from a neighbour, another orbit is nearer than on the line

    def results(order, size):
        f = jax_function(at=HERE)
        batch = jax.jit(jax.vmap(lambda x: (f(x), jax.jacrev(lambda x: jnp.stack([f(x)[name] for name in OF]))(x))))
        parts = [batch(jnp.asarray(points[order[k : k + size]])) for k in range(0, len(order), size)]
        table = {name: np.concatenate([values[name] for values, _ in parts]) for name in parts[0][0]}
        table["gradient"] = np.concatenate([gradient for _, gradient in parts])
        return {name: x[np.argsort(order)] for name, x in table.items()}

    forth = np.arange(len(points))
    alone = results(forth, 1)
    assert 0 < alone["valid"].sum() < len(points)
    other = results(forth[::-1], 3)
    for name, x in alone.items():
        np.testing.assert_array_equal(x, other[name])


def test_values_outside_region_of_validity(f):
    """There the function returns finite values, those of the last valid orbit on the path, or NaN."""
    beyond = f(BEYOND)
    gradient = jax.grad(lambda x: f(x)["period"])(BEYOND)
    assert not beyond["valid"] and np.isfinite([*gradient, *(beyond[name] for name in OF)]).all()
    assert f.reason(BEYOND).startswith("beyond-branch: from beta = 0.4")
    unknown = jax_function(outside="nan")
    assert np.isnan([unknown(BEYOND)[name] for name in OF]).all() and not unknown(BEYOND)["valid"]
    assert np.isnan(jax.grad(lambda x: unknown(x)["period"])(BEYOND)).all()
    assert jnp.isfinite(unknown(HERE)["period"])


def test_optimizer_converges(f):
    """If the stability margin is bounded, the maximum of the power lies on the bound."""
    scale, least = 1e-3, 0.4
    value = jax.jit(jax.value_and_grad(lambda x: -scale * f(x)["impact_power"]))
    margin = jax.jit(jax.value_and_grad(lambda x: -f(x)["margin"] - least))
    bound = {"type": "ineq", "fun": lambda x: margin(x)[0], "jac": lambda x: np.asarray(margin(x)[1])}
    best = minimize(
        lambda x: tuple(map(np.asarray, value(x))), HERE, jac=True, method="SLSQP", constraints=[bound],
        bounds=[(0.35, 0.45), (0.65, 0.8)],
    )  # fmt: skip
    assert best.success and f(jnp.asarray(best.x))["valid"]
    assert f(jnp.asarray(best.x))["margin"] == pytest.approx(-least, abs=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"of": "impacts"}, r"as_jax: of: the scene has no .impacts. to differentiate"),
        ({"outside": "zero"}, "as_jax: outside: .zero. is unknown; choose from nearest, nan"),
    ],
)
def test_wrong_arguments_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        vj.as_jax("vibro-impact", **{"of": "period", "by": ["beta", "gamma"]} | arguments)


@pytest.mark.long
def test_orbit_continues_where_an_impact_passes_the_section():
    """At a = 0.84 the state at the section jumps, and nothing else; the motion is that of a closed form."""
    point = {"w": 0.9, "damping": 0.1, "stop": 1.0, "r": 0.7}
    f = vj.as_jax(IMPACT_OSCILLATOR, of="impact_velocity", by="a", at=[1.0], **point)
    for a in (0.8, 0.6):
        assert f([a])["valid"] and f([a])["impact_velocity"] == pytest.approx(impact_speed(a=a, **point), rel=1e-8)
        slope = (impact_speed(a=a + 1e-6, **point) - impact_speed(a=a - 1e-6, **point)) / 2e-6
        assert jax.grad(lambda x: f(x)["impact_velocity"])(jnp.array([a])) == pytest.approx(slope, rel=1e-6)


@pytest.mark.long
def test_derivatives_of_grazing_margin_of_own_system():
    """The margin is a ratio, so that no unit of length or of time changes it; central differences confirm its slope."""
    p, h = {name: parameter.default for name, parameter in IMPACT_OSCILLATOR.parameters().items()}, 1e-5
    rows = [p, p | {"w": p["w"] + h}, p | {"w": p["w"] - h}]
    points = {name: [row[name] for row in rows] for name in p}
    run = {"settle": 400.0, "observe": 100.0}
    sweep = {"scene": IMPACT_OSCILLATOR, "points": points, "starts": [[0.0, 0.0]], "run": run}
    ds = vj.sensitivity(sweep, by=list(p), progress=False).squeeze("start")
    margin, up, down = ds.grazing_margin.values
    slopes = {name: ds.d_grazing_margin.sel(parameter=name).values[0] * p[name] for name in p}
    assert margin > 0.1 and abs(slopes["a"]) > 0.1
    assert slopes["a"] + slopes["stop"] == pytest.approx(0.0, abs=1e-8)
    assert slopes["w"] + slopes["damping"] + 2 * (slopes["stiffness"] + slopes["a"]) == pytest.approx(0.0, abs=1e-8)
    assert slopes["w"] / p["w"] == pytest.approx((up - down) / (2 * h), rel=1e-6)
