"""Natures of a sweep's lanes by their largest exponent: periodic, quasi-periodic, chaotic, or not settled."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.analyses.chaos.series import (
    EXPONENT_BLOCKS,
    LONGEST_REPEAT,
    PerLane,
    exponents,
    exponents_of_repeats,
    find_repeats,
    zero_one,
)
from vibrojax.analyses.chaos.tangents import TANGENT_ACCURACY, Growth, go_on, grow
from vibrojax.analyses.chaos.transients import has_stable_orbit
from vibrojax.io.variables import NATURES
from vibrojax.measures.labels import IRREGULAR, UNDECIDED
from vibrojax.periodic import Orbits
from vibrojax.periodic.of_lanes import last_returns, reason
from vibrojax.sweep.engine.batch import Features, Index
from vibrojax.sweep.engine.labelled import regimes
from vibrojax.sweep.input.definition import Sweep

RETURNS_BEFORE, RETURNS_PER_CHECK = 14336, 2048
"""Returns before an exponent is taken, and after how many of them a lane is checked for a repeat. Chaos may be a
transient of any length: over the default map, chaos ends in 4 to 6 of 100 lanes between 2,048 and 4,096 returns, in 5
between 4,096 and 8,192, and in 4 between 8,192 and 16,384."""

EXPONENT_MIN_RETURNS, EXPONENT_MAX_RETURNS = 2048, 8192
"""Returns that an exponent is taken over; the number doubles as long as the nature is unclear."""

UNSETTLED_LANES_TOGETHER = 512
"""Lanes that are continued together; it bounds the memory of their returns."""

CLEAR_STDERRS, FINAL_STDERRS = 6.0, 3.0
"""Standard errors from zero at which an exponent's sign is clear: before the last return, and after it."""

ZERO_STDERR = 0.002
"""Standard error per return below which an exponent that does not differ from zero counts as zero."""

ZERO_EXPONENT = 5e-4
"""Exponent per return that counts as zero, however small its standard error."""

CHAOTIC_K = 0.9
"""K of the 0-1 test above which a lane is chaotic if its exponent decides nothing."""

LABELLED_REPEAT = 8
"""Longest repeat that labels recognise; a lane that comes to one of these later had not settled."""

STEADY_SPREAD = 0.99
"""Share of their spread that the states of a long repeat keep over a few repeats."""

TESTED_RETURNS = 1024
"""Returns, the last, that the 0-1 test uses."""

States = Float[np.ndarray, "states lanes"]


def nature(name: str) -> int:
    """Return the flag of `nature` that means `name`."""
    return NATURES.index(name)


class Natures:
    """Largest exponents of a sweep's lanes, and their natures, chunk by chunk.

    A lane that repeats has the exponent of its orbit: the logarithm of its largest |multiplier| over the time of its
    repeat. Other lanes are continued along the return map with a tangent, see [vibrojax.analyses.chaos.tangents][].
    """

    def __init__(self, sweep: Sweep) -> None:
        self._sweep = sweep
        self._scene = sweep.system.driving_part()
        self._orbits = None if sweep.run.orbits else Orbits(sweep)

    @property
    def described(self) -> dict[str, object]:
        """Value of a dataset's attribute `lyapunov`: which exponent it holds, and how it was computed."""
        return {
            "exponent": "largest of the flow except the trivial zero: of the return map, per second; natural logarithm",
            "stick": "loses one direction, whose exponent is minus infinity; the largest of the others stays finite",
            "of_lanes_that_repeat": "ln of the orbit's largest |multiplier| over the time of its repeat",
            "tolerance": TANGENT_ACCURACY.tolerance,
            "returns_before": RETURNS_BEFORE,
            "returns": [EXPONENT_MIN_RETURNS, EXPONENT_MAX_RETURNS],
            "blocks": EXPONENT_BLOCKS,
            "transient": "chaotic motion amid which a stable orbit of the return map was found counts as not-settled",
        }

    def __call__(self, first: int, end: int, features: Features) -> Features:
        """Return `lyapunov`, `lyapunov_stderr`, `zero_one` and `nature` of the lanes from `first` to before `end`.

        **Arguments:** `features`: of the lanes by name, with their last returns, and with orbits if the sweep has them.
        """
        parameters, _ = self._sweep.lane_values(first, end)
        regime = regimes(self._sweep.system, parameters, features)
        orbits = features if self._orbits is None else self._orbits(first, end, features)
        result: Features = {name: np.full(end - first, np.nan) for name in ("lyapunov", "lyapunov_stderr", "zero_one")}
        result["nature"] = np.full(end - first, nature("unknown"))
        with np.errstate(all="ignore"):
            period, why = orbits.get("period", features["period"]), orbits["orbit_reason"]
            known = why == reason("found")
            exponent = np.log(orbits["multiplier_abs"][:, 0]) / (period * features["cycles"])
            result["lyapunov"][known], result["lyapunov_stderr"][known] = exponent[known], 0.0
            stable = known & (orbits["stable"] == 1)
            result["nature"][stable | (why == reason("near-grazing"))] = nature("periodic")
            result["nature"][known & ~stable] = nature("not-settled")
            without_orbit = np.isin(why, [reason("not-converged"), reason("another-orbit")])
            unsettled = without_orbit | np.isin(regime, (IRREGULAR, UNDECIDED))
            unsettled &= features["finite"] & features["finished"] & (features["returns"] > 0)
            own = {name: parameters[name] for name in self._scene.parameters()}
            batches = -(-int(unsettled.sum()) // UNSETTLED_LANES_TOGETHER) or 1
            for lanes in np.array_split(np.flatnonzero(unsettled), batches):
                self._continue(lanes, own, features, result)
        return result

    def _continue(self, lanes: Index, parameters: dict[str, np.ndarray], features: Features, result: Features) -> None:
        """Continue lanes that do not repeat until their natures are clear, and enter their exponents and natures."""
        begin, scales = last_returns(self._scene, lanes, 1, features)
        # States that labels do not compare have no scale; their size serves instead.
        size = np.maximum(np.abs(begin[:, 0]), np.finfo(float).tiny)
        state, scale = begin[:, 0].T, np.where(np.isfinite(scales), scales, size).T
        usable = np.isfinite(state).all(axis=0) & (np.isfinite(scale) & (scale > 0)).all(axis=0)
        lanes, state, scale = lanes[usable], state[:, usable], scale[:, usable]
        state = self._settle({name: x[lanes] for name, x in parameters.items()}, state, scale)
        tangent = np.full(state.shape, len(state) ** -0.5)
        growth: Growth | None = None
        returns = EXPONENT_MIN_RETURNS
        while len(lanes):
            values = {name: x[lanes] for name, x in parameters.items()}
            new = grow(self._scene, values, state, tangent, scale, returns)
            if growth is not None:
                series = (np.concatenate(pair) for pair in zip(growth[:3], new[:3], strict=True))
                new = Growth(*series, new.tangent)
            growth, returns = new, len(new.rate)
            exponent, error = exponents(growth.rate, growth.time)
            repeat = exponents_of_repeats(*growth[:3], scale, exponent, error)
            clear, flags = classify_growth(growth, repeat, exponent, error, last=returns >= EXPONENT_MAX_RETURNS)
            # Chaos shows in some states later than in others, so the largest K counts.
            tested = growth.states[-TESTED_RETURNS:][..., clear]
            k = np.max([zero_one(tested[:, index]) for index in range(len(state))], axis=0)
            known = flags[clear]
            flags[clear] = np.where((known == nature("unknown")) & (k > CHAOTIC_K), nature("chaotic"), known)
            chaos = np.flatnonzero(clear & (flags == nature("chaotic")))
            of_chaos = {name: x[chaos] for name, x in values.items()}
            transient = has_stable_orbit(self._scene, of_chaos, growth.states[..., chaos], scale[:, chaos])
            flags[chaos[transient]] = nature("not-settled")
            result["lyapunov"][lanes], result["lyapunov_stderr"][lanes] = exponent, error
            result["nature"][lanes], result["zero_one"][lanes[clear]] = flags, k
            lanes, state, scale = lanes[~clear], growth.states[-1][:, ~clear], scale[:, ~clear]
            growth = Growth(*(x[..., ~clear] for x in growth))
            tangent = growth.tangent

    def _settle(self, parameters: Mapping[str, PerLane], state: States, scale: States) -> States:
        """Return the states of lanes `RETURNS_BEFORE` returns later, or when they have come to repeat."""
        state, active = state.copy(), np.arange(state.shape[1])
        for _ in range(RETURNS_BEFORE // RETURNS_PER_CHECK):
            if not len(active):
                break
            values = {name: x[active] for name, x in parameters.items()}
            now, size = state[:, active], scale[:, active]
            states = go_on(self._scene, values, now, size, RETURNS_PER_CHECK, kept=4 * LONGEST_REPEAT)
            state[:, active] = states[-1]
            active = active[(find_repeats(states, size) == 0) & np.isfinite(states[-1]).all(axis=0)]
        return state


def classify_growth(
    growth: Growth, repeat: Int[np.ndarray, " lanes"], exponent: PerLane, error: PerLane, last: bool
) -> tuple[Bool[np.ndarray, " lanes"], Int[np.ndarray, " lanes"]]:
    """Return which lanes' natures are clear, all of them if these returns are the `last`; and the natures."""
    lost = ~np.isfinite(growth.states[-1]).all(axis=0)
    per_return = growth.time[-EXPONENT_BLOCKS:].mean(axis=0)
    threshold = np.maximum((FINAL_STDERRS if last else CLEAR_STDERRS) * error, ZERO_EXPONENT / per_return)
    spread, longer = (np.ptp(growth.states[-count * LONGEST_REPEAT :], axis=0) for count in (1, 4))
    # A motion that spirals towards an orbit repeats after its turn, but over ever smaller distances.
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
