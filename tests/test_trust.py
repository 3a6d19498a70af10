"""Foreign code runs as kernels only where these agree with XLA; else XLA runs it, and one line says so."""

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
from vibrojax.compile import KernelRefused, Untranslatable, agreement, trust, xla
from vibrojax.compile.kernels import elementwise, kernels
from vibrojax.compile.trust import is_foreign
from vibrojax.compile.xla import workers
from vibrojax.measures import recorder_for
from vibrojax.models.physics.friction import FRICTION_LAWS, FrictionLaw
from vibrojax.models.scenes.penetration import PULSE_SHAPES
from vibrojax.models.scenes.vibro_impact import VibroImpact
from vibrojax.sweep.engine.agreement import Comparison, lanes_of, scene_subject
from vibrojax.sweep.engine.batch import Batch, Engine
from vibrojax.sweep.engine.compiler import lane_function
from vibrojax.sweep.engine.programs import Kind

RUN = {"settle": 6.0, "observe": 6.0}
POINT = {"beta": 0.4, "gamma": 0.7, "delta": 0.005}
STRIBECK = FRICTION_LAWS["stribeck"]


def run_kernel(function, static, *arguments, **options):
    return trust.trusted_kernel(function, static, *arguments, policy=scene_subject, **options)(*arguments)


@pytest.fixture
def fresh(monkeypatch, tmp_path):
    """As a new process with a cache of its own."""
    monkeypatch.setenv("VIBROJAX_CACHE", str(tmp_path / "cache"))
    before = dict(kernels)
    forget()
    yield
    forget()
    kernels.update(before)


def forget():
    """Forget what a process knows."""
    for known in (trust._refused, trust._trusted, kernels):
        known.clear()
    trust.newer_than_tested.cache_clear()


@pytest.fixture
def fault(fresh, monkeypatch):
    """A fault in the translation of one function of jax: kernels take erfc(x) for x."""
    monkeypatch.setitem(elementwise.RULES, "erfc", elementwise.RULES["copy"])


def nothing(x):
    """Zero, and -1 in a kernel with the fault."""
    return lax.erfc(0.0 * x) - 1.0


class InConstants(VibroImpact):
    """A gap that the fault moves by a millimetre."""

    def constants(self, p):
        return super().constants(p | {"delta": p["delta"] + 1e-3 * nothing(p["delta"])})


class InAGuard(VibroImpact):
    """The contact that begins elsewhere; nothing but the guard has the fault."""

    def guards(self):
        friction, contact = super().guards()

        def function(c, mode, state):
            return contact.function(c, mode, state) + 1e-3 * nothing(c.contact.delta)

        return friction, replace(contact, function=function)


@dataclass(frozen=True)
class Speed(vj.Gauge):
    """A quantity that the fault moves."""

    variables: ClassVar[dict[str, tuple[str, str]]] = {"my_speed": ("m s-1", "drive speed")}

    def read(self, scene, c, carry, whole):
        return {"my_speed": 1.5 + nothing(whole.time)}


class InAGauge(VibroImpact):
    measures = (*VibroImpact.measures, Speed())


def law(term):
    return FrictionLaw("mine", "eq. 5.9", STRIBECK.parameters, lambda u, p: STRIBECK.mu(u, p) + term(p["mu"]))


def sweep(scene="vibro-impact"):
    grid = {"gamma": [0.65, 0.7]}
    given = {"scene": scene, "parameters": {"beta": 0.4, "delta": 0.005}, "grid": grid, "run": RUN}
    return vj.run_sweep(given, progress=False)


def compiler(dataset):
    return json.loads(dataset.attrs["solver"])["compiler"]


@pytest.fixture(scope="module")
def right():
    return sweep()


def refused(recorded):
    return [str(one.message) for one in recorded if issubclass(one.category, KernelRefused)]


WRONG, SOUND = law(lambda x: 0.1 * nothing(x)), law(lambda x: 0.0 * x)
ROTARY = vj.SCENES["rotary"]

FAULTY = {
    "constants": (InConstants(), "constants.contact.delta"),
    "guard": (InAGuard(), "guards['contact']"),
    "gauge": (InAGauge(), "features['my_speed']"),
    "law": (VibroImpact(friction=WRONG), "slip.stick_limit"),
}


def compared(scene, derives=False):
    kind = Kind(scene, vj.Located(), recorder_for(scene), scene.starts)
    return Comparison(kind, lanes_of(kind, ()), derives).difference()


@pytest.fixture
def quick_xla(monkeypatch):
    """Sweeps by XLA, compiled without its optimisations: a tenth of the time."""
    options: dict[str, int | str] = {"xla_backend_optimization_level": 0}
    if jax.__version_info__ < (0, 11, 2):
        options["xla_disable_hlo_passes"] = "cse_barrier_expander,fusion"
    monkeypatch.setattr(xla, "compiler_options", lambda platform: options)


def test_a_sweep(fault, quick_xla, right):
    """It is run by XLA, is right, and says so once."""
    with pytest.warns(KernelRefused) as told:
        own = sweep(InConstants())
    [line] = refused(told)
    assert line.startswith('scene "vibro-impact": its kernel and XLA differ by ') and "\n" not in line
    assert line.endswith("; XLA runs its lanes, which takes longer")
    assert compiler(own) == "xla" and compiler(right) == "llvm"
    np.testing.assert_array_equal(own.regime, right.regime)
    for name in ("period", "impact_velocity", "bit_amplitude"):
        np.testing.assert_allclose(own[name], right[name], rtol=1e-8, err_msg=name)


def test_a_sweep_would_be_wrong(fault, right, monkeypatch):
    """Without the comparison, the fault gives another answer in silence."""
    monkeypatch.setattr(trust, "is_foreign", lambda kind: False)
    own = sweep(InConstants())
    assert compiler(own) == "llvm" and np.all(np.abs(own.impact_velocity / right.impact_velocity - 1) > 1e-3)


def test_simulate(fault):
    point = {"beta": 0.4, "gamma": 0.7, "start": "stuck", "duration": 3.0, "progress": False}
    usual = vj.simulate("rotary", **point)
    with pytest.warns(KernelRefused) as told:
        own = vj.simulate("rotary", friction=WRONG, **point)
    assert len(refused(told)) == 1
    np.testing.assert_allclose(own.x1, usual.x1, atol=1e-9)
    np.testing.assert_allclose(own.friction_force, usual.friction_force, rtol=1e-6)


def test_the_command_says_so_on_one_line(fault, quick_xla, monkeypatch, tmp_path, capsys):
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
def test_where_it_differs(where, fault):
    """The line names the quantity."""
    scene, quantity = FAULTY[where]
    differs = compared(scene)
    assert differs is not None and quantity in differs.quantity and 1e-5 < differs.relative < 10


def twice(scene, x):
    return 2 * x


def thrice(scene, x):
    return 3 * x


def test_all_programs_of_a_refused_scene(fault):
    """Orbits, trajectories and all else are not by kernels either, whether they would be wrong or not."""
    scene, x = ROTARY(friction=WRONG), np.arange(3.0)
    with pytest.warns(KernelRefused) as told, pytest.raises(Untranslatable, match="differ by"):
        run_kernel(twice, (scene,), x)
    assert len(refused(told)) == 1
    with warnings.catch_warnings(), pytest.raises(Untranslatable):
        warnings.simplefilter("error")
        run_kernel(twice, (scene, vj.Located()), x, derives=True)
    np.testing.assert_array_equal(lane_function(static=1)(twice)(scene, x), 2 * x)
    np.testing.assert_array_equal(run_kernel(twice, (VibroImpact(),), x), 2 * x)


def test_a_scene_that_no_kernel_can_run_is_compared_once(fresh, monkeypatch):
    """XLA runs all of it, and there is no warning: nothing differs."""
    tried = []
    monkeypatch.setattr(Comparison, "__init__", lambda self, *given: tried.append(given) or no_kernel())
    for _ in range(2):
        with pytest.raises(Untranslatable, match="no rule"):
            run_kernel(lambda scene, x: 2 * x, (ROTARY(friction=WRONG),), np.arange(3.0))
    assert len(tried) == 1


def no_kernel():
    raise Untranslatable("no rule")


def test_lanes_on_orbits(fault, quick_xla):
    """The programs of XLA take over there too."""
    read = vj.read_sweep({"scene": ROTARY(friction=WRONG), "grid": {"gamma": [0.65, 0.7]}, "run": RUN})
    engine = Engine(read, vj.Located(), recorder_for(read.system), workers())
    given = engine.given(0, 4)
    batch = Batch(
        read.run.accuracy(read.system), np.arange(4), given, np.zeros(4), np.ones(4), None, np.zeros(4, np.int32)
    )
    state = (np.full(4, 0.01), *np.zeros((3, 4)))
    with pytest.warns(KernelRefused):
        begun = engine.on_orbit(batch, state, np.zeros((8, 3, 4)), np.zeros((8, 4)), np.ones(4))
    assert engine.programs.compiler == "xla"
    np.testing.assert_array_equal(begun.underway.lane.state, state)


@jax.custom_jvp
def flat(x):
    return 0.0 * x


@flat.defjvp
def _(primals, tangents):
    """Its derivative is 0, and not with the fault."""
    return flat(primals[0]), 0.2 * nothing(primals[0]) * tangents[0]


def test_a_fault_in_derivatives_alone(fault):
    """It shows where derivatives are asked for."""
    scene = VibroImpact(friction=law(flat))
    assert compared(scene) is None
    differs = compared(scene, derives=True)
    assert differs is not None and "derivative" in differs.quantity


@pytest.fixture
def comparisons(monkeypatch):
    """Return a list that grows with every comparison."""
    made = []
    difference = Comparison.difference
    monkeypatch.setattr(Comparison, "difference", lambda self: made.append(self) or difference(self))
    return made


def test_sound_code_stays_with_kernels(fresh, comparisons, monkeypatch):
    """It is compared once: not for the second kernel of a scene, nor in the next process."""
    for cache, count in (("on", 1), ("on", 1), ("off", 2)):
        if cache == "off":
            monkeypatch.setenv("VIBROJAX_CACHE", cache)
        forget()
        for function in (twice, thrice):
            run_kernel(function, (ROTARY(friction=SOUND),), np.arange(3.0))
        assert len(comparisons) == count


def test_simulate_compares_once(fresh, comparisons):
    """The parts of a trajectory's program have one verdict, which the next process has too; kernels run it."""
    for _ in range(2):
        vj.simulate("rotary", friction=SOUND, duration=0.5, progress=False)
        assert len(comparisons) == 1
        forget()


def test_a_refusal_is_kept(fault, comparisons):
    """The line is told again, and nothing is compared."""
    lines = []
    for _ in range(2):
        with pytest.warns(KernelRefused) as told, pytest.raises(Untranslatable):
            run_kernel(twice, (ROTARY(friction=WRONG),), np.arange(3.0))
        lines += refused(told)
        forget()
    assert len(lines) == 2 and lines[0] == lines[1] and len(comparisons) == 1


def test_a_newer_version(fresh, comparisons, monkeypatch):
    """The package's own scenes are compared too, once."""
    run_kernel(twice, (ROTARY(),), np.arange(3.0))
    assert not comparisons
    monkeypatch.setitem(trust.TESTED_VERSIONS, "jax", ("0.0.1",))
    for _ in range(2):
        forget()
        run_kernel(twice, (ROTARY(),), np.arange(3.0))
        assert len(comparisons) == 1


@pytest.mark.parametrize("package", ["jax", "llvmlite"])
def test_which_versions_are_newer(package, fresh, monkeypatch):
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


class Mine(vj.Located):
    """A stepper from outside the package."""


@pytest.mark.parametrize(
    "scene, foreign",
    [
        *((scene(), False) for scene in vj.SCENES.values()),
        *((VibroImpact(friction=one), False) for one in FRICTION_LAWS.values()),
        (VibroImpact(friction=FrictionLaw("mine", "eq. 5.9", STRIBECK.parameters, STRIBECK.mu)), False),
        (VibroImpact(friction=law(nothing)), True),
        (VibroImpact(friction=FrictionLaw("mine", "", {}, partial(STRIBECK.mu, extra=law))), True),
        (VibroImpact(friction=replace(STRIBECK, mu_impact=law(nothing).mu)), True),
        (VibroImpact(friction=replace(STRIBECK, flat_below=lambda p: 0.0)), True),
        (InConstants(), True),
        (InAGauge(), True),
        (Switched(), True),
        (Mine(), True),
    ],
)
def test_what_is_foreign(scene, foreign):
    """Scenes, laws, gauges and steppers from outside the package."""
    scene, stepper = (VibroImpact(), scene) if isinstance(scene, Mine) else (scene, vj.Located())
    assert is_foreign(Kind(scene, stepper, recorder_for(scene), scene.starts)) == foreign


OWN = [
    *(vj.SCENES[name]() for name in vj.SCENES),
    *(VibroImpact(friction=one) for one in FRICTION_LAWS.values() if one is not STRIBECK),
    *(vj.SCENES["penetration"](pulse_shape=shape) for shape in PULSE_SHAPES[1:]),
    Switched(),
    Shaken(),
]


def named(scene):
    return "-".join([scene.name, *(str(getattr(x, "name", x)) for x in vars(scene).values())])


@pytest.mark.parametrize(
    "scene",
    [pytest.param(x, marks=[pytest.mark.long] * (getattr(x, "friction", STRIBECK) is not STRIBECK)) for x in OWN],
    ids=named,
)
def test_every_scene_and_law(scene):
    """The package's own, which users' processes do not compare, and those of the tests."""
    assert compared(scene) is None
