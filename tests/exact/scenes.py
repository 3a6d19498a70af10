"""The five scenes: the equations of each mode, and the mode that follows at each switch.

Quantities are linear forms: rows over the state, whose last entry is 1. The equations therefore read as in the model.
The rock's state is its compression e = x3 - x4, x3' and x4, so that small differences keep their own precision."""

from typing import NamedTuple

import numpy as np

from exact import friction
from exact.flow import Mode

SCENES = ("rotary", "vibro-impact", "penetration", "drilling", "coupled-drilling")


class Phase(NamedTuple):
    """The mode of each part; None if the scene lacks the part.

    bit: 1 slides forwards, 0 sticks, -1 slides backwards.
    striker: "apart" (x2 < delta), "touching" (J > 0), "leaving" (x2 >= delta, but J would pull).
    rock: "off" (x3 < x4), "elastic" (0 <= k3 (x3 - x4) <= D), "yielding" (x4' = x3' > 0).
    """

    bit: int | None = None
    striker: str | None = None
    rock: str | None = None


class Scene:
    """A scene with its parameters; `pulses` drives the bit in penetration."""

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
        """Return the compression of the contact: x2 - delta; coupled, x2 - delta - (x3 - x4)."""
        r = self.row
        return r["x2"] - self.p.delta * r["one"] - self.coupled * r.get("e", 0)

    def rate(self, phase):
        """Return the rate of the compression: x2'; coupled, x2' - (x3' - x4')."""
        r = self.row
        return r["v2"] - self.coupled * (phase.rock != "yielding") * r.get("v3", 0)

    def press(self, phase):
        """Return k0 compression + c0 rate, which is J while it is positive and the striker touches (5.18)."""
        return self.p.k0 * self.compression() + self.p.c0 * self.rate(phase)

    def J(self, phase):
        return self.press(phase) if phase.striker == "touching" else 0 * self.row["one"]

    def N(self, phase):
        """(6.2)"""
        r, p = self.row, self.p
        return {"off": 0 * r["one"], "elastic": p.k3 * r["e"], "yielding": p.threshold * r["one"]}[phase.rock]

    def pull(self):
        """Return the force of the springs on the bit."""
        r, p = self.row, self.p
        return -p.k1 * r["x1"] - p.k2 * (r["x1"] - r["x2"])

    def stick_limit(self, phase):
        """Return f_st + mu J, or mu(0+) (m1 g + J) (5.11, R1, R2)."""
        return self.mu0 * (self.p.m1 * self.p.g * self.row["one"] + self.J(phase))

    def friction_force(self, phase, Y):
        """Return F at the states Y [..., d]: against sliding (5.9, 5.12), or the force that holds a sticking bit."""
        if phase.bit == 0:
            return Y @ self.pull()
        u = Y @ (self.row["v1"] + self.p.v * self.row["one"])
        return phase.bit * friction.force(phase.bit * u, Y @ self.J(phase), self.p)

    # Equations

    def rates(self, phase):
        """Return the linear part of the equations of motion, as the rate of each entry."""
        r, p = self.row, self.p
        rate = {name: 0 * r["one"] for name in self.entries}
        if self.drill:
            J = self.J(phase)
            rate["x1"], rate["x2"] = r["v1"], r["v2"]
            rate["v1"] = self.pull() / p.m1 if phase.bit else 0 * r["one"]
            rate["v2"] = (-p.c2 * r["v2"] - p.k2 * (r["x2"] - r["x1"]) - J) / p.m2
        if self.rock:
            impact_force = self.J(phase) if self.drill else 0 * r["one"]
            rate["v3"] = (-p.c3 * r["v3"] - self.N(phase) + impact_force) / p.m1
            rate["x4" if phase.rock == "yielding" else "e"] = r["v3"]
        return rate

    def mode(self, phase, given=None) -> Mode:
        """Return the mode of a phase; `given(t)` is the force on the bit in penetration."""
        key = phase, given is None
        if key not in self.modes:
            rates, surfaces = self.rates(phase), self.surfaces(phase)
            G = 0 * self.row["one"]
            if phase.bit:
                G = -self.row["v1"] / self.p.m1
            elif given is not None:
                G = self.row["v3"] / self.p.m1
            A, forms = np.stack([rates[name] for name in self.entries]), np.stack(list(surfaces.values()))
            velocities = np.array([name[0] == "v" for name in self.entries])
            self.modes[key] = Mode(A, G, velocities, forms, list(surfaces))
            if phase.bit:
                self.modes[key].force = lambda t, Y: self.friction_force(phase, Y)
        if given is not None:
            self.modes[key].force = lambda t, Y: given(t)
        return self.modes[key]

    def surfaces(self, phase):
        """Return the linear forms that stay positive in a phase, by the event when each falls through zero."""
        r, p, surfaces = self.row, self.p, {}
        if phase.bit:
            surfaces["stops"] = phase.bit * (r["v1"] + p.v * r["one"])
        elif phase.bit == 0:
            surfaces["breaks forwards"] = self.stick_limit(phase) - self.pull()
            surfaces["breaks backwards"] = self.stick_limit(phase) + self.pull()
        if phase.striker == "apart":
            surfaces["strikes"] = -self.compression()
        elif phase.striker == "touching":
            surfaces["releases"] = self.press(phase)
        elif phase.striker == "leaving":
            surfaces["presses again"] = -self.press(phase)
            surfaces["parts"] = self.compression()
        if phase.rock == "off":
            surfaces["lands"] = -r["e"]
        elif phase.rock == "elastic":
            surfaces["yields"] = p.threshold / p.k3 * r["one"] - r["e"]
            surfaces["lifts"] = r["e"]
        elif phase.rock == "yielding":
            surfaces["holds"] = r["v3"]
        return surfaces

    # Switches

    def sizes(self) -> np.ndarray:
        """Return the reference size of each entry. Entries that grow from zero have no size at the start."""
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
        """Move the striker to where the compression is zero."""
        self.set(y, x2=y[self.entries.index("x2")] - self.compression() @ y)

    def first(self, y, given=None) -> Phase:
        """Return the phase in which a motion begins at t = 0."""
        p, bit, striker, rock = self.p, None, None, None
        if self.rock:  # x3 = x3' = 0 is the boundary between off and elastic
            lifted = self.row["e"] @ y < 0 or (given is not None and given(np.zeros(1))[0] < 0)
            rock = "off" if lifted else "elastic"
        if self.contact:
            at_rest = Phase(1, "apart", rock)
            approach = (self.compression() @ y, self.rate(at_rest) @ y, self.rates(at_rest)["v2"] @ y)
            striker = self._pressing(Phase(rock=rock), y) if approach > (0.0, 0.0, 0.0) else "apart"
            if striker == "leaving" and approach[0] == 0:
                striker = "touching"
        if self.drill:
            u = y[1] + p.v
            bit = int(np.sign(u)) if u else self._stopped(Phase(0, striker, rock), y)
        return Phase(bit, striker, rock)

    def _pressing(self, phase, y):
        return "touching" if self.press(phase) @ y > 0 else "leaving"

    def _stopped(self, phase, y) -> int:
        """Return the motion of the bit at u = 0: it sticks unless the pull of the springs exceeds the limit (5.11)."""
        pull = self.pull() @ y
        return 0 if abs(pull) <= self.stick_limit(phase) @ y else int(np.sign(pull))

    def after(self, phase, event, y) -> Phase:
        """Return the phase after an event, and set the state exactly on the surface."""
        match event:
            case "stops":
                self.set(y, v1=-self.p.v)
                return phase._replace(bit=self._stopped(phase, y))
            case "breaks forwards" | "breaks backwards":
                return phase._replace(bit=1 if event == "breaks forwards" else -1)
            case "strikes" | "presses again":
                if event == "strikes":
                    self.meet(y)
                return phase._replace(striker="touching")
            case "releases" if self.p.c0:
                return phase._replace(striker="leaving")
            case "releases" | "parts":
                self.meet(y)
                return phase._replace(striker="apart")
            case "lands" | "lifts":
                self.set(y, e=0.0)
                return phase._replace(rock="elastic" if event == "lands" else "off")
            case "yields":
                self.set(y, e=self.p.threshold / self.p.k3)
                return self._after_rate_jump(phase._replace(rock="yielding"), y)
            case "holds":
                self.set(y, v3=0.0)
                return self._after_rate_jump(phase._replace(rock="elastic"), y)
        raise ValueError(event)

    def _after_rate_jump(self, phase, y):
        """Return the phase after the rock begins or stops to yield. Coupled, the rate of the compression jumps there,
        so a striker that did not press may press now."""
        if self.coupled and phase.striker != "apart":
            return phase._replace(striker=self._pressing(phase, y))
        return phase
