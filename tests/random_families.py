"""Families of random forced systems, and whether their points are orbits of the independent integration.

At some points, the state at the section must return after `cycles` periods of the forcing, with as many impacts, and
the multipliers must be those of central differences of that integration. Between two points, stability may change only
at a special point."""

import numpy as np
from exact.described import Described
from exact.hybrid import Hybrid, Motion
from exact.random_systems import draw, structure
from random_systems import system_of

import vibrojax as vj

RETURNS, MULTIPLIERS = 1e-7, 3e-4
"""Greatest distance after a return, relative to the largest state, and greatest error of a multiplier, relative to the
largest multiplier if that is above 1. A difference over 1e-6 of the states is exact to 1e-4 where sticks begin."""

VARIED = ("omega", "a", "d", "k", "r", "load", "x0", "s", "kb", "mu", "c", "h")
DAMPING = 0.15
"""Added to each damping constant, so that most motions are periodic."""

FAR_FROM_GRAZING, ON_THE_CIRCLE = 1e-3, 1e-5


def family_of(seed: int, index: int):
    """Return a system, its parameters, the name of the varied parameter, and the family."""
    described = structure(seed)
    p, start = draw(described, seed, index)
    p = {name: x + DAMPING * name.startswith("c_") for name, x in p.items()}
    along = str(np.random.default_rng([seed, index, 5]).choice([n for n in p if n.split("_")[0] in VARIED]))
    span = tuple(sorted((0.7 * p[along], 1.4 * p[along])))
    rest = {name: x for name, x in p.items() if name != along}
    options = {"along": along, "at": p[along], "span": span, "start": start, "progress": False}
    return described, p, along, vj.follow(system_of(described), **options, **rest)


def faults(described: Described, p: dict[str, float], along: str, family, points: int = 4) -> tuple[int, list[str]]:
    """Return how many points were compared with all their multipliers, and what is wrong with the family."""
    found = [*_silent_changes(family, along)]
    states = np.stack([family[f"orbit_{name}"].values for name in described.states], axis=1)
    compared = 0
    for index in np.unique(np.linspace(0, family.sizes["point"] - 1, points).astype(int)):
        at = family.isel(point=index)
        own, place = p | {along: at[along].item()}, f"{along} = {at[along].item():.8g}"
        period, cycles = 2 * np.pi / own["omega"], int(at.cycles)
        motion = _motion(described, own, states[index], cycles * period)
        if np.isfinite(motion.doubt[0]):
            continue
        size = np.maximum(np.abs(motion.states).max(axis=0), 1e-3 * np.abs(motion.states).max())
        moduli = at.multiplier_abs.values[np.isfinite(at.multiplier_abs.values)]
        growth = max(1.0, moduli.max(initial=0.0))
        away = np.abs(motion.states[-1] - states[index]).max() / size.max()
        if away > RETURNS * growth:
            found.append(f"{place}: away by {away:.1e} after {cycles} periods")
            continue
        impacts = sum(kind == "impact" for _, _, kind, _ in motion.events)
        rests = any(kind == "rest" for _, _, kind, _ in motion.events)
        if "impacts" in at and not rests and impacts != at.impacts:
            found.append(f"{place}: {at.impacts.item()} impacts, not {impacts}")
        exact = _multipliers(described, own, states[index], period, cycles, size)
        if at.grazing_margin < FAR_FROM_GRAZING or exact is None:
            continue
        compared += 1
        off = np.abs(np.sort(moduli) - np.sort(np.sort(np.abs(exact))[::-1][: len(moduli)])).max(initial=0.0) / growth
        if off > MULTIPLIERS:
            found.append(f"{place}: multipliers {moduli}, not {np.abs(exact)}")
    return compared, found


def _silent_changes(family, along: str):
    """Yield the places at which stability changes between two points of a branch without a special point."""
    moduli = family.multiplier_abs.values
    outside = np.sum(moduli > 1, axis=1)
    clear = ~np.any(np.abs(moduli - 1) < ON_THE_CIRCLE, axis=1)
    branch, x = family.branch.values, family[along].values
    span = np.ptp(x)
    for k in np.flatnonzero((branch[1:] == branch[:-1]) & (outside[1:] != outside[:-1]) & clear[1:] & clear[:-1]):
        low, high = sorted((x[k], x[k + 1]))
        near = 0.3 * span if len(np.unique(np.sign(np.diff(x[branch == branch[k]])))) > 1 else 1e-6 * span
        place = family.special_value.values[family.special_branch.values == branch[k]]
        if not np.any((place >= low - near) & (place <= high + near)):
            yield f"{along} from {low:.6g} to {high:.6g}: {outside[k]}, then {outside[k + 1]} multipliers outside"


def _motion(described: Described, p: dict[str, float], state: np.ndarray, end: float) -> Motion:
    return Hybrid(described, p).run(state, np.linspace(0.0, end, 9))


def _multipliers(described: Described, p, state, period: float, cycles: int, size) -> np.ndarray | None:
    """Return multipliers by central differences, period by period, or None where a motion is doubtful."""
    product = np.eye(len(state))
    for _ in range(cycles):
        ends = {}
        for k, h in enumerate(1e-6 * size):
            for sign in (1.0, -1.0):
                moved = _motion(described, p, state + sign * h * np.eye(len(state))[k], period)
                if np.isfinite(moved.doubt[0]):
                    return None
                ends[k, sign] = moved.states[-1]
        slopes = [(ends[k, 1.0] - ends[k, -1.0]) / (2e-6 * size[k]) for k in range(len(state))]
        product = np.array(slopes).T @ product
        state = _motion(described, p, state, period).states[-1]
    return np.linalg.eigvals(product)
