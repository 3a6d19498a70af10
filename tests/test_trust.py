"""Test that foreign code runs as kernels only where kernels agree with XLA, and otherwise on XLA with one warning."""

import json
from dataclasses import replace
from functools import partial

import jax
import numpy as np
import pytest
from jax import lax

import vibrojax as vj
from vibrojax.compile import elementwise, trust
from vibrojax.compile.native import kernels
from vibrojax.compile.trust import KernelRefused, is_foreign
from vibrojax.lanes.agreement import Comparison, lanes_of
from vibrojax.lanes.programs import ProgramKey
from vibrojax.measures import recorder_for
from vibrojax.physics.friction import FRICTION_LAWS, FrictionLaw
from vibrojax.scenes.penetration import PULSE_SHAPES
from vibrojax.scenes.vibro_impact import VibroImpact

STRIBECK = FRICTION_LAWS["stribeck"]


def forget():
    """Clear the process's verdicts and kernels."""
    for known in (trust._refused, trust._trusted, kernels):
        known.clear()


@pytest.fixture
def translation_fault(monkeypatch, tmp_path):
    """Inject a fault into the translation of one function of jax: kernels take erfc(x) for x.

    No sound translation is known to be wrong, so this fault stands for one that nobody knows yet.
    """
    monkeypatch.setenv("VIBROJAX_CACHE", str(tmp_path / "cache"))
    before = dict(kernels)
    forget()
    monkeypatch.setitem(elementwise.RULES, "erfc", elementwise.RULES["copy"])
    yield
    forget()
    kernels.update(before)


def zero_unless_faulty(x):
    """Return zero, but -1 in a kernel with the fault."""
    return lax.erfc(0.0 * x) - 1.0


class FaultInGuard(VibroImpact):
    """A drill whose contact begins elsewhere, with the fault only in the guard."""

    def guards(self):
        friction, contact = super().guards()

        def function(c, mode, state):
            return contact.function(c, mode, state) + 1e-3 * zero_unless_faulty(c.contact.delta)

        return friction, replace(contact, function=function)


def law_with_term(term):
    return FrictionLaw("mine", "eq. 5.9", STRIBECK.parameters, lambda u, p: STRIBECK.mu(u, p) + term(p["mu"]))


def refusal_messages(recorded):
    return [str(warning.message) for warning in recorded if issubclass(warning.category, KernelRefused)]


def compare_kernel(scene, derives=False):
    kind = ProgramKey(scene, vj.Located(), recorder_for(scene))
    return Comparison(kind, lanes_of(kind, ()), derives).difference()


def test_sweep_with_a_fault_runs_on_xla(translation_fault):
    """The results are right, and one warning explains the change: x' = cos(w t) - x swings by 1/sqrt(1 + w²)."""
    lag = vj.System(
        "lag",
        states={"x": "1"},
        parameters={"w": 1.0},
        field=lambda t, y, p: {"x": vj.elementary.cos(p["w"] * t) - y["x"]},
        period=lambda p: 2 * np.pi / p["w"] * (1 + zero_unless_faulty(p["w"])),
    )
    with pytest.warns(KernelRefused) as caught:
        ds = vj.run_sweep({"scene": lag, "grid": {"w": [1.0, 2.0]}, "run": {"end_early": False}}, progress=False)
    [line] = refusal_messages(caught)
    assert line.startswith('scene "lag": its kernel and XLA differ by ') and "\n" not in line
    assert line.endswith("; XLA runs its lanes, which takes longer")
    assert json.loads(ds.attrs["solver"])["compiler"] == "xla"
    np.testing.assert_allclose(ds.x_amplitude.values.ravel(), [0.5**0.5, 0.2**0.5], rtol=1e-6)


def test_comparison_names_differing_quantity(translation_fault):
    differs = compare_kernel(FaultInGuard())
    assert differs is not None and "guards['contact']" in differs.quantity and 1e-5 < differs.relative < 10


@jax.custom_jvp
def zero(x):
    return 0.0 * x


@zero.defjvp
def _(primals, tangents):
    """The derivative is 0, except with the fault."""
    return zero(primals[0]), 0.2 * zero_unless_faulty(primals[0]) * tangents[0]


def test_fault_only_in_derivatives_is_detected(translation_fault):
    scene = vj.SCENES["rotary"](friction=law_with_term(zero))
    assert compare_kernel(scene) is None
    differs = compare_kernel(scene, derives=True)
    assert differs is not None and "derivative" in differs.quantity


@pytest.mark.parametrize(
    "scene, foreign",
    [
        (VibroImpact(), False),
        (VibroImpact(friction=FRICTION_LAWS["coulomb"]), False),
        (VibroImpact(friction=law_with_term(zero_unless_faulty)), True),
        (VibroImpact(friction=FrictionLaw("mine", "", {}, partial(STRIBECK.mu, extra=law_with_term))), True),
        (FaultInGuard(), True),
    ],
)
def test_foreign_code_is_recognised(scene, foreign):
    """Scenes, laws and gauges from outside the package are foreign."""
    assert is_foreign(ProgramKey(scene, vj.Located(), recorder_for(scene))) == foreign


SOUND_SCENES = [
    *(vj.SCENES[name]() for name in vj.SCENES),
    *(VibroImpact(friction=friction_law) for friction_law in FRICTION_LAWS.values() if friction_law is not STRIBECK),
    *(vj.SCENES["penetration"](pulse_shape=shape) for shape in PULSE_SHAPES[1:]),
]


IN_CI = ("rotary-stribeck",)


def scene_id(scene):
    return "-".join([scene.name, *(str(getattr(x, "name", x)) for x in vars(scene).values())])


@pytest.mark.parametrize(
    "scene",
    [pytest.param(x, marks=[pytest.mark.long] * (scene_id(x) not in IN_CI)) for x in SOUND_SCENES],
    ids=scene_id,
)
def test_kernels_of_every_scene_and_law_agree_with_xla(scene):
    """Covers the package's own scenes, which user processes do not compare."""
    assert compare_kernel(scene) is None
