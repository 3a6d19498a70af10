"""Test derivatives through events against central differences of the exact reference, which shares no code with them.

Some tests compare with central differences of the same converged, located motion instead. Differences of a fixed-step
motion are no reference: they lose the derivative of the impact time, and agree with a wrong derivative.
"""

import exact
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.errors import InputError
from vibrojax.measures import RETURNS_FOR_DRIFT
from vibrojax.measures.motion import Swings
from vibrojax.measures.recorder import Effort, Recorder, run_block
from vibrojax.measures.repeats import KeptReturns
from vibrojax.scenes import SCENES
from vibrojax.stepping import Accuracy, Located

EXACT = Effort(Accuracy(tolerance=1e-12, stride=1.0, step=1e9), 1e6)


def derivatives(scene, **given):
    return vj.derivatives(scene, progress=False, **given)


def reasons(result):
    """Return the reasons as text, in the shape of the derivatives."""
    return np.array(result.reason.attrs["flag_meanings"].split())[result.reason.values]


# Values


def exact_slopes(scene, of, by, point, share=1e-5, **times):
    """Return central differences of the exact motion (variables, parameters)."""

    def measured(name, value):
        features = exact.measure(exact.run(scene, **point | {name: value}, **times))
        return np.array([features[variable] for variable in of])

    steps = {name: share * abs(point[name]) for name in by}
    return np.stack(
        [(measured(n, point[n] + h) - measured(n, point[n] - h)) / (2 * h) for n, h in steps.items()], axis=1
    )


DRILL = ("period", "impact_velocity", "stick_fraction", "mean_impact_force")
CASES = {
    "rotary": (("period", "bit_amplitude", "drive_power"), ("gamma", "v"), {"gamma": 0.6, "v": 1.0, "start": "stuck"}),
    "drilling": (
        ("period", "impact_velocity", "rate_of_penetration"),
        ("beta",),
        {"beta": 0.4, "gamma": 0.6, "zeta": 0.5, "threshold": 1e5, "start": "stuck"},
    ),
}


@pytest.mark.parametrize("scene", CASES)
def test_derivatives_match_exact_reference(scene):
    of, by, point = CASES[scene]
    times = {"settle": 4.0, "observe": 2.0}
    result = derivatives(scene, of=of, by=by, **point, **times)
    np.testing.assert_allclose(result.derivative, exact_slopes(scene, of, by, point, **times), rtol=1e-6)


def test_derivatives_match_exact_reference_at_random_points():
    """One point has a gap, the other a preload. At both the motion repeats.

    On a long transient, differences do not give the derivative.
    """
    rng = np.random.default_rng(5)
    size = 4
    points = {
        "beta": rng.uniform(0.3, 0.5, size),
        "gamma": rng.uniform(0.62, 0.8, size),
        "v": rng.uniform(1.0, 2.0, size),
        "delta": np.where(np.arange(size) % 2, -1, 1) * rng.uniform(0.002, 0.006, size),
    }
    by, times = ("beta", "gamma"), {"start": "stuck", "settle": 10.0, "observe": 4.0}
    result = derivatives("vibro-impact", of=DRILL, by=by, **points, **times)
    repeat = np.flatnonzero((reasons(result)[:, 0] != "not-repeating").all(axis=-1))
    gap, preload = (repeat[points["delta"][repeat] * sign > 0][0] for sign in (1, -1))
    for index, name in ((gap, "beta"), (preload, "gamma")):  # the exact motion takes most of the time
        point = {name: float(column[index]) for name, column in points.items()}
        slopes = exact_slopes("vibro-impact", DRILL, (name,), point, **times)[:, 0]
        known = result.measured.values[index] != 0  # one lane never sticks
        derivative = result.derivative.sel(parameter=name).values[index]
        np.testing.assert_allclose(derivative[known], slopes[known], rtol=2e-6)


@pytest.mark.long
def test_pure_function_is_differentiable():
    """Compare one directional derivative, for the scene and the measures that XLA compiles fastest."""
    scene, recorder = SCENES["rotary"](), Recorder((Swings(), KeptReturns(RETURNS_FOR_DRIFT)))
    defaults = {name: parameter.default for name, parameter in scene.parameters().items()}
    wrt, of = ("beta", "gamma", "v", "mu"), ("period", "bit_amplitude")

    def run(values):
        p = {name: jnp.full(1, value) for name, value in defaults.items()}
        p |= {name: values[index : index + 1] for index, name in enumerate(wrt)}
        c = scene.constants(p)
        start = scene.start(c, "drive", (1,))
        read = run_block(scene, Located(), recorder, c, start, EXACT, 4.0, 2.0)
        return jnp.concatenate([read[name] for name in of])

    point = jnp.asarray([defaults[name] for name in wrt])
    result = derivatives("rotary", of=of, by=wrt, settle=4.0, observe=2.0)
    along = point * jnp.array([0.3, -0.5, 0.7, 1.1])
    slope = jax.jit(lambda x: jax.jvp(run, (x,), (along,))[1])(point)
    np.testing.assert_allclose(slope, result.derivative.values @ along, rtol=1e-8)


SHORT = {"settle": 0.3, "observe": 0.2, "zeta": 0.6}
RATE = {"of": "rate_of_penetration", "by": ("force", "threshold", "k3", "zeta")}


def test_rate_of_penetration():
    point = {"force": 250e3, "threshold": 150e3, "k3": 300e6, "zeta": 0.6}
    result = derivatives("penetration", **RATE, **SHORT | point)
    assert result.valid.values.tolist() == [[1, 1, 1, 1]]
    slopes = exact_slopes("penetration", [RATE["of"]], RATE["by"], point, settle=0.3, observe=0.2)
    np.testing.assert_allclose(result.derivative, slopes, rtol=1e-6)


def test_units_and_elasticities():
    result = derivatives("penetration", **RATE, **SHORT)
    assert result.derivative_unit.values.tolist() == [["m s-1 (N)-1", "m s-1 (N)-1", "m s-1 (N m-1)-1", "m s-1"]]
    assert result.unit.values.tolist() == ["m s-1"]
    # With constant stiffness, scaling force and threshold together scales all lengths.
    assert float(result.elasticity.sel(parameter=["force", "threshold"]).sum()) == pytest.approx(1, abs=1e-9)


def test_lists_of_points_match_single_points():
    lists = {"beta": [0.35, 0.4, 0.45], "v": [1.2, 1.5, 1.8]}
    rest = {"of": ("period", "impact_velocity"), "by": ("gamma",), "settle": 3.0, "observe": 3.0}
    together = derivatives("vibro-impact", **lists, **rest)
    assert together.derivative.dims == ("point", "variable", "parameter")
    assert together.beta.values.tolist() == lists["beta"] and together.v.attrs["units"] == "m s-1"
    for index in range(3):
        alone = derivatives("vibro-impact", **{name: x[index] for name, x in lists.items()}, **rest)
        assert alone.derivative.dims == ("variable", "parameter")
        for name in ("measured", "derivative", "drift", "reason"):
            np.testing.assert_array_equal(alone[name], together[name].isel(point=index), name)


# Validity


def test_derivatives_converge_with_settling_time():
    """Check at random points.

    The derivative approaches that of the orbit as the settling time grows. Where it is valid, its error is at most the
    accepted error.
    """
    rng = np.random.default_rng(3)
    size = 12
    points = {
        "beta": rng.uniform(0.2, 0.8, size),
        "gamma": rng.uniform(0.4, 1.0, size),
        "v": rng.uniform(0.5, 2.5, size),
        "delta": rng.uniform(-0.008, 0.008, size),
    }
    given = {"of": ("period", "impact_velocity"), "by": ("beta", "v"), "start": "stuck", **points}
    orbit = derivatives("vibro-impact", settle=120.0, **given)
    shorter = {settle: derivatives("vibro-impact", settle=settle, **given) for settle in (10.0, 20.0, 40.0)}
    held = [int(result.valid.sum()) for result in shorter.values()]
    assert held == sorted(held) and held[0] < held[-1]
    for result in shorter.values():
        valid = (result.valid & orbit.valid).values == 1
        relative = np.abs(result.derivative / orbit.derivative - 1).values[valid]
        insensitive = np.abs(orbit.elasticity.values[valid]) < 1e-3
        assert np.max(relative[~insensitive]) < 1e-3
    settled = orbit.valid.values == 1
    worst = [float(np.abs(run.derivative - orbit.derivative).values[settled].max()) for run in shorter.values()]
    assert worst[0] > 10 * worst[-1]


def test_motion_that_does_not_repeat_has_no_derivative():
    result = derivatives("vibro-impact", of="period", by="beta", delta=0.005, start="drive")  # a weak rattle
    assert reasons(result).tolist() == [["not-repeating"]] and result.valid.values.tolist() == [[0]]


def test_undefined_values_have_no_derivative():
    result = derivatives("vibro-impact", of=("period", "impact_velocity"), by="beta", delta=0.5)  # out of reach
    assert reasons(result).tolist() == [["none"], ["zero-or-undefined"]]
    assert set(reasons(derivatives("penetration", **RATE, **SHORT, force=50e3)).ravel()) == {"zero-or-undefined"}


def test_refused_lanes_are_flagged():
    result = derivatives("penetration", **RATE, pulse_width=0.2, frequency=[4.0, 10.0])
    assert set(reasons(result)[1].ravel()) == {"refused"} and "refused" not in reasons(result)[0]


def test_derivatives_during_settling_are_flagged():
    given = {"of": "period", "by": "gamma", "delta": 0.005, "start": "stuck"}
    assert reasons(derivatives("vibro-impact", settle=5.0, observe=4.0, **given)).tolist() == [["still-settling"]]
    assert reasons(derivatives("vibro-impact", settle=40.0, **given)).tolist() == [["none"]]


def test_order_of_events_changes_at_a_threshold():
    # The number of yields changes at the force whose peak just reaches D.
    low, high = 50e3, 250e3
    for _ in range(8):
        forces = np.linspace(low, high, 16)
        rate = derivatives("penetration", of=RATE["of"], by="force", force=forces, **SHORT).measured.values[:, 0]
        first = int(np.argmax(rate > 0))
        low, high = forces[first - 1 : first + 1]
    at_threshold = derivatives("penetration", **RATE, force=high, **SHORT)
    assert set(reasons(at_threshold).ravel()) == {"order-of-events-changes-nearby"}


def test_order_of_events_changes_at_a_graze():
    """At this gap the free striker just reaches the bit."""
    given = {"of": "striker_amplitude", "by": "delta", "start": "stuck"}
    reach = float(derivatives("vibro-impact", delta=0.5, **given).measured[0])
    low, high = 0.0, 2 * reach
    for _ in range(5):
        gaps = np.linspace(low, high, 10)
        impacts = derivatives("vibro-impact", of="impact_velocity", by="delta", delta=gaps, start="stuck").measured
        free = int(np.argmax(np.isnan(impacts.values[:, 0])))
        low, high = gaps[free - 1 : free + 1]
    result = derivatives("vibro-impact", delta=[high, 1.1 * high], **given)
    assert reasons(result).ravel().tolist() == ["order-of-events-changes-nearby", "none"]


# Refusals


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"of": "rate_of_penetration"}, "of: the scene has no .* to differentiate"),
        ({"of": "impacts"}, "of: the scene has no .* to differentiate; did you mean"),  # a count
        ({"of": []}, "of: is empty; choose from period, "),
        ({"by": "force"}, "by: the scene has no .* to differentiate"),
        ({"beta": [0.4, 0.5], "v": [1.0]}, "v: has 1 values; beta has 2"),
        ({"beta": []}, "beta: has 0 values; at least one is needed"),
        ({"settle": 0.0}, "settle: is 0; it must be above 0 s"),
        ({"error": "small"}, "error: .* is text"),
        ({"bta": 0.4}, "bta: .* did you mean"),
    ],
)
def test_wrong_input_is_refused(given, message):
    with pytest.raises(InputError, match=message):
        derivatives("vibro-impact", **{"of": "period", "by": "beta"} | given)


@pytest.mark.parametrize("transform", [jax.grad, jax.jit, jax.jacfwd])
def test_jax_transformations_are_refused_with_advice(transform):
    def period(beta):
        return derivatives("vibro-impact", of="period", by="beta", beta=beta).measured.values[0]

    with pytest.raises(InputError, match=r"beta: is traced by jax .* derivatives come from vj.derivatives, in forward"):
        transform(period)(0.4)
    with pytest.raises(InputError, match=r"simulate: beta: is traced by jax .* vj.derivatives"):
        transform(lambda beta: vj.simulate("vibro-impact", beta=beta))(0.4)


def test_jax_arrays_are_accepted():
    given = {"of": "rate_of_penetration", "by": "force", **SHORT}
    result = [derivatives("penetration", force=x, **given).derivative.values for x in (250e3, jnp.asarray(250e3))]
    np.testing.assert_array_equal(*result)
