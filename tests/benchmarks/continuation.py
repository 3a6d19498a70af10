"""Demos of AUTO-07p, and friction and impact oscillators of PWSDDE-cont, followed with `vj.follow`.

    python tests/benchmarks/continuation.py [DEMO ...]

Each demo runs twice in one process. The table lists every special point that other tools have found or that is known
exactly, the value here, the difference, and the processor time of the first and of the second run. The exit status is
1 if a point is missing. Doubled branches are left out where no point of them is listed.
"""

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr

import vibrojax as vj

E = vj.elementary
PI = np.pi


def system(name: str, states: str, parameters: dict[str, float], field: Callable[..., Any], **more: Any) -> Any:
    return vj.System(name, states=dict.fromkeys(states.split(), "1"), parameters=parameters, field=field, **more)


def lorenz() -> Any:
    return system(
        "lorenz",
        "x y z",
        {"rho": 280.0},
        lambda t, y, p: {
            "x": 10.0 * (y["y"] - y["x"]),
            "y": p["rho"] * y["x"] - y["y"] - y["x"] * y["z"],
            "z": y["x"] * y["y"] - 8 / 3 * y["z"],
        },
        section="x",
    )


def circuit() -> Any:
    def field(t: Any, y: Any, p: Any) -> Any:
        cubic = 0.933578 * (y["y"] - y["x"]) ** 3
        return {
            "x": (-(0.5 + p["nu"]) * y["x"] + 0.5 * y["y"] - 0.328578 * y["x"] ** 3 + cubic) / 0.6,
            "y": 0.5 * y["x"] + 0.1 * y["y"] - y["z"] - cubic,
            "z": y["y"],
        }

    return system("tor", "x y z", {"nu": -0.6}, field, section="y")


def reactions() -> Any:
    def field(t: Any, y: Any, p: Any) -> Any:
        x, z, q = y["x"], y["z"], y["q"]  # q is the rate of x, so that the section q = 0 meets every orbit
        heat = (q + x) / (p["D"] * (1 - x))
        warm = E.log(heat)
        rise = -2.55 * warm + 8 * p["D"] * heat * ((1 - x) + 0.04 * z)
        return {"x": q, "z": -z + p["D"] * heat * ((1 - x) - 0.04 * z), "q": -q + p["D"] * heat * (-q + (1 - x) * rise)}

    return system("abc", "x z q", {"D": 0.15}, field, section="q")


def enzyme() -> Any:
    def field(t: Any, y: Any, p: Any) -> Any:
        s, q = y["s"], y["q"]
        d, r = 1 + s + 0.1 * s * s, (110.0 - s - q) / p["rho"]
        a = r * d / s
        rate = 0.2 * (500.0 - a) - p["rho"] * r
        return {"s": q, "q": -q - p["rho"] * (a * (1 - 0.1 * s * s) / (d * d) * q + s / d * rate)}

    return system("plp", "s q", {"rho": 4.2}, field, section="q")


def prey() -> Any:
    return system(
        "pp2",
        "fish sharks",
        {"quota": 0.6},
        lambda t, y, p: {
            "fish": 3 * y["fish"] * (1 - y["fish"])
            - y["fish"] * y["sharks"]
            - p["quota"] * (1 - E.exp(-5 * y["fish"])),
            "sharks": -y["sharks"] + 3 * y["fish"] * y["sharks"],
        },
        section=("fish", 1 / 3),
    )


def food_chain() -> Any:
    return system(
        "pp3",
        "a b c",
        {"p1": 0.1},
        lambda t, y, p: {
            "a": y["a"] * (1 - y["a"]) - 4 * y["a"] * y["b"],
            "b": -0.25 * y["b"] + 4 * y["a"] * y["b"] - 3 * y["b"] * y["c"] - p["p1"] * (1 - E.exp(-5 * y["b"])),
            "c": -0.5 * y["c"] + 3 * y["b"] * y["c"],
        },
        section=("b", 1 / 6),
    )


def circles() -> Any:
    def field(t: Any, y: Any, p: Any) -> Any:
        square = y["x"] ** 2 + y["y"] ** 2
        pull = square - (p["a"] + 2) * E.sqrt(square) + 2 * p["a"]
        return {"x": -y["x"] * pull - 2 * PI * y["y"], "y": -y["y"] * pull + 2 * PI * y["x"]}

    return system("lcbp", "x y", {"a": 1.0}, field, section="y")


def chua() -> Any:
    def field(t: Any, y: Any, p: Any) -> Any:
        bend = [z * E.arctan(10.0 * z) * 2 / PI for z in (y["x"] + 1, y["x"] - 1)]
        h = 2 / 7 * y["x"] - 1.5 / 7 * (bend[0] - bend[1])
        return {"x": p["alpha"] * (y["y"] - h), "y": y["x"] - y["y"] + y["z"], "z": -14.3 * y["y"]}

    return system("chu", "x y z", {"alpha": 5.0}, field, section="y")


def nerve() -> Any:
    def field(t: Any, y: Any, p: Any) -> Any:
        rate = 3.0 * (y["x"] - y["x"] ** 3 / 3 + (y["w"] - y["x"] + p["a"]) / 0.8)
        return {"x": rate, "w": rate - 0.8 * y["w"] / 3.0}

    return system("fhn", "x w", {"a": 0.9}, field, section="w")


def forced_nerve() -> Any:
    def field(t: Any, y: Any, p: Any) -> Any:
        v, w = y["v"], y["w"]
        return {"v": (v * (v - 0.5) * (1 - v) - w) / 0.005, "w": v - w - 0.5 - p["r"] * E.sin(p["bet"] * t)}

    return system("frc", "v w", {"bet": 100.0, "r": 0.2}, field, period=lambda p: 2 * PI / p["bet"])


def pendula() -> Any:
    def field(t: Any, y: Any, p: Any) -> Any:
        c, s, d, rate, apart = y["c"], y["s"], y["d"], y["rate"], y["apart"]
        k = 1 - c * c - s * s
        return {
            "c": -s * rate + c * k,
            "s": c * rate + s * k,
            "d": apart,
            "rate": -0.1 * rate - s * E.cos(d) + p["I"],
            "apart": -0.1 * apart - c * E.sin(d) - 0.35 * d,
        }

    return system("pen", "c s d rate apart", {"I": 0.4}, field, section="s")


def stuck() -> Any:
    friction = vj.Friction(
        "slide",
        relative=lambda t, y, p: y["v"],
        normal=lambda t, y, p: 1.0,
        law=1.0,
        static=lambda p: p["eta"],
        acts_on="v",
    )
    return system(
        "friction-oscillator",
        "x v",
        {"om": 0.9, "eta": 1.0},
        lambda t, y, p: {"x": y["v"], "v": -y["x"] - 0.1 * y["v"] + 1.5 * E.cos(p["om"] * t)},
        period=lambda p: 2 * PI / p["om"],
        events=[friction],
    )


def absorber() -> Any:
    def field(t: Any, y: Any, p: Any) -> Any:
        r, v = y["r"], y["v"]
        x1, v1 = (y["s"] - 0.05 * r) / 1.05, (y["P"] - 0.05 * v) / 1.05
        a1 = -x1 + 0.952**2 * 0.05 * r - 0.04 * v1 + 0.0127 * v - 0.1 * x1**3 + 0.005 * r**3 + E.cos(p["om"] * t)
        a2 = -(0.952**2) * r - 0.254 * v - 0.1 * r**3
        return {"r": v, "s": y["P"], "v": a2 - a1, "P": a1 + 0.05 * a2}

    sides = (("up", lambda t, y, p: 1.0 - y["r"]), ("low", lambda t, y, p: 1.0 + y["r"]))
    return system(
        "impact-oscillator",
        "r s v P",
        {"om": 1.5},
        field,
        period=lambda p: 2 * PI / p["om"],
        events=[vj.Impact(name, gap=gap, velocity="v", restitution=lambda p: 0.9) for name, gap in sides],
    )


def cycles_of(made: Any, along: str, at: float, span: tuple[float, float], start: list[float], most: int = 1) -> Any:
    """Return the families of equilibria, and of orbits from their Hopf points."""
    still = vj.follow(made, along=along, at=at, span=span, start=start, cycles=0, progress=False)
    return [still, vj.follow(made, from_hopf=still, cycles=most, progress=False)]


def orbits_of(made: Any, **settings: Any) -> list[xr.Dataset]:
    return [vj.follow(made, progress=False, **{"cycles": 1, **settings})]


def forced_orbits(made: Any) -> list[xr.Dataset]:
    """Return the response to a force that grows from zero, where no motion settles, and to its frequency."""
    begin = {"states": [0.5, 0.0], "period": 2 * PI / 100}
    first = vj.follow(made, along="r", at=0.0, span=(0.0, 0.2), orbit=begin, cycles=1, progress=False)
    last = first.isel(point=int(first.r.values.argmax()))
    begin["states"] = [float(last.orbit_v), float(last.orbit_w)]
    return [first, vj.follow(made, along="bet", at=100.0, span=(1.0, 100.0), orbit=begin, cycles=1, progress=False)]


Demo = tuple[Callable[[], Any], Callable[[Any], list[xr.Dataset]], list[tuple[str, float, float]]]

DEMOS: dict[str, Demo] = {
    "pp2": (prey, lambda s: cycles_of(s, "quota", 0.6, (0.5, 0.8), [0.35, 0.3]), [("hopf", 0.67159384748, 1e-9)]),
    "pp3": (
        food_chain,
        lambda s: cycles_of(s, "p1", 0.1, (0.0, 1.0), [0.5, 0.1, 0.1]),
        [("hopf", 0.229356973, 1e-7), ("hopf", 0.503834965, 1e-6), ("branch-point", 0.301235, 1e-6)],
    ),
    "plp": (
        enzyme,
        lambda s: cycles_of(s, "rho", 4.2, (4.0, 6.0), [30.0, 0.0]),
        [("fold", 5.00783976243, 1e-8), ("hopf", 4.6504578, 1e-7)],
    ),
    "abc": (
        reactions,
        lambda s: cycles_of(s, "D", 0.15, (0.1, 0.45), [0.3, 0.3, 0.0]),
        [
            ("hopf", 0.204184536, 1e-9),
            ("hopf", 0.346208523, 1e-8),
            ("fold", 0.21369736922, 1e-9),
            ("fold", 0.21190327712, 1e-9),
        ],
    ),
    "lor": (
        lorenz,
        lambda s: orbits_of(
            s,
            along="rho",
            at=280.0,
            span=(200.0, 330.0),
            start=[30.0, 30.0, 280.0],
            settle=60.0,
            observe=20.0,
            cycles=4,
        ),
        [
            ("period-doubling", 229.4067102, 1e-5),
            ("period-doubling", 218.2101403, 1e-4),
            ("period-doubling", 215.96643, 1e-3),
            ("branch-point", 313.0, 0.1),
        ],
    ),
    "tor": (
        circuit,
        lambda s: orbits_of(s, along="nu", at=-0.6, span=(-0.9, -0.4), start=[0.1] * 3, settle=3000.0, observe=400.0),
        [
            ("torus", -0.5916502158, 1e-6),
            ("period-doubling", -0.6149552561, 1e-6),
            ("fold", -0.7604069415, 1e-6),
            ("period-doubling", -0.7604044695, 1e-9),
            ("branch-point", -0.5870290, 1e-7),
        ],
    ),
    "lcbp": (
        circles,
        lambda s: orbits_of(s, along="a", at=1.0, span=(0.5, 3.0), start=[2.1, 0.0], settle=50.0, observe=20.0),
        [("branch-point", 2.0, 1e-9)],
    ),
    "fhn": (nerve, lambda s: cycles_of(s, "a", 0.9, (-1.0, 1.0), [1.0, 0.0]), [("hopf", 0.42277, 1e-4)]),
    "chu": (
        chua,
        lambda s: cycles_of(s, "alpha", 5.0, (4.0, 9.0), [1.5, 0.0, -1.5]),
        [("hopf", 6.80443, 1e-3), ("period-doubling", 8.196, 1e-4)],
    ),
    "lrz": (lorenz, lambda s: cycles_of(s, "rho", 20.0, (13.0, 30.0), [7.1, 7.1, 19.0]), [("hopf", 470 / 19, 1e-9)]),
    "frc": (forced_nerve, forced_orbits, []),
    "pen": (
        pendula,
        lambda s: orbits_of(
            s, along="I", at=0.4, span=(0.05, 0.6), start=[1.0, 0.0, 0.001, 3.0, 0.0], settle=1000.0, observe=100.0
        ),
        [],
    ),
    "fric": (
        stuck,
        lambda s: orbits_of(s, along="om", at=0.9, span=(0.2, 3.0), start=[0.0, 5.0]),
        [("stick", 0.722679194438, 1e-9), ("stick", 1.23574715232, 1e-9)],
    ),
    "impd": (
        absorber,
        lambda s: orbits_of(s, along="om", at=1.5, span=(0.9, 5.0), start=[0.0] * 4, settle=800.0, observe=100.0),
        [
            ("fold", 1.29896319, 1e-8),
            ("fold", 3.15931339, 1e-8),
            ("torus", 1.97655, 1e-5),
            ("torus", 2.09495, 1e-5),
            ("grazing", 2.14006, 1e-5),
            ("branch-point", 1.439, 1e-3),
            ("grazing", 1.625, 1e-3),
        ],
    ),
}
"""System, families, and points as (kind, value, bound): exact values, or those of other tools with their digits."""


def found(families: list[xr.Dataset], kind: str, value: float) -> float:
    """Return the value of the nearest special point of a kind; NaN without one."""
    values = [np.nan]
    for family in families:
        kinds = np.array(str(family.special_kind.attrs["flag_meanings"]).split())[family.special_kind.values]
        values += family.special_value.values[kinds == kind].tolist()
    differences = np.abs(np.array(values) - value)
    return float("nan") if np.isnan(differences).all() else float(values[int(np.nanargmin(differences))])


def run(name: str) -> bool:
    """Follow one demo twice and print its rows; return whether all points were found."""
    made, families, points = DEMOS[name]
    one, times = made(), []
    for _ in range(2):
        begin = time.process_time()
        known = families(one)
        times.append(time.process_time() - begin)
    size = sum(family.sizes["point"] for family in known)
    print(f"{name}: {times[0]:.1f} s, again {times[1]:.1f} s, {size} points")
    complete = True
    for kind, value, bound in points:
        here = found(known, kind, value)
        sound = abs(here - value) <= bound
        complete &= sound
        print(f"  {kind:16} {value:<16.12g} {here:<16.12g} {here - value:+.1e}{'' if sound else '  MISSING'}")
    return complete


if __name__ == "__main__":
    chosen = sys.argv[1:] or list(DEMOS)
    complete = [run(name) for name in chosen]
    raise SystemExit(not all(complete))
