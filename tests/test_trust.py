"""Test that foreign code runs as kernels only where kernels agree with XLA, and otherwise on XLA with one warning."""

import json
import warnings
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import jax
import numpy as np
import pytest
from jax import lax
from own_scenes import Shaken, Switched

import vibrojax as vj
from vibrojax import cli
from vibrojax.compile import KernelRefused, Untranslatable, agreement, elementwise, trust, xla
from vibrojax.compile.native import kernels
from vibrojax.compile.trust import is_foreign
from vibrojax.compile.xla import workers
from vibrojax.lanes.agreement import Comparison, lanes_of, scene_subject
from vibrojax.lanes.compiler import lane_function
from vibrojax.lanes.engine import Batch, Engine
from vibrojax.lanes.programs import ProgramKey
from vibrojax.measures import recorder_for
from vibrojax.physics.friction import FRICTION_LAWS, FrictionLaw
from vibrojax.scenes.penetration import PULSE_SHAPES
from vibrojax.scenes.vibro_impact import VibroImpact

RUN = {"settle": 6.0, "observe": 6.0}
POINT = {"beta": 0.4, "gamma": 0.7, "delta": 0.005}
STRIBECK = FRICTION_LAWS["stribeck"]


def run_kernel(function, static, *arguments, **options):
    return trust.trusted_kernel(function, static, *arguments, policy=scene_subject, **options)(*arguments)


@pytest.fixture
def fresh_process(monkeypatch, tmp_path):
    """Emulate a new process with its own cache."""
    monkeypatch.setenv("VIBROJAX_CACHE", str(tmp_path / "cache"))
    before = dict(kernels)
    forget()
    yield
    forget()
    kernels.update(before)


def forget():
    """Clear the process's verdicts and kernels."""
    for known in (trust._refused, trust._trusted, kernels):
        known.clear()
    trust.newer_than_tested.cache_clear()


@pytest.fixture
def translation_fault(fresh_process, monkeypatch):
    """Inject a fault into the translation of one function of jax: kernels take erfc(x) for x."""
    monkeypatch.setitem(elementwise.RULES, "erfc", elementwise.RULES["copy"])


def zero_unless_faulty(x):
    """Return zero, but -1 in a kernel with the fault."""
    return lax.erfc(0.0 * x) - 1.0


class FaultInConstants(VibroImpact):
    """A drill whose gap the fault moves by a millimetre."""

    def constants(self, p):
        return super().constants(p | {"delta": p["delta"] + 1e-3 * zero_unless_faulty(p["delta"])})


class FaultInGuard(VibroImpact):
    """A drill whose contact begins elsewhere, with the fault only in the guard."""

    def guards(self):
        friction, contact = super().guards()

        def function(c, mode, state):
            return contact.function(c, mode, state) + 1e-3 * zero_unless_faulty(c.contact.delta)

        return friction, replace(contact, function=function)


@dataclass(frozen=True)
class Speed(vj.Gauge):
    """A quantity that the fault changes."""

    variables: ClassVar[dict[str, tuple[str, str]]] = {"my_speed": ("m s-1", "drive speed")}

    def read(self, scene, c, carry, whole):
        return {"my_speed": 1.5 + zero_unless_faulty(whole.time)}


class FaultInGauge(VibroImpact):
    measures = (*VibroImpact.measures, Speed())


def law_with_term(term):
    return FrictionLaw("mine", "eq. 5.9", STRIBECK.parameters, lambda u, p: STRIBECK.mu(u, p) + term(p["mu"]))


def run_small_sweep(scene="vibro-impact"):
    grid = {"gamma": [0.65, 0.7]}
    given = {"scene": scene, "parameters": {"beta": 0.4, "delta": 0.005}, "grid": grid, "run": RUN}
    return vj.run_sweep(given, progress=False)


def compiler(dataset):
    return json.loads(dataset.attrs["solver"])["compiler"]


@pytest.fixture(scope="module")
def correct_sweep():
    return run_small_sweep()


def refusal_messages(recorded):
    return [str(warning.message) for warning in recorded if issubclass(warning.category, KernelRefused)]


WRONG, SOUND = law_with_term(lambda x: 0.1 * zero_unless_faulty(x)), law_with_term(lambda x: 0.0 * x)
ROTARY = vj.SCENES["rotary"]

FAULTY = {
    "constants": (FaultInConstants(), "constants.contact.delta"),
    "guard": (FaultInGuard(), "guards['contact']"),
    "gauge": (FaultInGauge(), "features['my_speed']"),
    "law": (VibroImpact(friction=WRONG), "slip.stick_limit"),
}


SELECT = elementwise.COMPOSED["select_n"]


def compare_kernel(scene, derives=False):
    kind = ProgramKey(scene, vj.Located(), recorder_for(scene), scene.starts)
    return Comparison(kind, lanes_of(kind, ()), derives).difference()


@pytest.fixture
def quick_xla(monkeypatch):
    """Compile sweeps on XLA without optimisations, which takes a tenth of the time."""
    options: dict[str, int | str] = {"xla_backend_optimization_level": 0}
    if jax.__version_info__ < (0, 11, 2):
        options["xla_disable_hlo_passes"] = "cse_barrier_expander,fusion"
    monkeypatch.setattr(xla, "compiler_options", lambda platform: options)


def test_sweep_with_fault_runs_on_xla(translation_fault, quick_xla, correct_sweep):
    """The results are right, and one warning explains the change."""
    with pytest.warns(KernelRefused) as caught:
        own = run_small_sweep(FaultInConstants())
    [line] = refusal_messages(caught)
    assert line.startswith('scene "vibro-impact": its kernel and XLA differ by ') and "\n" not in line
    assert line.endswith("; XLA runs its lanes, which takes longer")
    assert compiler(own) == "xla" and compiler(correct_sweep) == "llvm"
    np.testing.assert_array_equal(own.regime, correct_sweep.regime)
    for name in ("period", "impact_velocity", "bit_amplitude"):
        np.testing.assert_allclose(own[name], correct_sweep[name], rtol=1e-8, err_msg=name)


def test_sweep_with_fault_is_wrong_without_comparison(translation_fault, correct_sweep, monkeypatch):
    """Without the comparison, the fault silently changes the results."""
    monkeypatch.setattr(trust, "is_foreign", lambda kind: False)
    own = run_small_sweep(FaultInConstants())
    assert compiler(own) == "llvm" and np.all(np.abs(own.impact_velocity / correct_sweep.impact_velocity - 1) > 1e-3)


def test_simulate_with_fault_runs_on_xla(translation_fault):
    point = {"beta": 0.4, "gamma": 0.7, "start": "stuck", "duration": 3.0, "progress": False}
    usual = vj.simulate("rotary", **point)
    with pytest.warns(KernelRefused) as caught:
        own = vj.simulate("rotary", friction=WRONG, **point)
    assert len(refusal_messages(caught)) == 1
    np.testing.assert_allclose(own.x1, usual.x1, atol=1e-9)
    np.testing.assert_allclose(own.friction_force, usual.friction_force, rtol=1e-6)


def test_command_warns_on_one_line(translation_fault, quick_xla, monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(FRICTION_LAWS, "mine", WRONG)
    monkeypatch.setattr(warnings, "showwarning", cli._warn)
    text = (
        'scene = "rotary"\n[parameters]\nfriction = "mine"\n[grid]\nbeta = [0.4]\n[run]\nsettle = 1.0\nobserve = 1.0\n'
    )
    (tmp_path / "sweep.toml").write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        assert cli.main(["sweep", str(tmp_path / "sweep.toml"), "-o", str(tmp_path / "out.nc"), "--quiet"]) == 0
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith("vibrojax: warning: scene") and line.endswith("XLA runs its lanes, which takes longer")


@pytest.mark.parametrize("where", FAULTY)
def test_warning_names_differing_quantity(where, translation_fault):
    scene, quantity = FAULTY[where]
    differs = compare_kernel(scene)
    assert differs is not None and quantity in differs.quantity and 1e-5 < differs.relative < 10


@pytest.mark.parametrize("primitive", ["max", "abs", "select_n"])
def test_fault_of_common_operation_is_detected(primitive, fresh_process, monkeypatch):
    """numpy takes the place of XLA for these."""
    if primitive == "select_n":
        monkeypatch.setitem(
            elementwise.COMPOSED, primitive, lambda asm, entries: SELECT(asm, [entries[0], *entries[:0:-1]])
        )
    else:
        monkeypatch.setitem(elementwise.RULES, primitive, elementwise.RULES["min" if primitive == "max" else "neg"])
    assert compare_kernel(Switched()) is not None


def twice(scene, x):
    return 2 * x


def thrice(scene, x):
    return 3 * x


def test_all_programs_of_refused_scene_avoid_kernels(translation_fault):
    """Orbits, trajectories and other programs avoid kernels too, even those that would be right."""
    scene, x = ROTARY(friction=WRONG), np.arange(3.0)
    with pytest.warns(KernelRefused) as caught, pytest.raises(Untranslatable, match="differ by"):
        run_kernel(twice, (scene,), x)
    assert len(refusal_messages(caught)) == 1
    with warnings.catch_warnings(), pytest.raises(Untranslatable):
        warnings.simplefilter("error")
        run_kernel(twice, (scene, vj.Located()), x, derives=True)
    np.testing.assert_array_equal(lane_function(static=1)(twice)(scene, x), 2 * x)
    np.testing.assert_array_equal(run_kernel(twice, (VibroImpact(),), x), 2 * x)


def test_scene_without_kernels_is_compared_once(fresh_process, monkeypatch):
    """XLA runs all its programs. There is no warning, because nothing differs."""
    attempts = []
    monkeypatch.setattr(Comparison, "__init__", lambda self, *arguments: attempts.append(arguments) or raise_no_rule())
    for _ in range(2):
        with pytest.raises(Untranslatable, match="no rule"):
            run_kernel(lambda scene, x: 2 * x, (ROTARY(friction=WRONG),), np.arange(3.0))
    assert len(attempts) == 1


def raise_no_rule():
    raise Untranslatable("no rule")


def test_lanes_on_orbits_switch_to_xla(translation_fault, quick_xla):
    read = vj.read_sweep({"scene": ROTARY(friction=WRONG), "grid": {"gamma": [0.65, 0.7]}, "run": RUN})
    engine = Engine(read.system, read.run, read.start_names, vj.Located(), recorder_for(read.system), workers())
    given = engine.given(read.inputs())
    batch = Batch(
        read.run.accuracy(read.system), np.arange(4), given, np.zeros(4), np.ones(4), None, np.zeros(4, np.int32)
    )
    state = (np.full(4, 0.01), *np.zeros((3, 4)))
    with pytest.warns(KernelRefused):
        begun = engine.on_orbit(batch, state, np.zeros((8, 3, 4)), np.zeros((8, 4)), np.ones(4))
    assert engine.programs.compiler == "xla"
    np.testing.assert_array_equal(begun.underway.lane.state, state)


@jax.custom_jvp
def zero(x):
    return 0.0 * x


@zero.defjvp
def _(primals, tangents):
    """The derivative is 0, except with the fault."""
    return zero(primals[0]), 0.2 * zero_unless_faulty(primals[0]) * tangents[0]


def test_fault_only_in_derivatives_is_detected(translation_fault):
    scene = VibroImpact(friction=law_with_term(zero))
    assert compare_kernel(scene) is None
    differs = compare_kernel(scene, derives=True)
    assert differs is not None and "derivative" in differs.quantity


@pytest.fixture
def comparisons(monkeypatch):
    """Return a list that grows with every comparison."""
    made = []
    difference = Comparison.difference
    monkeypatch.setattr(Comparison, "difference", lambda self: made.append(self) or difference(self))
    return made


def test_sound_code_runs_as_kernels(fresh_process, comparisons, monkeypatch):
    """A scene is compared once, not again for its second kernel or in the next process."""
    for cache, count in (("on", 1), ("on", 1), ("off", 2)):
        if cache == "off":
            monkeypatch.setenv("VIBROJAX_CACHE", cache)
        forget()
        for function in (twice, thrice):
            run_kernel(function, (ROTARY(friction=SOUND),), np.arange(3.0))
        assert len(comparisons) == count


def test_simulate_compares_once(fresh_process, comparisons):
    """All parts of a trajectory's program, and the next process, share one verdict."""
    for _ in range(2):
        vj.simulate("rotary", friction=SOUND, duration=0.5, progress=False)
        assert len(comparisons) == 1
        forget()


def test_refusal_is_cached(translation_fault, comparisons):
    """The next process repeats the warning without a comparison."""
    lines = []
    for _ in range(2):
        with pytest.warns(KernelRefused) as caught, pytest.raises(Untranslatable):
            run_kernel(twice, (ROTARY(friction=WRONG),), np.arange(3.0))
        lines += refusal_messages(caught)
        forget()
    assert len(lines) == 2 and lines[0] == lines[1] and len(comparisons) == 1


def test_own_scenes_are_compared_with_newer_version(fresh_process, comparisons, monkeypatch):
    run_kernel(twice, (ROTARY(),), np.arange(3.0))
    assert not comparisons
    monkeypatch.setitem(trust.TESTED_VERSIONS, "jax", ("0.0.1",))
    for _ in range(2):
        forget()
        run_kernel(twice, (ROTARY(),), np.arange(3.0))
        assert len(comparisons) == 1


@pytest.mark.parametrize("package", ["jax", "llvmlite"])
def test_newer_versions_are_recognised(package, fresh_process, monkeypatch):
    assert not trust.newer_than_tested()
    monkeypatch.setitem(trust.TESTED_VERSIONS, package, ("0.0.1", "0.0.2"))
    trust.newer_than_tested.cache_clear()
    assert trust.newer_than_tested()


def test_tolerances_and_versions():
    assert agreement.AGREEMENT_TOLERANCE == {"float64": 1e-10, "float32": 1e-4}
    assert trust.TESTED_VERSIONS == {"jax": ("0.10.2", "0.12.0.1"), "llvmlite": ("0.50.0",)}
    assert (
        trust._version_numbers("0.12.0.1") > trust._version_numbers("0.12.0") > trust._version_numbers("0.10.2+local")
    )


class ForeignStepper(vj.Located):
    """A stepper from outside the package."""


@pytest.mark.parametrize(
    "scene, foreign",
    [
        *((scene(), False) for scene in vj.SCENES.values()),
        *((VibroImpact(friction=friction_law), False) for friction_law in FRICTION_LAWS.values()),
        (VibroImpact(friction=FrictionLaw("mine", "eq. 5.9", STRIBECK.parameters, STRIBECK.mu)), False),
        (VibroImpact(friction=law_with_term(zero_unless_faulty)), True),
        (VibroImpact(friction=FrictionLaw("mine", "", {}, partial(STRIBECK.mu, extra=law_with_term))), True),
        (VibroImpact(friction=replace(STRIBECK, mu_impact=law_with_term(zero_unless_faulty).mu)), True),
        (VibroImpact(friction=replace(STRIBECK, flat_below=lambda p: 0.0)), True),
        (FaultInConstants(), True),
        (FaultInGauge(), True),
        (Switched(), True),
        (ForeignStepper(), True),
    ],
)
def test_foreign_code_is_recognised(scene, foreign):
    """Scenes, laws, gauges and steppers from outside the package are foreign."""
    scene, stepper = (VibroImpact(), scene) if isinstance(scene, ForeignStepper) else (scene, vj.Located())
    assert is_foreign(ProgramKey(scene, stepper, recorder_for(scene), scene.starts)) == foreign


SOUND_SCENES = [
    *(vj.SCENES[name]() for name in vj.SCENES),
    *(VibroImpact(friction=friction_law) for friction_law in FRICTION_LAWS.values() if friction_law is not STRIBECK),
    *(vj.SCENES["penetration"](pulse_shape=shape) for shape in PULSE_SHAPES[1:]),
    Switched(),
    Shaken(),
]


def scene_id(scene):
    return "-".join([scene.name, *(str(getattr(x, "name", x)) for x in vars(scene).values())])


@pytest.mark.parametrize(
    "scene",
    [
        pytest.param(x, marks=[pytest.mark.long] * (getattr(x, "friction", STRIBECK) is not STRIBECK))
        for x in SOUND_SCENES
    ],
    ids=scene_id,
)
def test_kernels_of_every_scene_and_law_agree_with_xla(scene):
    """Covers the package's own scenes, which user processes do not compare, and the scenes of the tests."""
    assert compare_kernel(scene) is None
