"""Periodic orbits of random points, and how much their multipliers differ from independently computed ones."""

from typing import Any, NamedTuple

import numpy as np
from exact import orbits

import vibrojax as vj

BOX = {
    "beta": (0.1, 1.2),
    "gamma": (0.3, 1.2),
    "v": (0.2, 2.0),
    "delta": (-0.02, 0.01),
    "c0": (0.0, 2e4),
    "c2": (50.0, 400.0),
}
"""Ranges of the parameters. They exceed the default map, and include contact dampers, which make the force jump."""

LAWS: dict[str, dict[str, tuple[float, float]]] = {
    "stribeck": {"mu": (0.02, 0.6), "v_cr": (0.5, 5.0)},
    "hyperbolic": {"mu0": (0.02, 0.6), "delta_f": (0.3, 5.0)},
    "popp-exponential": {},
    "popp-arctan": {"a1": (0.05, 0.2)},
}
"""Laws under which the drill is self-excited, with the ranges of their parameters. The last law never sticks."""

FAR_FROM_GRAZING = 1e-3
"""Margin above which a finite difference does not change the order of events."""


class Orbit(NamedTuple):
    """An orbit of a lane.

    `section` is the state (x1, x2, x2') at the section. `span` [s] is the time of all `cycles` returns. `stick` and
    `reverse` are shares of time.
    """

    point: dict[str, Any]
    section: np.ndarray
    span: float
    cycles: int
    multipliers: np.ndarray
    stick: float
    reverse: float


def drawn(law: str, points: int, seed: int) -> list[Orbit]:
    """Return the orbits, away from grazing, on which the lanes of random points end."""
    random = np.random.default_rng(seed)
    columns = {name: random.uniform(*ends, points).tolist() for name, ends in (BOX | LAWS[law]).items()}
    sweep = {"scene": "vibro-impact", "points": columns, "starts": ["stuck"], "unusual": True}
    dataset = vj.run_sweep(sweep | {"parameters": {"friction": law}, "run": {"orbits": True}}, progress=False)
    dataset = dataset.isel(start=0)
    selected = (dataset.orbit_reason == 0) & (dataset.orbit_cycles == dataset.cycles)
    selected &= dataset.grazing_margin > FAR_FROM_GRAZING
    return [_orbit(dataset.isel(point=index), columns, law) for index in np.flatnonzero(selected.values)]


def _orbit(lane, columns, law) -> Orbit:
    cycles = int(lane.cycles)
    return Orbit(
        point={name: column[int(lane.point)] for name, column in columns.items()} | {"friction": law},
        section=np.array([lane[f"orbit_{name}"].item() for name in ("x1", "x2", "v2")]),
        span=lane.period.item() * cycles,
        cycles=cycles,
        multipliers=lane.multiplier_abs.values * np.exp(1j * lane.multiplier_arg.values),
        stick=lane.stick_fraction.item(),
        reverse=lane.reverse_fraction.item(),
    )


def in_upper_half(values) -> np.ndarray:
    """Return multipliers by falling modulus as in a dataset, where both of a pair lie above the real axis."""
    values = np.array([complex(x.real, abs(x.imag)) for x in np.asarray(values)])
    return values[np.argsort(-np.abs(values), kind="stable")]


def off_by_differences(orbit: Orbit) -> float:
    """Return the largest distance of the multipliers from those of the exact motion by central differences."""
    exact = orbits.multipliers("vibro-impact", orbit.point, orbit.section, orbit.span, orbit.cycles)
    return float(np.max(np.abs(in_upper_half(orbit.multipliers) - in_upper_half(exact))))


def off_by_volumes(orbit: Orbit) -> tuple[float, float]:
    """Return the relative error of the multipliers' product against the exact volume change, and the saltations' part.

    The error is relative to the product, or to 1e-6 if the product is smaller, because then the least multiplier is
    within rounding errors of the largest. Only for orbits that do not stick.
    """
    product, jumps = orbits.product("vibro-impact", orbit.point, orbit.section, orbit.span)
    return abs(np.prod(np.abs(orbit.multipliers)) - abs(product)) / max(abs(product), 1e-6), jumps
