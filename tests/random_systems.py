"""Comparison of random hybrid systems with the package: `vj.System` from a description, trajectories and sweeps.

A trajectory is compared up to the reference's first doubtful point. It ends earlier where the motion is sensitive: two
integrations from starts that differ by 1e-8 show the growth of perturbations. As long as it is at most `GROWTH`, the
package must agree within `WITHIN`, relative to the largest value of a state if that is above 1. Samples next to a jump
of a state are left out, because an error of the time of the jump is not an error of the state.

A comparison returns its outcome (agree, refused, doubtful from the start, or WRONG) and a remark."""

from typing import Any

import numpy as np
from exact.described import Described, Expression, Rub, Stop, evaluate
from exact.hybrid import Hybrid, Motion

import vibrojax as vj

WITHIN, GROWTH, NEXT_TO_JUMP = 1e-7, 100.0, 1e-5
PUSH = 1e-8
SAMPLES = 400
ERROR = 1e-8
"""Accepted error of the trajectories. Its tolerance is 1e-11, far below what is compared."""


def system_of(described: Described) -> vj.System:
    """Return the system as plain functions for the package."""

    def function(expression: Expression) -> Any:
        def value(t: Any, y: Any, p: Any, s: Any = None) -> Any:
            waves = {"cos": vj.elementary.cos, "sin": vj.elementary.sin}

            def known(name: str) -> Any:
                if name in waves:
                    return waves[name](p["omega"] * t)
                return y[name] if name in y else p[name] if name in p else s[name]

            return evaluate(expression, known)

        return value

    def plain(expression: Expression) -> Any:
        value = function(expression)
        return lambda t, y, p: value(t, y, p)

    def event(e: Any) -> Any:
        if isinstance(e, Stop):
            if e.velocity is None:
                new = {name: function(expression) for name, expression in e.reset.items()}
                reset = lambda t, y, p: {name: f(t, y, p) + 0.0 * y[name] for name, f in new.items()}
                return vj.Impact(e.name, plain(e.gap), reset=reset)
            return vj.Impact(e.name, plain(e.gap), velocity=e.velocity, restitution=lambda p: p[e.restitution])
        if isinstance(e, Rub):
            static = {} if e.static == e.kinetic else {"static": lambda p: p[e.static]}
            law, mass = (lambda p: p[e.kinetic]), (lambda p: p[e.mass])
            return vj.Friction(e.name, plain(e.relative), plain(e.normal), law, e.acts_on, mass, **static)
        return vj.Switch(e.name, plain(e.function))

    rates = {name: function(expression) for name, expression in described.field.items()}
    with_sides = lambda t, y, p, s: {name: f(t, y, p, s) for name, f in rates.items()}
    without = lambda t, y, p: {name: f(t, y, p) for name, f in rates.items()}
    forced = {"period": lambda p: 2 * np.pi / p["omega"]}
    return vj.System(
        described.name,
        states=dict.fromkeys(described.states, "1"),
        parameters={name: sum(limits) / 2 for name, limits in described.ranges.items()},
        field=with_sides if described.switches else without,
        events=[event(e) for e in described.events],
        **(forced if described.section is None else {"section": described.section}),
    )


def reference(described: Described, p: dict[str, float], start: list[float], times: np.ndarray) -> tuple[Motion, float]:
    """Return the reference's motion, and the time up to which it can be compared."""
    hybrid = Hybrid(described, p)
    motion = hybrid.run(start, times)
    end, rng = motion.doubt[0], np.random.default_rng(3)
    for _ in range(2):
        push = PUSH * rng.choice([-1.0, 1.0], len(start))
        values = zip(hybrid.values(0.0, start + push)[0], hybrid.events, strict=True)
        if min((x for x, e in values if isinstance(e, Stop)), default=0.0) < 0:
            push = -push
        pushed = hybrid.run(np.array(start) + push, times)
        away = np.abs(pushed.states - motion.states).max(axis=1)
        far = np.flatnonzero(~(away <= GROWTH * PUSH) & ~next_to_jump(motion, times) & (times < end))
        end = min(end, times[far[0] - 1] if far.size and far[0] else 0.0 if far.size else np.inf)
    return motion, end


def next_to_jump(motion: Motion, times: np.ndarray) -> np.ndarray:
    """Return a mask of the times at which an impact is less than `NEXT_TO_JUMP` away."""
    jumps = np.array([entry[0] for entry in motion.events if entry[2] == "impact"])
    return np.zeros(len(times), bool) if not jumps.size else np.abs(times[:, None] - jumps).min(axis=1) < NEXT_TO_JUMP


def compare(described: Described, p: dict[str, float], start: list[float], duration: float) -> tuple[str, str]:
    """Compare a trajectory of the package with the reference."""
    times = np.linspace(0.0, duration, SAMPLES + 1)
    motion, end = reference(described, p, start, times)
    compared = (times < end) & ~next_to_jump(motion, times)
    if np.count_nonzero(compared) < 2:
        return "doubtful", motion.doubt[1] if end == motion.doubt[0] else "sensitive"
    settings = {"start": start, "duration": duration, "sampling": duration / SAMPLES, "error": ERROR, "progress": False}
    try:
        ds = vj.simulate(system_of(described), **settings, **p)
    except vj.InputError as error:
        return "refused", str(error)
    states = np.stack([ds[name].values for name in described.states], axis=1)
    size = np.maximum(1.0, np.abs(motion.states[compared]).max(axis=0))
    difference = (np.abs(states - motion.states) / size).max(axis=1) / WITHIN
    if not np.isfinite(difference[compared]).all():
        return "refused", "states are not finite"
    wrong = np.flatnonzero(compared & (difference > 1))
    if not wrong.size:
        return "agree", ""
    before = [entry for entry in motion.events if entry[0] <= times[wrong[0]]][-3:]
    near = "; ".join(f"{name} {kind} at {at:.6g}" for at, name, kind, _ in before)
    return "WRONG", f"by {difference[compared].max():.3g} from t = {times[wrong[0]]:.4g}, after {near or 'no event'}"


MOST_CYCLES = 8
REPEATS = 1e-8
"""Greatest difference of the reference's states one repeat apart, in a motion that is periodic."""


def long_run(described: Described, p: dict[str, float], start: list[float], settle: float) -> dict[str, float] | str:
    """Return the measures of a forced system's motion after a settling time [s], or the reason why there are none. They
    are returns in a repeat, period [s], impacts in a repeat and their mean velocity. A motion that rests on a stop has
    the first two only: the slowest bounces before are a matter of convention."""
    period = 2 * np.pi / p["omega"]
    first = int(np.ceil(settle / period))
    times = np.arange(first + 2 * MOST_CYCLES + 1) * period
    motion = Hybrid(described, p).run(start, times)
    if np.isfinite(motion.doubt[0]):
        return motion.doubt[1]
    last = motion.states[first:]
    bound = REPEATS * max(1.0, np.abs(last).max())
    repeats = [n for n in range(1, MOST_CYCLES + 1) if np.abs(last[n:] - last[:-n]).max() <= bound]
    if not repeats:
        return "not periodic"
    cycles = repeats[0]
    happened = [(kind, speed) for t, _, kind, speed in motion.events if times[-1] - cycles * period < t <= times[-1]]
    speeds = [speed for kind, speed in happened if kind == "impact"]
    measures = {"cycles": float(cycles), "period": cycles * period}
    if all(kind != "rest" for kind, _ in happened):
        measures |= {"impacts": float(len(speeds))} | ({"impact_velocity": float(np.mean(speeds))} if speeds else {})
    return measures


def compare_sweep(described: Described, points: list[dict[str, float]], start: list[float], settle: float) -> list[str]:
    """Compare a sweep over points of a forced system with the reference's long runs; return what is wrong. Certified
    lanes must have the reference's cycles and impacts, and period and impact velocity within max(4 error_estimate,
    1e-6). Where the reference is doubtful or not periodic, nothing is compared."""
    run = {"settle": settle, "observe": 8 * np.pi * MOST_CYCLES / min(p["omega"] for p in points), "error": 1e-6}
    columns = {name: [p[name] for p in points] for name in described.ranges}
    sweep = {"scene": system_of(described), "points": columns, "starts": [start], "run": run}
    ds, faults = vj.run_sweep(sweep, progress=False).squeeze("start"), []
    for index, p in enumerate(points):
        lane, expected = ds.isel(point=index), long_run(described, p, start, settle)
        estimate = float(lane.error_estimate)
        if lane.reason == 0 and estimate <= 1e-4 and not isinstance(expected, str):
            for name, right in expected.items():
                allowed = 0.0 if name in ("cycles", "impacts") else max(4 * estimate, 1e-6) * right
                if name in lane and not abs(lane[name] - right) <= allowed:
                    faults.append(f"{index}: {name} {lane[name].item():.9g}, not {right:.9g}")
    return faults
