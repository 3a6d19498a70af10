"""A scene written outside the package, with a third degree of freedom: the top drives the bit by the drill string."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest

from vibrojax.errors import InputError
from vibrojax.measures import Gauge, recorder_for
from vibrojax.measures.run import Effort, run_block
from vibrojax.models.physics.friction import FRICTION_LAWS, FrictionLaw
from vibrojax.models.physics.parameters import BIT_AND_STRIKER, CONTACT, positive, table
from vibrojax.models.scenes import Guard, HasContact, HasFriction, Marker, Mode, Scene, Section, State, Swing, one_sided
from vibrojax.models.scenes import stick_slip as slips
from vibrojax.models.scenes.capabilities import Bit
from vibrojax.models.scenes.vibro_impact import VibroImpact
from vibrojax.stepping import AccuracyRequest, Located, Smoothed

STRING = table(
    positive("m0", 500.0, "kg", "mass of the string", "m₀"),
    positive("k4", 4e6, "N m-1", "stiffness of the string above", "k₄"),
    positive("c4", 2e4, "N s m-1", "damping of the string", "c₄"),
)
SLIP, TOUCHING = 0, 1


class Constants(NamedTuple):
    m0: Any
    m1: Any
    m2: Any
    k1: Any
    k2: Any
    k4: Any
    c4: Any
    c2: Any
    slip: slips.SlipConstants
    contact: one_sided.ContactConstants


@dataclass(frozen=True)
class WithString(HasFriction[Constants], HasContact[Constants]):
    """The bit hangs on k1 from a mass m0, which hangs on k4 from the drive; x1, x2 and x0 relative to the drive."""

    friction: FrictionLaw = FRICTION_LAWS["stribeck"]

    name = "with-string"
    states = (
        State("x1", "m", "bit"),
        State("v1", "m s-1", "velocity of the bit", is_velocity=True),
        State("x2", "m", "striker"),
        State("v2", "m s-1", "velocity of the striker", is_velocity=True),
        State("x0", "m", "string"),
        State("v0", "m s-1", "velocity of the string", is_velocity=True),
    )
    modes = (Mode("slip", "sgn u", 1.0), Mode("touching", "1 where they touch", 0.0))
    markers = (Marker("bit_turn", "v1"), Marker("striker_turn", "v2"), Marker("string_turn", "v0"))
    section = Section(
        (
            Swing("x1", "v1", "bit_amplitude"),
            Swing("x2", "v2", "striker_amplitude"),
            Swing("x0", "v0", "string_amplitude"),
        ),
        rearm=lambda c: -0.05 * c.slip.v,
    )
    starts = ("stuck",)
    measures = ("swings", "shares", "impacts", "harmonics")

    def parameters(self):
        return BIT_AND_STRIKER | CONTACT | STRING | dict(self.friction.parameters)

    def constants(self, p: Mapping[str, Any]) -> Constants:
        m2 = p["beta"] * p["m1"]
        k2 = m2 * p["gamma"] ** 2 * p["k1"] / p["m1"]
        slip, contact = slips.slip_constants(p, self.friction), one_sided.contact_constants(p)
        return Constants(p["m0"], p["m1"], m2, p["k1"], k2, p["k4"], p["c4"], p["c2"], slip, contact)

    def start(self, c, name, shape):
        zero = jnp.zeros(shape, c.m1.dtype)
        return (zero, zero - c.slip.v, zero, zero, zero, zero)

    def pull(self, c, state):
        return c.k2 * (state[2] - state[0]) - c.k1 * (state[0] - state[4])

    def _pull_rate(self, c, state):
        return c.k2 * (state[3] - state[1]) - c.k1 * (state[1] - state[5])

    def mode_at(self, c, state):
        compression, rate = state[2] - c.contact.delta, state[3]
        pushed = c.k2 * (state[0] - state[2]) - c.c2 * state[3]
        touching = one_sided.touching_at(c.contact, compression, rate, pushed)
        impact = self.contact_force(c, (None, touching), state)
        pulls = self.pull(c, state), self._pull_rate(c, state)
        return (slips.slip_at(c.slip, state[1] + c.slip.v, *pulls, impact, self._noise(c)), touching)

    def field(self, c, mode, state):
        x1, v1, x2, v2, x0, v0 = state
        slip, J = mode[SLIP], self.contact_force(c, mode, state)
        F = slips.friction(self.friction, c.slip, slip, v1 + c.slip.v, J)
        bit = (self.pull(c, state) - F) / c.m1
        striker = (c.k2 * (x1 - x2) - c.c2 * v2 - J) / c.m2
        string = (c.k1 * (x1 - x0) - c.k4 * x0 - c.c4 * v0) / c.m0
        return (v1, (slip * slip) * bit, v2, striker, v0, string)

    def smoothed_field(self, c, mode, state, width):
        v1, v2 = state[1], state[3]
        J = self.contact_force(c, mode, state)
        u = v1 + c.slip.v
        F = slips.friction(self.friction, c.slip, slips.smoothed_slip(u, width), u, J)
        free = self.field(c, (0.0 * v1, mode[TOUCHING]), state)
        return (v1, (self.pull(c, state) - F) / c.m1, v2, *free[3:])

    def smoothed_mode(self, c, mode, state, width):
        return (slips.smoothed_mode(state[1] + c.slip.v, width), mode[TOUCHING])

    def guards(self):
        def slipping(c, mode, state):
            impact = self.contact_force(c, mode, state)
            return slips.guard(c.slip, mode[SLIP], state[1] + c.slip.v, self.pull(c, state), impact)

        def touching(c, mode, state):
            return one_sided.guard(c.contact, mode[TOUCHING], state[2] - c.contact.delta, state[3])

        return (
            Guard(
                "friction",
                slipping,
                lambda c, mode: slips.resolution(c.slip, mode[SLIP], self._noise(c)),
                lambda c, mode, h: slips.slope_resolution(c.slip, mode[SLIP], self._noise(c), h),
                is_switch=True,
            ),
            Guard("contact", touching, lambda c, mode: self._length(c)),
        )

    def reset(self, c, mode, state, hits):
        x1, v1, x2, v2, x0, v0 = state
        hit = hits["contact"]
        before = x2 - c.contact.delta
        touching, after = one_sided.reset(c.contact, mode[TOUCHING], before, v2, hit, self._length(c))
        x2, v1 = jnp.where(hit, c.contact.delta + after, x2), jnp.where(hits["friction"], -c.slip.v, v1)
        state = (x1, v1, x2, v2, x0, v0)
        impact = self.contact_force(c, (None, touching), state)
        pulls = self.pull(c, state), self._pull_rate(c, state)
        slip = slips.slip_after(c.slip, mode[SLIP], *pulls, impact, self._noise(c))
        return (jnp.where(hits["friction"], slip, mode[SLIP]), touching), state

    def _noise(self, c):
        force = one_sided.force_resolution(c.contact, c.m2, c.slip.v)
        return slips.stick_noise(c.slip, force)

    def _length(self, c):
        return slips.speed_noise(c.slip) * jnp.sqrt(c.m1 / c.k1)

    def rate(self, c, mode):
        flight = self.flight_rate(c)
        return jnp.where(mode[TOUCHING] != 0, one_sided.stiff_rate(c.contact, 1 / c.m2, flight), flight)

    def speed_scale(self, c):
        return c.slip.speed_scale

    def bit(self, c):
        return Bit(c.m1, c.slip.weight, c.slip.v)

    def flight_rate(self, c):
        return jnp.sqrt((c.k1 + c.k2) / c.m1 + c.k2 / c.m2 + (c.k1 + c.k4) / c.m0) + c.c2 / c.m2 + c.c4 / c.m0

    def spring_rate(self, c):
        return jnp.sqrt(c.k1 / c.m1)

    def contact_force(self, c, mode, state):
        return one_sided.force(c.contact, mode[TOUCHING], state[2] - c.contact.delta, state[3])

    def impact_rate(self, c, mode, state):
        return state[3]

    def impact_begins(self, c, mode, state, hits):
        compression = state[2] - c.contact.delta
        return one_sided.begins(c.contact, mode[TOUCHING], compression, state[3], hits["contact"], self._length(c))

    def striker_mass(self, c):
        return c.m2

    def contact_time(self, c):
        return jnp.pi * jnp.sqrt(c.m2 / c.contact.k0)

    def contact_rate(self, c):
        return one_sided.own_rate(c.contact, c.m2)


@dataclass(frozen=True)
class Fastest(Gauge[Scene[Any]]):
    """fastest_string [m/s]: the greatest |x0'| at the ends of steps."""

    def begin(self, scene, c, lane):
        return jnp.abs(lane.state[scene.place("v0")])

    def step(self, scene, c, carry, moment):
        return jnp.maximum(carry, jnp.abs(moment.lane.state[scene.place("v0")]))

    def read(self, scene, c, carry, whole):
        return {"fastest_string": carry}


class Measured(WithString):
    measures = (*WithString.measures, Fastest())


def run(scene, stepper, error=1e-4, **values):
    defaults = {name: one.default for name, one in scene.parameters().items()}
    c = scene.constants({name: jnp.full(1, value) for name, value in (defaults | values).items()})
    accuracy = stepper.accuracy(AccuracyRequest(error=error), scene)
    state = scene.start(c, "stuck", (1,))
    return run_block(scene, stepper, recorder_for(scene), c, state, Effort(accuracy, 1e6), 20.0, 4.0)


VALUES = {"k4": 1e8, "m0": 100.0, "delta": 0.005}
"""A string so stiff that its top is the drive itself."""


@pytest.fixture(scope="module")
def stiff():
    return run(Measured(), Located(), **VALUES)


def test_a_stiff_string_is_none(stiff):
    """With k4 >> k1 the motion is that of the vibro-impact scene: k1 and k4 in series are 1.6e-3 softer than k1."""
    scene = VibroImpact()
    plain = run(scene, Located(), delta=0.005)
    for name in ("cycles", "impacts", "returns"):
        assert stiff[name] == plain[name], name
    for name in ("period", "bit_amplitude", "striker_amplitude"):
        np.testing.assert_allclose(stiff[name], plain[name], rtol=1e-2, err_msg=name)


def test_its_own_quantities(stiff):
    """The amplitude that its section names, and the gauge that it holds."""
    assert 0 < stiff["string_amplitude"][0] < 4e-3 * stiff["bit_amplitude"][0]
    assert 0 < stiff["fastest_string"][0] < 0.1


def test_smoothed():
    """The other stepper takes it as well."""
    features = run(WithString(), Smoothed(), 0.03, m0=500.0, k4=4e6, delta=0.005)
    assert bool(features["finite"][0]) and bool(features["finished"][0])


def test_a_gauge_says_what_it_needs():
    class NoContact(WithString):
        measures = ("drilling",)

    with pytest.raises(InputError, match="with-string is no HasRock; Hole measures only those"):
        recorder_for(NoContact())


def test_a_gauge_that_there_is_not():
    class Misnamed(WithString):
        measures = ("swing",)

    with pytest.raises(InputError, match='with-string measures "swing"; choose from swings, shares'):
        recorder_for(Misnamed())
