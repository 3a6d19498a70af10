"""The drill with one wrong sign, to test that the results of the source depend on it."""

from dataclasses import dataclass

from vibrojax.scenes.vibro_impact import VibroImpact


@dataclass(frozen=True)
class WrongFriction(VibroImpact):
    """A drill whose friction drives the bit instead of braking it: F has the wrong sign in m1 x1''."""

    def field(self, c, mode, state):
        v1, bit, v2, striker = super().field(c, mode, state)
        slip = mode[0]
        return (v1, (slip * slip) * (2.0 * c.drill.inverse_m1 * self.pull(c, state)) - bit, v2, striker)


@dataclass(frozen=True)
class WrongContact(VibroImpact):
    """A drill whose contact pulls the striker in instead of pushing it back: J has the wrong sign in m2 x2''."""

    def field(self, c, mode, state):
        v1, bit, v2, striker = super().field(c, mode, state)
        return (v1, bit, v2, striker + 2.0 * c.drill.inverse_m2 * self.contact_force(c, mode, state))


WRONG = {"friction": WrongFriction, "contact": WrongContact}
