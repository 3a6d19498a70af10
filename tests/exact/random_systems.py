"""Random hybrid systems as data: a seed gives the structure, and an index the parameters and the start."""

from collections.abc import Mapping

import numpy as np

from exact.described import Described, Expression, Rub, Stop, Surface
from exact.hybrid import Hybrid

RANGES = {
    "omega": (0.7, 3.0), "k": (0.6, 3.0), "c": (0.05, 0.4), "k3": (0.1, 0.6), "c3": (0.02, 0.2), "a": (0.6, 2.5),
    "b": (0.2, 1.0), "load": (-0.8, 0.8), "m": (0.7, 1.4), "e": (0.2, 0.8), "h": (0.2, 0.8), "g": (0.3, 1.5),
    "w0": (0.4, 0.9), "d": (0.3, 1.0), "r": (0.3, 0.85), "x0": (-0.4, 0.4), "v0": (-0.4, 0.4), "s": (0.3, 1.0),
    "kb": (0.5, 4.0), "mu": (0.1, 0.4), "static": (0.45, 0.7), "n": (0.6, 1.4), "n1": (0.1, 0.5), "q0": (0.25, 0.75),
    "j": (-0.4, 0.4), "low": (-0.5, 0.1), "tilt": (0.2, 1.0),
}  # fmt: skip
"""Range of each parameter by the name without its number."""


class Builder:
    """A random structure under construction: terms and events ask for parameters, which are added with their ranges."""

    def __init__(self, seed: int):
        self.rng = np.random.default_rng([seed, 7])
        self.ranges: dict[str, tuple[float, float]] = {}
        self.field: dict[str, list[tuple[float, str]]] = {}
        self.events: list = []
        self.surfaces: list[tuple[str, Expression]] = []
        self.section: str | None = None

    def new(self, name: str) -> str:
        """Return a new parameter, named by `name` and a number."""
        full = f"{name}_{sum(key.split('_')[0] == name for key in self.ranges) + 1}"
        self.ranges[full] = RANGES[name]
        return full

    def maybe(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def pick(self, *choices):
        return choices[self.rng.integers(len(choices))]

    def add(self, state: str, number: float, text: str) -> None:
        self.field.setdefault(state, []).append((number, text))

    def mass(self, x: str, v: str, forced: bool) -> None:
        """Add an oscillator; without forcing, it is excited by negative damping at small speeds."""
        self.add(x, 1.0, v)
        self.add(v, -1.0, f"{self.new('k')} {x}")
        self.add(v, -1.0 if forced else 1.0, f"{self.new('c')} {v}")
        if self.maybe(0.3):
            self.add(v, -1.0, f"{self.new('k3')} {x} {x} {x}")
        if not forced or self.maybe(0.2):
            self.add(v, -1.0, f"{self.new('c3')} {v} {v} {v}")
        if forced:
            self.add(v, 1.0, f"{self.new('a')} {self.pick('cos', 'sin')}")
        if self.maybe(0.4):
            self.add(v, 1.0, self.new("load"))

    def states(self, kind: str, forced: bool) -> None:
        """Add the field without events."""
        if kind == "circuit":
            for state, other, sign in (("y", "z", 1.0), ("z", "y", -1.0)):
                self.add(state, -1.0, f"{self.new('g')} {state}")
                self.add(state, sign, f"{self.new('k')} {other}")
            self.add("y", 1.0, f"{self.new('a')} cos" if forced else self.new("a"))
            return
        self.mass("x", "v", forced)
        if kind == "masses":
            self.mass("xx", "vv", forced and self.maybe(0.5))
            spring = self.new("h")
            for v, sign in (("v", 1.0), ("vv", -1.0)):
                self.add(v, sign, f"{spring} xx")
                self.add(v, -sign, f"{spring} x")
        if kind == "filter":
            self.add("z", -1.0, f"{self.new('g')} z")
            self.add("z", 1.0, f"{self.new('h')} {self.pick('x', 'v')}")
            self.add("v", -1.0, f"{self.new('e')} z")
        if kind == "phase":
            rate = self.new("w0")
            self.add("q", 1.0, rate)
            if forced and self.maybe(0.5):
                self.add("q", 0.5, f"{rate} cos")
            self.add("v", 1.0, f"{self.new('e')} q")

    def stop(self, name: str, kind: str, taken: set) -> bool:
        """Add an impact with velocity and restitution, or a velocity that is reset."""
        sign = self.pick(1.0, -1.0)
        x, v = self.pick(("x", "v"), ("xx", "vv")) if kind == "masses" else ("x", "v")
        between = kind == "masses" and self.maybe(0.5)
        key = ("stop", "between") if between else ("stop", x, sign)
        if kind == "circuit" or key in taken:
            return False
        taken.add(key)
        distance = self.new("d")
        gap: Expression = ((1.0, distance), (1.0, "xx"), (-1.0, "x")) if between else ((1.0, distance), (-sign, x))
        if between or self.maybe(0.7):
            moving = not between and "omega" in self.ranges and self.maybe(0.3)
            gap += ((0.1, "cos"),) if moving else ()
            self.events.append(Stop(name, gap, velocity=v, restitution=self.new("r")))
        else:
            reset = {v: ((-1.0, f"{self.new('r')} {v}"),)}
            if kind == "filter" and self.maybe(0.5):
                reset["z"] = ((1.0, "z"), (1.0, self.new("j")))
            self.events.append(Stop(name, gap, reset=reset))
        if len(gap) == 2:
            self.surfaces.append((x, ((sign, distance),)))
        return True

    def jump(self, name: str, kind: str, taken: set) -> bool:
        """Add an impact that resets states: a sawtooth, or a circuit that is discharged."""
        if kind not in ("phase", "circuit") or "jump" in taken:
            return False
        taken.add("jump")
        if kind == "circuit":
            self.events.append(Stop(name, ((1.0, self.new("d")), (-1.0, "y")), reset={"y": ((1.0, self.new("low")),)}))
            return True
        reset = {"q": self.pick(((1.0, "q"), (-1.0, "")), ())}
        if self.maybe(0.4):
            reset["v"] = ((1.0, "v"), (1.0, self.new("j")))
        self.events.append(Stop(name, ((1.0, ""), (-1.0, "q")), reset=reset))
        return True

    def switch(self, name: str, kind: str, taken: set) -> bool:
        """Add a switch: a relay (which may slide), a spring on one side, or a damper on one side."""
        y, v = ("y", self.pick("y", "z")) if kind == "circuit" else ("x", "v")
        level = self.new("x0")
        options: list[tuple[Expression, str | None]] = [(((1.0, y), (-1.0, level)), y), (((1.0, v),), v)]
        options += [(((1.0, v), (-1.0, self.new("v0"))), v), (((1.0, v), (1.0, f"{self.new('tilt')} {y}")), None)]
        if "omega" in self.ranges:
            options.append((((1.0, y), (-1.0, level), (-0.3, "cos")), None))
        if kind == "phase":
            options += [(((1.0, "q"), (-1.0, self.new("q0"))), "q")] * 3
        if kind == "filter":
            options += [(((1.0, "z"), (-1.0, level)), "z")] * 2
        if kind == "masses":
            options += [(((1.0, "x"), (-1.0, "xx"), (-1.0, level)), None), (((1.0, "vv"),), "vv")]
        place = int(self.rng.integers(len(options)))
        function, state = options[place]
        if ("switch", function) in taken:
            return False
        taken.add(("switch", function))
        self.events.append(Surface(name, function))
        if state is not None:
            self.surfaces.append((state, tuple((-x, s) for x, s in function[1:])))
        effect = self.pick("relay", "relay", "damper") if kind == "circuit" or place else self.pick("relay", "spring")
        if effect == "spring":  # continuous: a soft stop
            stiffness = self.new("kb")
            for number, text in ((-0.5, y), (-0.5, f"{name} {y}"), (0.5, level), (0.5, f"{name} {level}")):
                self.add(v, number, f"{stiffness} {text}")
        elif effect == "damper":
            damping = self.new("s")
            self.add(v, -0.5, f"{damping} {v}")
            self.add(v, -0.5, f"{damping} {name} {v}")
        else:
            self.add(v, 1.0 if self.maybe(0.1) else -1.0, f"{self.new('s')} {name}")
        if kind == "filter" and self.maybe(0.3):
            self.add("z", 1.0, f"{self.new('s')} {name}")
        return True

    def friction(self, name: str, kind: str, taken: set) -> bool:
        """Add dry friction on a fixed or moving surface, or between two masses."""
        if kind == "circuit" or "friction" in taken:
            return False
        taken.add("friction")
        options: list[Expression] = [((1.0, "v"),), ((1.0, "v"), (-1.0, self.new("v0")))]
        options += [((1.0, "v"), (-1.0, "vv"))] if kind == "masses" else []
        relative, weight = self.pick(*options), self.new("n")
        forced = ((0.4, f"{weight} cos"),) if "omega" in self.ranges else ()
        normal: Expression = ((1.0, weight), *self.pick((), (), ((1.0, f"{self.new('n1')} x x"),), forced))
        kinetic = self.new("mu")
        static = self.new("static") if self.maybe(0.4) else kinetic
        self.events.append(Rub(name, relative, normal, kinetic, static, "v", self.new("m")))
        if relative[-1][1] != "vv":
            self.surfaces.append(("v", tuple((-x, s) for x, s in relative[1:])))
        return True


def structure(seed: int, kinds: tuple[str, ...] | None = None) -> Described:
    """Return a random structure with one to three events; `kinds`: the kinds of events, in place of random ones."""
    build = Builder(seed)
    kind = build.pick("mass", "mass", "mass", "filter", "filter", "phase", "phase", "masses", "masses", "circuit")
    forced = build.maybe(0.75)
    if forced:
        build.ranges["omega"] = RANGES["omega"]
    else:
        build.section = "z" if kind == "circuit" else build.pick("x", "v")
    build.states(kind, forced)
    taken: set = set()
    wanted = kinds or tuple(
        build.pick("stop", "stop", "jump", "switch", "switch", "friction", "friction")
        for _ in range(build.pick(1, 2, 2, 2, 3, 3))
    )
    for place, wish in enumerate(wanted):
        for choice in (wish, "switch", "stop") if kinds is None else (wish,):
            if getattr(build, choice)(f"{choice}_{place + 1}", kind, taken):
                break
    values = [*build.field.values(), *(value for event in build.events for value in vars(event).values())]
    parts = [part for x in values for part in (x.values() if isinstance(x, Mapping) else [x])]
    used = [text for part in parts for text in ([part] if isinstance(part, str) else [s for _, s in part or ()])]
    names = {name for text in used for name in text.split()} | {"omega"}
    ranges = {name: limits for name, limits in build.ranges.items() if name in names}
    starts = {name: (0.0, 0.9) if name == "q" else (-0.8, 0.8) for name in build.field}
    field = {name: tuple(terms) for name, terms in build.field.items()}
    return Described(f"random_{seed}", tuple(field), field, build.events, ranges, build.section, starts, build.surfaces)


def draw(system: Described, seed: int, index: int) -> tuple[dict[str, float], list[float]]:
    """Return random parameters, and a start at which all gaps are open; every fourth is exactly on a surface."""
    rng = np.random.default_rng([seed, 11, index])
    while True:
        p = {name: float(rng.uniform(*limits)) for name, limits in system.ranges.items()}
        y = {name: float(rng.uniform(*limits)) for name, limits in system.start.items()}
        hybrid = Hybrid(system, {"omega": 1.0} | p)
        if index % 4 == 3 and system.surfaces:
            state, value = system.surfaces[rng.integers(len(system.surfaces))]
            y[state] = sum(number * (p[text] if text else 1.0) for number, text in value) + 0.0
        values = zip(hybrid.values(0.0, list(y.values()))[0], hybrid.events, strict=True)
        if all(x >= 0 if abs(x) < 1e-9 else x > 0.02 for x, event in values if isinstance(event, Stop)):
            return p, list(y.values())
