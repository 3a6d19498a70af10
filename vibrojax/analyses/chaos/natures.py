"""The natures of a sweep's lanes: periodic, quasi-periodic, chaotic, or not settled, by their greatest exponent."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.analyses.chaos.growth import STEPS, Growth, go_on, grow
from vibrojax.analyses.chaos.windows import stable_amid
from vibrojax.analyses.chaos.zero_one import zero_one
from vibrojax.io.variables import NATURES
from vibrojax.measures.labels import IRREGULAR, UNDECIDED
from vibrojax.measures.repeats import REPEATS_WITHIN
from vibrojax.periodic import Orbits
from vibrojax.periodic.of_lanes import last_returns, reason
from vibrojax.sweep.engine.batch import Features, Index
from vibrojax.sweep.engine.labelled import regimes
from vibrojax.sweep.input.definition import Sweep

BEFORE, EACH = 14336, 2048
"""Returns that a lane goes on for before its exponent is taken, and after how many of them it is looked at whether it
has come to repeat. Chaos may be a transient, of any length: over the default map 4 to 6 of 100 lanes end to be chaotic
between 2,048 returns and twice as many, 5 between these and twice as many again, 4 up to 16,384."""

FEWEST, MOST = 2048, 8192
"""Returns that its exponent is taken over: doubled where its nature is not clear."""

TOGETHER = 512
"""Lanes that go on together: their returns are kept meanwhile."""

LATE = 0.75
"""Part of them, the last, that the exponent is of; the tangent turns into its direction before, and transients end."""

BLOCKS = 16
"""Blocks of returns, whose exponents scatter as the standard error says."""

CLEAR, ENOUGH = 6.0, 3.0
"""Standard errors from zero at which an exponent's sign is clear before the last return, and then."""

RESOLVED = 0.002
"""Standard error per return below which an exponent that does not differ from zero is taken for zero."""

NEXT_TO_NONE = 5e-4
"""Exponent per return that is taken for zero however sure it is."""

SECOND_OPINION = 0.9
"""K of the 0-1 test from which a lane is chaotic whose exponent decides nothing."""

LONGEST_REPEAT = 64
"""Returns of the longest repeat that is looked for."""

LABELLED_REPEAT = 8
"""Those of the longest that labels know; a lane that comes to one of these later had not settled."""

STEADY = 0.99
"""Part of their spread that the states of a long repeat keep over a few of them."""

TESTED = 1024
"""Returns, the last, that the 0-1 test takes."""

PerLane = Float[np.ndarray, " lanes"]
PerReturn = Float[np.ndarray, "returns lanes"]
States = Float[np.ndarray, "states lanes"]


def nature(name: str) -> int:
    """The flag of `nature` that means `name`."""
    return NATURES.index(name)


class Natures:
    """Finds the greatest exponents of lanes, and their natures, chunk by chunk.

    A lane that repeats has that of its orbit, ln|greatest multiplier| over the repeat's time. Others go on along the
    return map with a tangent, see [vibrojax.analyses.chaos.growth][].
    """

    def __init__(self, sweep: Sweep) -> None:
        self._sweep = sweep
        self._scene = sweep.system.driving_part()
        self._orbits = None if sweep.run.orbits else Orbits(sweep)

    @property
    def described(self) -> dict[str, object]:
        """What the attribute `lyapunov` of a dataset says: which exponent it is, and how it was found."""
        return {
            "exponent": "greatest of the flow but the trivial zero: of the return map, per second; natural logarithm",
            "stick": "loses one direction, whose exponent is minus infinity; the greatest of the others stays finite",
            "of_lanes_that_repeat": "ln of the orbit's greatest |multiplier| over the time of its repeat",
            "tolerance": STEPS.tolerance,
            "returns_before": BEFORE,
            "returns": [FEWEST, MOST],
            "blocks": BLOCKS,
            "transient": "chaotic motion amid which a stable orbit of the return map was found counts as not-settled",
        }

    def __call__(self, first: int, end: int, features: Features) -> Features:
        """`lyapunov`, `lyapunov_stderr`, `zero_one` and `nature` of the lanes from `first` to before `end`.

        `features` are those of the lanes, by name, among them their last returns, and their orbits if the sweep is to
        have them; not changed.
        """
        lanes = end - first
        parameters, _ = self._sweep.lane_values(first, end)
        regime = regimes(self._sweep.system, parameters, features)
        orbits = features if self._orbits is None else self._orbits(first, end, features)
        found: Features = {name: np.full(lanes, np.nan) for name in ("lyapunov", "lyapunov_stderr", "zero_one")}
        found["nature"] = np.full(lanes, nature("unknown"))
        with np.errstate(all="ignore"):
            self._of_orbits(orbits, features, found)
            astray = np.isin(orbits["orbit_reason"], [reason("not-converged"), reason("another-orbit")])
            still = astray | np.isin(regime, (IRREGULAR, UNDECIDED))
            still &= features["finite"] & features["finished"] & (features["returns"] > 0)
            given = {name: parameters[name] for name in self._scene.parameters()}
            for some in np.array_split(np.flatnonzero(still), -(-int(still.sum()) // TOGETHER) or 1):
                self._of_others(some, given, features, found)
        return found

    def _of_orbits(self, orbits: Features, features: Features, found: Features) -> None:
        """Enter those of lanes whose orbit was found."""
        period = orbits.get("period", features["period"])
        known = orbits["orbit_reason"] == reason("found")
        exponent = np.log(orbits["multiplier_abs"][:, 0]) / (period * features["cycles"])
        found["lyapunov"][known] = exponent[known]
        found["lyapunov_stderr"][known] = 0.0
        stable = known & (orbits["stable"] == 1)
        found["nature"][stable | (orbits["orbit_reason"] == reason("near-grazing"))] = nature("periodic")
        found["nature"][known & ~stable] = nature("not-settled")

    def _of_others(self, lanes: Index, parameters: dict[str, np.ndarray], features: Features, found: Features) -> None:
        """Enter those of lanes that do not repeat: they go on until it is clear what they are."""
        begin, scales = last_returns(self._scene, lanes, 1, features)
        state, scale = begin[:, 0].T, _complete(scales, begin[:, 0]).T
        usable = np.isfinite(state).all(axis=0) & (np.isfinite(scale) & (scale > 0)).all(axis=0)
        lanes, state, scale = lanes[usable], state[:, usable], scale[:, usable]
        given = {name: x[lanes] for name, x in parameters.items()}
        state = self._later(given, state, scale)
        tangent = np.full(state.shape, len(state) ** -0.5)
        gone: Growth | None = None
        more = FEWEST
        while len(lanes):
            given = {name: x[lanes] for name, x in parameters.items()}
            new = grow(self._scene, given, state, tangent, scale, more)
            gone = new if gone is None else _joined(gone, new)
            more = len(gone.rate)
            exponent, error = exponents(gone.rate, gone.time)
            repeat, exponent, error = _of_repeats(gone, scale, exponent, error)
            clear, flags = judged(gone, repeat, exponent, error, last=more >= MOST)
            tested = _tested(gone.states[-TESTED:][..., clear])
            known = flags[clear]
            flags[clear] = np.where((known == nature("unknown")) & (tested > SECOND_OPINION), nature("chaotic"), known)
            chaos = np.flatnonzero(clear & (flags == nature("chaotic")))
            of_chaos = {name: x[chaos] for name, x in given.items()}
            amid = stable_amid(self._scene, of_chaos, gone.states[..., chaos], scale[:, chaos])
            flags[chaos[amid]] = nature("not-settled")
            found["lyapunov"][lanes], found["lyapunov_stderr"][lanes] = exponent, error
            found["nature"][lanes], found["zero_one"][lanes[clear]] = flags, tested
            keep = ~clear
            lanes, state, scale = lanes[keep], gone.states[-1][:, keep], scale[:, keep]
            gone = Growth(*(x[..., keep] for x in gone))
            tangent = gone.tangent

    def _later(self, parameters: Mapping[str, PerLane], state: States, scale: States) -> States:
        """Where lanes are `BEFORE` returns later, or where they have come to repeat."""
        state, active = state.copy(), np.arange(state.shape[1])
        for _ in range(BEFORE // EACH):
            if not len(active):
                break
            given = {name: x[active] for name, x in parameters.items()}
            states = go_on(self._scene, given, state[:, active], scale[:, active], EACH, kept=4 * LONGEST_REPEAT)
            state[:, active] = states[-1]
            active = active[(_repeat(states, scale[:, active]) == 0) & np.isfinite(states[-1]).all(axis=0)]
        return state


def exponents(rate: PerReturn, time: PerReturn) -> tuple[PerLane, PerLane]:
    """Growth per second of each lane over the later returns, and its standard error.

    The mean is weighted by a bump that is flat at both ends, with which that of a regular motion converges faster than
    any power of its length (Das, Saiki, Sander and Yorke, Nonlinearity 30 (2017) 4111); that of a chaotic one is as
    good as any. The error is by blocks, each weighted in the same way: what a tangent gains at the end of a block by
    where it happens to stand, and loses in the next, would else count as scatter.
    """
    late = int(LATE * len(rate)) // BLOCKS * BLOCKS
    growth, seconds = rate[-late:], time[-late:]
    weight = _bump(late)
    exponent = weight @ growth / (weight @ seconds)
    each = _bump(late // BLOCKS)
    blocks = [np.einsum("r,brl->bl", each, x.reshape(BLOCKS, -1, x.shape[1])) for x in (growth, seconds)]
    return exponent, np.std(blocks[0] / blocks[1], axis=0, ddof=1) / BLOCKS**0.5


def _bump(count: int) -> Float[np.ndarray, " count"]:
    """Weights that are flat at both ends, with all derivatives."""
    share = (np.arange(count) + 0.5) / count
    return np.exp(-1 / (share * (1 - share)))


def judged(
    gone: Growth, repeat: Int[np.ndarray, " lanes"], exponent: PerLane, error: PerLane, last: bool
) -> tuple[Bool[np.ndarray, " lanes"], Int[np.ndarray, " lanes"]]:
    """Of which lanes it is clear what they are, all if these returns are the `last`; and their natures."""
    away = ~np.isfinite(gone.states[-1]).all(axis=0)
    per_return = gone.time[-BLOCKS:].mean(axis=0)
    enough = np.maximum((ENOUGH if last else CLEAR) * error, NEXT_TO_NONE / per_return)
    spread = np.ptp(gone.states[-LONGEST_REPEAT:], axis=0), np.ptp(gone.states[-4 * LONGEST_REPEAT :], axis=0)
    # What spirals towards an orbit repeats after its turn, but for less and less.
    spirals = np.any(spread[0] < STEADY * spread[1], axis=0)
    rules = [
        (away | ((repeat > 0) & ((repeat <= LABELLED_REPEAT) | spirals)), "not-settled"),
        (repeat > LABELLED_REPEAT, "periodic"),
        (exponent > enough, "chaotic"),
        (exponent < -enough, "not-settled"),
        (last & (error * per_return < RESOLVED), "quasi-periodic"),
    ]
    conditions, names = zip(*rules, strict=True)
    return np.any(conditions, axis=0) | last, np.select(conditions, list(map(nature, names)), nature("unknown"))


def _repeat(states: Float[np.ndarray, "returns states lanes"], scale: States) -> Int[np.ndarray, " lanes"]:
    """Returns, the fewest, after which lanes have come to repeat; 0: none."""
    repeat = np.zeros(states.shape[2], int)
    for length in range(LONGEST_REPEAT, 0, -1):
        late = states[-3 * length - 1 :]
        repeat[np.all(np.abs(late[length:] - late[:-length]) < REPEATS_WITHIN * scale, axis=(0, 1))] = length
    return repeat


def _of_repeats(
    gone: Growth, scale: States, exponent: PerLane, error: PerLane
) -> tuple[Int[np.ndarray, " lanes"], PerLane, PerLane]:
    """Returns after which lanes have come to repeat, 0: none; their exponents and errors, over what repeats alone."""
    repeat = _repeat(gone.states, scale)
    for lane in np.flatnonzero(repeat):
        length, states = int(repeat[lane]), gone.states[:, :, lane]
        apart = np.all(np.abs(states[length:] - states[:-length]) < REPEATS_WITHIN * scale[:, lane], axis=1)
        within = int(np.cumprod(apart[::-1]).sum()) + length
        blocks = min(BLOCKS, within // length)
        whole = within // (length * blocks) * length * blocks
        growth, seconds = (x[-whole:, lane].reshape(blocks, -1).sum(axis=1) for x in (gone.rate, gone.time))
        # A motion that only lingers by one that repeats still goes away from it.
        if growth.sum() < 0:
            exponent[lane] = float(growth.sum()) / float(seconds.sum())
            error[lane] = float(np.std(growth / seconds, ddof=1)) / blocks**0.5
        else:
            repeat[lane] = 0
    return repeat, exponent, error


def _tested(states: Float[np.ndarray, "returns states lanes"]) -> PerLane:
    """The 0-1 test by the state that says most: chaos shows in some later than in others."""
    return np.max([zero_one(states[:, index]) for index in range(states.shape[1])], axis=0)


def _complete(scales: Float[np.ndarray, "lanes states"], states: Float[np.ndarray, "lanes states"]) -> Any:
    """Scales of all states: of those that labels do not compare, their size."""
    return np.where(np.isfinite(scales), scales, np.maximum(np.abs(states), np.finfo(float).tiny))


def _joined(before: Growth, after: Growth) -> Growth:
    """One after the other."""
    rate, time, states = (np.concatenate(pair) for pair in zip(before[:3], after[:3], strict=True))
    return Growth(rate, time, states, after.tangent)
