"""Test the function of `as_jax`: values and gradients, reasons, pickling, Ctrl-C, settings of jax, sharded arrays."""

import pickle
import signal
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refusal
from systems import WALLS, mass

import vibrojax as vj
from vibrojax.studies import as_jax as branch

OF = ("impact_power", "period")
HERE = np.array([0.4, 0.75])
BEYOND = np.array([0.6, 0.5])  # on the path from HERE the stick phase vanishes, and the orbit with it


def _function(**arguments):
    known = {"of": OF, "by": ["beta", "gamma"], "start": "stuck", "delta": 0.005, "at": HERE}
    return vj.as_jax("vibro-impact", **known | arguments)


@pytest.fixture(scope="module")
def f():
    return _function()


def test_reason_is_none_exactly_where_function_is_valid(f):
    points = [np.array([beta, 0.75]) for beta in np.linspace(0.35, 0.9, 6)]
    valid = [bool(f(x)["valid"]) for x in points]
    assert [f.reason(x) == "none" for x in points] == valid and 0 < sum(valid) < 6
    assert f.reason([np.nan, 0.75]) == "undefined: beta = nan, gamma = 0.75"
    assert f.reason(BEYOND).startswith("beyond-branch: from beta = 0.4, gamma = 0.75, the orbit continues to beta =")


def test_features_that_the_orbit_lacks_have_no_gradient():
    """Without impacts there is no impact velocity. In both modes, the period's derivatives do not depend on it."""
    with pytest.warns(vj.UnusualValue):
        f = _function(of=["impact_velocity", "period"], delta=0.5)
    assert not f(HERE)["valid"] and f.reason(HERE) == "undefined: the orbit has no derivative of impact_velocity"
    slope = jax.grad(lambda x: f(x)["period"])(jnp.asarray(HERE))
    for jacobian in (jax.jacfwd, jax.jacrev):
        slopes = jax.jit(jacobian(lambda x: {name: f(x)[name] for name in ("impact_velocity", "period")}))(HERE)
        assert np.isnan(slopes["impact_velocity"]).all() and np.isfinite(slope).all()
        np.testing.assert_array_equal(slopes["period"], slope)


def test_parameters_that_simulate_refuses_are_not_valid():
    """The branch ends at the least damping, 0; the laws of nature go on with a negative one."""
    f = _function(by="c2", at=[250.0])
    assert f([0.0])["valid"] and f.reason([-5.0]) == "refused: c2 is -5; it must be at least 0 N s m-1"
    assert not f([-5.0])["valid"] and f([-5.0])["period"] == pytest.approx(float(f([0.0])["period"]), rel=1e-7)


def test_reason_without_orbit():
    """A growing oscillation does not settle."""
    spiral = mass(lambda t, y, p: p["growth"] * y["v"] - y["x"], parameters={"growth": 0.3}, section="x")
    f = vj.as_jax(spiral, of="period", by="growth", start=[1.0, 0.0])
    assert np.isnan(f(jnp.array([0.3]))["period"])
    reason = "no-orbit: no motion from [1.0, 0.0] settles on a stable periodic orbit at growth = 0.3"
    assert f.reason([0.3]).startswith(reason)


def test_points_are_checked(f):
    assert "as_jax: the array has the type complex64; give real numbers" in refusal(f, np.complex64(HERE))
    with pytest.raises(vj.InputError, match=r"as_jax: at: .* give a list of one number for each of beta, gamma"):
        _function(at=[0.4])
    assert "as_jax: at[0]: is -1; it must be above 0" in refusal(_function, at=[-1.0, 0.75])
    with pytest.raises(vj.InputError, match=r"as_jax: outside: .zero. is unknown; choose from nearest, nan"):
        _function(outside="zero")
    assert jax.vmap(f)(jnp.zeros((0, 2)))["period"].shape == (0,)


def test_function_is_pickled_with_its_orbit():
    f, x = _function(of="period", at=None), jnp.array([0.42, 0.7])
    f(HERE)
    copy = pickle.loads(pickle.dumps(f))
    for name, value in f(x).items():
        assert value == copy(x)[name]
    assert repr(copy) == repr(f) and 'start "stuck" at beta = 0.4, gamma = 0.75' in repr(f)
    assert "[beta, gamma] -> period, margin, grazing_margin, valid" in repr(f)
    assert "f.reason(x)" in type(f).__doc__


def test_interrupt_is_raised_as_such(monkeypatch):
    """While jax calls back, every exception becomes an error of XLA. Only a patch can interrupt at that moment."""
    f = _function()
    call, x = jax.jit(jax.grad(lambda x: f(x)["period"] + f(x + 1e-3)["period"])), jnp.asarray(HERE)
    expected = np.asarray(call(x))

    def interrupted(self, x):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(branch.Branch, "evaluate", interrupted)
        call(x)
        for _ in range(600):  # the interrupt comes between two of these pauses
            time.sleep(0.1)
    signal.signal(signal.SIGINT, before)
    np.testing.assert_array_equal(call(x), expected)


@pytest.mark.long
def test_arrays_on_a_mesh(f):
    mesh, spec = jax.make_mesh((1,), ("i",), axis_types=(jax.sharding.AxisType.Explicit,)), jax.sharding.PartitionSpec
    points = jnp.asarray([HERE, HERE + 0.01])
    batch = jax.vmap(lambda x: f(x)["period"])
    gradients = jax.vmap(jax.grad(lambda x: f(x)["period"]))
    with jax.set_mesh(mesh):
        x = jax.device_put(points, spec("i", None))
        for function in (batch, gradients):
            np.testing.assert_allclose(function(x), function(points), rtol=1e-13)
            np.testing.assert_allclose(jax.jit(function)(x), function(points), rtol=1e-13)
    with pytest.raises(vj.InputError, match=r"as_jax: .* explicit axes; call it inside of jax.set_mesh\(mesh\)"):
        jax.jit(batch)(x)


NUMBERS = {
    "duration": lambda x: vj.simulate("vibro-impact", duration=x),
    "data": lambda x: vj.calibrate({"scene": "vibro-impact", "data": {"period": [x]}, "unknown": {"mu": [0.2, 0.6]}}),
    "reason": lambda x: _function().reason(x * HERE),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_traced_numbers_are_refused_with_advice(name):
    with pytest.raises(vj.InputError, match=r"^[^\n]* is traced by jax [^\n]* or use vj.as_jax"):
        jax.jit(NUMBERS[name])(0.4)


def test_branch_ends_at_pitchfork():
    """A symmetric orbit between two walls meets its two twins at a pitchfork, where its own multiplier is 1. Close to
    it they are less than 1 % apart: a twin that is followed beyond does not become the symmetric orbit, which is stable
    there, nor does the symmetric orbit become a twin on the other side."""
    twin, symmetric = (vj.as_jax(WALLS, of="impact_velocity", by="d", start=[0.1, 0.3], at=[at]) for at in (0.32, 0.4))
    d = np.array([[0.32], [0.34], [0.345], [0.37]])
    for function in twin, symmetric:
        function(d[0])
    own, other = twin._branch.evaluate(d), symmetric._branch.evaluate(d)
    assert own.valid.tolist() == [True, True, False, False] and other.valid.tolist() == [False, False, True, True]
    assert (other.values[:2, 1] > 0).all()  # unstable
    meeting = symmetric._branch.evaluate(own.reached[2:])
    np.testing.assert_allclose(meeting.values[:, 1], 0, atol=1e-5)
    np.testing.assert_allclose(meeting.values[:, 0], own.values[2:, 0], rtol=1e-6)


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
    with pytest.raises(vj.InputError, match=r"as_jax: second derivatives are not available; use finite differences"):
        jax.hessian(lambda x: f(x)["period"])(HERE)


def test_values_outside_region_of_validity(f):
    """There the function returns finite values, those of the last valid orbit on the path, or NaN."""
    beyond = f(BEYOND)
    gradient = jax.grad(lambda x: f(x)["period"])(BEYOND)
    assert not beyond["valid"] and np.isfinite([*gradient, *(beyond[name] for name in OF)]).all()
    assert f.reason(BEYOND).startswith("beyond-branch: from beta = 0.4")
    unknown = _function(outside="nan")
    assert np.isnan([unknown(BEYOND)[name] for name in OF]).all() and not unknown(BEYOND)["valid"]
    assert np.isnan(jax.grad(lambda x: unknown(x)["period"])(BEYOND)).all()
    assert jnp.isfinite(unknown(HERE)["period"])
