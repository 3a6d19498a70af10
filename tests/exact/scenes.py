"""The five scenes: which equations hold in which mode, and which mode follows at a switch.

Quantities are linear forms: rows over the state, whose last entry is 1. So the equations stand here as in the model.
The rock's state is its compression e = x3 - x4, x3' and x4: small differences are then kept to their own rounding.
"""

from typing import NamedTuple

import numpy as np

from exact import friction
from exact.flow import Mode

SCENES = ("rotary", "vibro-impact", "penetration", "drilling", "coupled-drilling")


class Phase(NamedTuple):
    """What each part does; None where the scene lacks the part.

    bit: 1 slides forwards, 0 sticks, -1 slides backwards.
    striker: "apart" (x2 < delta), "touching" (J > 0), "leaving" (x2 >= delta, but J would pull).
    rock: "off" (x3 < x4), "elastic" (0 <= k3 (x3 - x4) <= D), "yielding" (x4' = x3' > 0).
    """

    bit: int | None = None
    striker: str | None = None
    rock: str | None = None


class Scene:
    """A scene with its parameters; `pulses` is what drives the bit in penetration."""

    def __init__(self, name, p, pulses=None):
        self.name, self.p, self.pulses = name, p, pulses
        self.drill = name != "penetration"
        self.contact = name not in ("rotary", "penetration")
        self.rock = name in ("penetration", "drilling", "coupled-drilling")
        self.coupled = name == "coupled-drilling"
        self.entries = ["x1", "v1", "x2", "v2"] * self.drill + ["e", "v3", "x4"] * self.rock + ["one"]
        self.row = dict(zip(self.entries, np.eye(len(self.entries)), strict=True))
        self.mu0 = friction.stick_coefficient(p) if self.drill else None
        self.modes = {}

    # Linear forms

    def compression(self):
        """Of the contact: x2 - delta; coupled, x2 - delta - (x3 - x4)."""
        r = self.row
        return r["x2"] - self.p.delta * r["one"] - self.coupled * r.get("e", 0)

    def rate(self, phase):
        """Its rate: x2'; coupled, x2' - (x3' - x4')."""
        r = self.row
        return r["v2"] - self.coupled * (phase.rock != "yielding") * r.get("v3", 0)

    def press(self, phase):
        """k0 compression + c0 rate, which is J while it is positive and they touch (5.18)."""
        return self.p.k0 * self.compression() + self.p.c0 * self.rate(phase)

    def J(self, phase):
        return self.press(phase) if phase.striker == "touching" else 0 * self.row["one"]

    def N(self, phase):
        """(6.2)"""
        r, p = self.row, self.p
        return {"off": 0 * r["one"], "elastic": p.k3 * r["e"], "yielding": p.threshold * r["one"]}[phase.rock]

    def pull(self):
        """The springs' force on the bit."""
        r, p = self.row, self.p
        return -p.k1 * r["x1"] - p.k2 * (r["x1"] - r["x2"])

    def stick_limit(self, phase):
        """f_st + mu J, or mu(0+) (m1 g + J) (5.11, R1, R2)."""
        return self.mu0 * (self.p.m1 * self.p.g * self.row["one"] + self.J(phase))

    def friction_force(self, phase, Y):
        """F at the states Y [..., d]: against sliding (5.9, 5.12), in stick what holds the bit."""
        if phase.bit == 0:
            return Y @ self.pull()
        u = Y @ (self.row["v1"] + self.p.v * self.row["one"])
        return phase.bit * friction.force(phase.bit * u, Y @ self.J(phase), self.p)

    # Equations

    def rates(self, phase):
        """The linear part of the equations of motion, as the rate of each entry."""
        r, p = self.row, self.p
        rate = {name: 0 * r["one"] for name in self.entries}
        if self.drill:
            J = self.J(phase)
            rate["x1"], rate["x2"] = r["v1"], r["v2"]
            rate["v1"] = self.pull() / p.m1 if phase.bit else 0 * r["one"]
            rate["v2"] = (-p.c2 * r["v2"] - p.k2 * (r["x2"] - r["x1"]) - J) / p.m2
        if self.rock:
            blow = self.J(phase) if self.drill else 0 * r["one"]
            rate["v3"] = (-p.c3 * r["v3"] - self.N(phase) + blow) / p.m1
            rate["x4" if phase.rock == "yielding" else "e"] = r["v3"]
        return rate

    def mode(self, phase, given=None) -> Mode:
        """The mode of a phase; `given(t)` is the force on the bit in penetration."""
        key = phase, given is None
        if key not in self.modes:
            rates, watched = self.rates(phase), self.surfaces(phase)
            G = 0 * self.row["one"]
            if phase.bit:
                G = -self.row["v1"] / self.p.m1
            elif given is not None:
                G = self.row["v3"] / self.p.m1
            self.modes[key] = Mode(
                A=np.stack([rates[name] for name in self.entries]),
                G=G,
                velocities=np.array([name[0] == "v" for name in self.entries]),
                surfaces=np.stack(list(watched.values())),
                names=list(watched),
            )
            if phase.bit:
                self.modes[key].force = lambda t, Y: self.friction_force(phase, Y)
        if given is not None:
            self.modes[key].force = lambda t, Y: given(t)
        return self.modes[key]

    def surfaces(self, phase):
        """What stays positive while the phase lasts, by what happens when it falls through zero."""
        r, p, watched = self.row, self.p, {}
        if phase.bit:
            watched["stops"] = phase.bit * (r["v1"] + p.v * r["one"])
        elif phase.bit == 0:
            watched["breaks forwards"] = self.stick_limit(phase) - self.pull()
            watched["breaks backwards"] = self.stick_limit(phase) + self.pull()
        if phase.striker == "apart":
            watched["strikes"] = -self.compression()
        elif phase.striker == "touching":
            watched["releases"] = self.press(phase)
        elif phase.striker == "leaving":
            watched["presses again"] = -self.press(phase)
            watched["parts"] = self.compression()
        if phase.rock == "off":
            watched["lands"] = -r["e"]
        elif phase.rock == "elastic":
            watched["yields"] = p.threshold / p.k3 * r["one"] - r["e"]
            watched["lifts"] = r["e"]
        elif phase.rock == "yielding":
            watched["holds"] = r["v3"]
        return watched

    # Switches

    def sizes(self) -> np.ndarray:
        """What each entry is small against, from the start on: what grows from nothing has no size of its own yet."""
        p, size = self.p, dict.fromkeys(self.entries, 0.0)
        if self.drill:
            size |= {"x1": p.v / np.sqrt(p.k1 / p.m1), "x2": p.v / np.sqrt(p.k1 / p.m1), "v1": p.v, "v2": p.v}
        if self.rock:
            e = min(p.threshold, p.m1 * 9.81) / p.k3
            size |= {"e": e, "v3": e * np.sqrt(p.k3 / p.m1)}
        return np.array(list(size.values()))

    def set(self, y, **values):
        for name, value in values.items():
            y[self.entries.index(name)] = value

    def meet(self, y):
        """Puts the striker where the compression is zero."""
        self.set(y, x2=y[self.entries.index("x2")] - self.compression() @ y)

    def first(self, y, given=None) -> Phase:
        """The phase in which a motion begins at t = 0."""
        p, bit, striker, rock = self.p, None, None, None
        if self.rock:  # x3 = x3' = 0 is on the edge between off and elastic
            lifted = self.row["e"] @ y < 0 or (given is not None and given(np.zeros(1))[0] < 0)
            rock = "off" if lifted else "elastic"
        if self.contact:
            at_rest = Phase(1, "apart", rock)
            towards = (self.compression() @ y, self.rate(at_rest) @ y, self.rates(at_rest)["v2"] @ y)
            striker = self._pressing(Phase(rock=rock), y) if towards > (0.0, 0.0, 0.0) else "apart"
            if striker == "leaving" and towards[0] == 0:
                striker = "touching"
        if self.drill:
            u = y[1] + p.v
            bit = int(np.sign(u)) if u else self._stopped(Phase(0, striker, rock), y)
        return Phase(bit, striker, rock)

    def _pressing(self, phase, y):
        return "touching" if self.press(phase) @ y > 0 else "leaving"

    def _stopped(self, phase, y) -> int:
        """The bit at u = 0: it sticks unless the springs pull by more than the limit (5.11)."""
        pull = self.pull() @ y
        return 0 if abs(pull) <= self.stick_limit(phase) @ y else int(np.sign(pull))

    def after(self, phase, event, y) -> Phase:
        """The phase after an event; the state is put on the surface exactly."""
        match event:
            case "stops":
                self.set(y, v1=-self.p.v)
                return phase._replace(bit=self._stopped(phase, y))
            case "breaks forwards":
                return phase._replace(bit=1)
            case "breaks backwards":
                return phase._replace(bit=-1)
            case "strikes":
                self.meet(y)
                return phase._replace(striker="touching")
            case "presses again":
                return phase._replace(striker="touching")
            case "releases" if self.p.c0:
                return phase._replace(striker="leaving")
            case "releases" | "parts":
                self.meet(y)
                return phase._replace(striker="apart")
            case "lands":
                self.set(y, e=0.0)
                return phase._replace(rock="elastic")
            case "lifts":
                self.set(y, e=0.0)
                return phase._replace(rock="off")
            case "yields":
                self.set(y, e=self.p.threshold / self.p.k3)
                return self._again(phase._replace(rock="yielding"), y)
            case "holds":
                self.set(y, v3=0.0)
                return self._again(phase._replace(rock="elastic"), y)
        raise ValueError(event)

    def _again(self, phase, y):
        """Coupled, the rate of compression jumps as the rock yields: what did not press may press from here on."""
        if self.coupled and phase.striker != "apart":
            return phase._replace(striker=self._pressing(phase, y))
        return phase
