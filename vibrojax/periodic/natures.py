"""Classification of lanes by largest Lyapunov exponent as periodic, quasi-periodic, chaotic, or not settled.

The class of a lane is called its *nature*, after the dataset variable `nature`.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.io.variables import NATURES
from vibrojax.lanes.inputs import Features, Index, LaneInputs, PerLane
from vibrojax.lanes.labels import regimes
from vibrojax.measures.labels import IRREGULAR, UNDECIDED
from vibrojax.periodic.growth import (
    EXPONENT_BLOCKS,
    LONGEST_REPEAT,
    TANGENT_ACCURACY,
    Growth,
    PerState,
    along_rows,
    exponents,
    exponents_of_repeats,
    find_repeats,
    grow,
    zero_one,
)
from vibrojax.periodic.orbit_stages import MOST_STEPS, REACH, OrbitStage, last_returns, reason
from vibrojax.periodic.orbits import ACCEPTED, Orbits
from vibrojax.periodic.return_map import STEPS, Segments
from vibrojax.scenes import Scene
from vibrojax.settings.run_settings import RunSettings

RETURNS_BEFORE, RETURNS_PER_CHECK = 14336, 2048
"""Number of returns to the section before an exponent is measured, and between checks whether a lane is periodic. Chaos
may be a transient of any length. Over the default map, it ends in 4 to 6 of 100 lanes between 2,048 and 4,096 returns.
It ends in 5 lanes between 4,096 and 8,192 returns, and in 4 between 8,192 and 16,384."""

EXPONENT_MIN_RETURNS, EXPONENT_MAX_RETURNS = 2048, 8192
"""Least number of returns for an exponent, and the number at which every lane is classified. The number is doubled
until a lane can be classified and `PER_OBSERVED` is reached."""

PER_OBSERVED, MOST_OBSERVED = 56, 65536
"""Returns for an exponent for each return in the observation, and their limit: ten times the observation divides the
standard error by about three."""

UNSETTLED_LANES_TOGETHER = 512
"""Greatest number of lanes that are continued together, which bounds the memory for their returns."""

CLEAR_STDERRS, FINAL_STDERRS = 6.0, 3.0
"""Distance from zero in standard errors at which an exponent's sign is clear: with returns left, and after the last."""

ZERO_STDERR = 0.002
"""Standard error per return below which an exponent that cannot be distinguished from zero counts as zero."""

ZERO_EXPONENT = 5e-4
"""Absolute value of an exponent per return up to which it counts as zero, however small its standard error."""

CHAOTIC_K = 0.9
"""K of the 0-1 test above which a lane is chaotic if its exponent is inconclusive."""

LABELLED_REPEAT = 8
"""Longest period, in returns, that regime labels recognise; a lane that reaches such a period later had not settled."""

STEADY_SPREAD = 0.99
"""Least ratio of the spread of states over the last `LONGEST_REPEAT` returns to that over four times as many, for a
steady motion."""

TESTED_RETURNS = 1024
"""Number of returns that the 0-1 test uses: the last ones."""

EMBEDDED_MAX_RETURNS = 4
"""Longest period, in returns, of stable orbits searched for within chaos: over the default map hardly any is longer."""

EMBEDDED_TRIALS = 8
"""Initial guesses for Newton's method per period of such an orbit: the closest recurrence in each equal part of a
series."""

EMBEDDED_WITHIN = 0.5
"""Scaled distance up to which a recurrence is used as an initial guess for Newton's method."""


EXPONENTS_DESCRIBED = {
    "exponent": "largest of the flow except the trivial zero: of the return map, per second; natural logarithm",
    "stick": "loses one direction, whose exponent is minus infinity; the largest of the others stays finite",
    "of_lanes_that_repeat": "ln of the orbit's largest |multiplier| over the time of its repeat",
    "tolerance": TANGENT_ACCURACY.tolerance,
    "returns_before": RETURNS_BEFORE,
    "returns": [EXPONENT_MIN_RETURNS, EXPONENT_MAX_RETURNS],
    "returns_per_observed": PER_OBSERVED,
    "blocks": EXPONENT_BLOCKS,
    "transient": "chaotic motion in which a stable orbit of the return map was found counts as not-settled",
}
"""A dataset's attribute `lyapunov`: which exponent the dataset holds, and how it was computed."""


def nature(name: str) -> int:
    """Return the flag value of `nature` with the meaning `name`, such as "chaotic"."""
    return NATURES.index(name)


class Natures:
    """Largest Lyapunov exponents of lanes, and classification of the lanes by them: a stage of a run.

    An object is called with the features of one chunk at a time. A periodic lane has the exponent of its orbit: the
    logarithm of the orbit's largest |multiplier| divided by the time of one period. Other lanes are continued along the
    return map with a tangent vector, see [vibrojax.periodic.growth][], which may find a period too long for labels.
    """

    attribute = "lyapunov"
    described = EXPONENTS_DESCRIBED

    def __init__(self, scene: Scene[Any], run: RunSettings, start_names: tuple[str, ...]) -> None:
        self._scene = scene.driving_part()
        self._orbits = None if run.orbits else OrbitStage(scene, run, start_names)

    def __call__(self, inputs: LaneInputs, features: Features) -> Features:
        """Return the features `lyapunov`, `lyapunov_stderr`, `zero_one` and `nature` of some lanes.

        `features`: features of the lanes by name, with last returns, and with orbits if the run has them.
        """
        regime = regimes(inputs.scene, inputs.parameters, features)
        orbit = features if self._orbits is None else self._orbits(inputs, features)
        result: Features = {name: np.full(len(inputs), np.nan) for name in ("lyapunov", "lyapunov_stderr", "zero_one")}
        result["nature"] = np.full(len(inputs), nature("unknown"))
        with np.errstate(all="ignore"):
            period, why = orbit.get("period", features["period"]), orbit["orbit_reason"]
            known = why == reason("found")
            exponent = np.log(orbit["multiplier_abs"][:, 0]) / (period * features["cycles"])
            result["lyapunov"][known], result["lyapunov_stderr"][known] = exponent[known], 0.0
            stable = known & (orbit["stable"] == 1)
            result["nature"][stable | (why == reason("near-grazing"))] = nature("periodic")
            result["nature"][known & ~stable] = nature("not-settled")
            without_orbit = np.isin(why, [reason("not-converged"), reason("another-orbit")])
            unsettled = without_orbit | np.isin(regime, (IRREGULAR, UNDECIDED))
            unsettled &= features["finite"] & features["finished"] & (features["returns"] > 0)
            own = inputs.driving_parameters
            needed = np.minimum(PER_OBSERVED * features["returns"], MOST_OBSERVED)
            longest = max(float(needed[unsettled].max(initial=0)) / EXPONENT_MAX_RETURNS, 1.0)
            batches = int(np.ceil(unsettled.sum() * longest / UNSETTLED_LANES_TOGETHER)) or 1
            for lanes in np.array_split(np.flatnonzero(unsettled), batches):
                self._continue(lanes, own, features, result)
        return result

    def _continue(self, lanes: Index, parameters: dict[str, np.ndarray], features: Features, result: Features) -> None:
        """Continue non-periodic lanes until they can be classified; write exponents and classes to `result`."""
        begin, scales = last_returns(self._scene, lanes, 1, features)
        # States that regime labels do not compare have no scale; their absolute value is used instead.
        size = np.maximum(np.abs(begin[:, 0]), np.finfo(float).tiny)
        state, scale = begin[:, 0].T, np.where(np.isfinite(scales), scales, size).T
        usable = np.isfinite(state).all(axis=0) & (np.isfinite(scale) & (scale > 0)).all(axis=0)
        lanes, state, scale = lanes[usable], state[:, usable], scale[:, usable]
        state = self._settle({name: x[lanes] for name, x in parameters.items()}, state, scale)
        tangent = np.full(state.shape, len(state) ** -0.5)
        growth: Growth | None = None
        needed, returns = np.minimum(PER_OBSERVED * features["returns"][lanes], MOST_OBSERVED), EXPONENT_MIN_RETURNS
        while len(lanes):
            values = {name: x[lanes] for name, x in parameters.items()}
            new = grow(self._scene, values, state, tangent, scale, returns)
            if growth is not None:
                rate, time, states = (np.concatenate(pair) for pair in zip(growth[:3], new[:3], strict=True))
                new = Growth(rate, time, states, new.tangent)
            growth, returns = new, len(new.rate)
            exponent, error = exponents(growth.rate, growth.time)
            repeat = exponents_of_repeats(*growth[:3], scale, exponent, error)
            clear, flags = classify_growth(growth, repeat, exponent, error, last=returns >= EXPONENT_MAX_RETURNS)
            clear &= returns * 2**0.5 >= needed  # the nearest number that doubling leads to
            # Chaos appears in some states later than in others, so the largest K counts.
            tested = growth.states[-TESTED_RETURNS:][..., clear]
            k = np.max([zero_one(tested[:, index]) for index in range(len(state))], axis=0)
            known = flags[clear]
            flags[clear] = np.where((known == nature("unknown")) & (k > CHAOTIC_K), nature("chaotic"), known)
            chaos = np.flatnonzero(clear & (flags == nature("chaotic")))
            of_chaos = {name: x[chaos] for name, x in values.items()}
            transient = has_embedded_orbit(self._scene, of_chaos, growth.states[..., chaos], scale[:, chaos])
            flags[chaos[transient]] = nature("not-settled")
            repeat = np.where(clear & (flags == nature("periodic")), repeat, 0)
            exponents_of_orbits(self._scene, values, growth.states, scale, repeat, exponent, error)
            result["lyapunov"][lanes], result["lyapunov_stderr"][lanes] = exponent, error
            result["nature"][lanes], result["zero_one"][lanes[clear]] = flags, k
            lanes, needed = lanes[~clear], needed[~clear]
            state, scale = growth.states[-1][:, ~clear], scale[:, ~clear]
            growth = Growth(*(x[..., ~clear] for x in growth))
            tangent = growth.tangent

    def _settle(self, parameters: Mapping[str, PerLane], state: PerState, scale: PerState) -> PerState:
        """Return the states of lanes after `RETURNS_BEFORE` more returns, or at the check that finds them periodic."""
        state, active = state.copy(), np.arange(state.shape[1])
        for _ in range(RETURNS_BEFORE // RETURNS_PER_CHECK):
            if not len(active):
                break
            values = {name: x[active] for name, x in parameters.items()}
            now, size = state[:, active], scale[:, active]
            kept = 4 * LONGEST_REPEAT
            states = grow(self._scene, values, now, size, size, RETURNS_PER_CHECK, kept=kept, grows=False).states
            state[:, active] = states[-1]
            active = active[(find_repeats(states, size) == 0) & np.isfinite(states[-1]).all(axis=0)]
        return state


def classify_growth(
    growth: Growth, repeat: Int[np.ndarray, " lanes"], exponent: PerLane, error: PerLane, last: bool
) -> tuple[Bool[np.ndarray, " lanes"], Int[np.ndarray, " lanes"]]:
    """Return a mask of the lanes that can be classified, and the flag value of `nature` of each lane.

    `last`: True if no section crossings are left; then all lanes are classified.
    """
    lost = ~np.isfinite(growth.states[-1]).all(axis=0)
    per_return = along_rows(growth.time[-EXPONENT_BLOCKS:]) / EXPONENT_BLOCKS
    threshold = np.maximum((FINAL_STDERRS if last else CLEAR_STDERRS) * error, ZERO_EXPONENT / per_return)
    spread, longer = (np.ptp(growth.states[-count * LONGEST_REPEAT :], axis=0) for count in (1, 4))
    # A motion that spirals towards an orbit seems periodic after a revolution, but its extent keeps shrinking.
    spirals = np.any(spread < STEADY_SPREAD * longer, axis=0)
    rules = [
        (lost | ((repeat > 0) & ((repeat <= LABELLED_REPEAT) | spirals)), "not-settled"),
        (repeat > LABELLED_REPEAT, "periodic"),
        (exponent > threshold, "chaotic"),
        (exponent < -threshold, "not-settled"),
        (last & (error * per_return < ZERO_STDERR), "quasi-periodic"),
    ]
    conditions, names = zip(*rules, strict=True)
    return np.any(conditions, axis=0) | last, np.select(conditions, list(map(nature, names)), nature("unknown"))


def exponents_of_orbits(
    scene: Scene,
    parameters: Mapping[str, Float[np.ndarray, " lanes"]],
    states: Float[np.ndarray, "returns states lanes"],
    scale: PerState,
    repeat: Int[np.ndarray, " lanes"],
    exponent: PerLane,
    error: PerLane,
) -> None:
    """Replace, in place, the exponents of lanes that repeat by those of their orbits, and the errors by 0.

    The scatter of a motion that repeats does not contain the error of its steps. Where Newton's method fails, the
    difference between the exponent and that of the last period at the tighter tolerance of orbits is added instead.

    **Arguments:** `states`, `scale`: see `has_embedded_orbit`; `repeat`: period in returns, 0 for other lanes.
    """
    segments = Segments(scene, most=MOST_STEPS)
    for length in np.unique(repeat[repeat > 0]):
        lanes = np.flatnonzero(repeat == length)
        values = {name: x[lanes] for name, x in parameters.items()}
        guess = states[-int(length) :, :, lanes].transpose(2, 0, 1)
        with np.errstate(all="ignore"):
            orbit = Orbits.find(scene, values, guess, scale.T[lanes], REACH, segments)
            own = np.log(np.abs(orbit.multipliers[:, 0])) / orbit.times.sum(axis=1)
            doubtful = np.fmax(error[lanes], error[lanes] + np.abs(own - exponent[lanes]))
        sound = orbit.converged & ~np.isnan(own)
        error[lanes] = np.where(sound, 0.0, doubtful)
        exponent[lanes] = np.where(sound, own, exponent[lanes])


def has_embedded_orbit(
    scene: Scene,
    parameters: Mapping[str, Float[np.ndarray, " lanes"]],
    states: Float[np.ndarray, "returns states lanes"],
    scale: PerState,
) -> Bool[np.ndarray, " lanes"]:
    """Return for which lanes a stable orbit was found within their chaotic motion, which is then a transient.

    A chaotic motion recurs close to earlier states, and so to the periodic orbits embedded in it. Newton's method
    begins at the closest recurrences (Lathrop and Kostelich, Physical Review A 40 (1989) 4028).

    **Arguments:** `states`: states at the section; `scale`: scale of each state.
    """
    segments = Segments(scene, steps=STEPS._replace(tolerance=1e-9), most=MOST_STEPS)
    stable = np.zeros(states.shape[2], bool)
    for repeat in range(1, EMBEDDED_MAX_RETURNS + 1):
        remaining = np.flatnonzero(~stable)
        own = states[..., remaining]
        distance = np.max(np.abs(own[repeat:] - own[:-repeat]) / scale[:, remaining], axis=1)
        part = len(distance) // EMBEDDED_TRIALS
        parts = distance[: part * EMBEDDED_TRIALS].reshape(EMBEDDED_TRIALS, part, len(remaining))
        trial, column = np.nonzero(parts.min(axis=1) < EMBEDDED_WITHIN)
        lanes = remaining[column]
        if not len(lanes):
            continue
        first = parts.argmin(axis=1)[trial, column] + part * trial
        begin = np.stack([own[first + k, :, column] for k in range(repeat)], axis=1)
        values = {name: x[lanes] for name, x in parameters.items()}
        with np.errstate(all="ignore"):
            orbit = Orbits.find(scene, values, begin, scale.T[lanes], REACH, segments, ACCEPTED)
            accepted = orbit.converged & orbit.stable & (orbit.minimal_cycles() == repeat)
        stable[lanes[accepted]] = True
    return stable
