"""The drill with one sign turned round, to see that results of the source notice it."""

from dataclasses import dataclass

from vibrojax.models.scenes.vibro_impact import VibroImpact


@dataclass(frozen=True)
class WrongFriction(VibroImpact):
    """Friction drives the bit where it should brake it: F with the other sign in m1 x1''."""

    def field(self, c, mode, state):
        v1, bit, v2, striker = super().field(c, mode, state)
        slip = mode[0]
        return (v1, (slip * slip) * (2.0 * c.drill.inverse_m1 * self.pull(c, state)) - bit, v2, striker)


@dataclass(frozen=True)
class WrongContact(VibroImpact):
    """The contact pulls the striker in where it should throw it back: J with the other sign in m2 x2''."""

    def field(self, c, mode, state):
        v1, bit, v2, striker = super().field(c, mode, state)
        return (v1, bit, v2, striker + 2.0 * c.drill.inverse_m2 * self.contact_force(c, mode, state))


WRONG = {"friction": WrongFriction, "contact": WrongContact}
