"""The smallest push in each state after which a machine no longer returns to its working cycle: `smallest_push`."""

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from vibrojax.analyses.attractors.grouping import SAME
from vibrojax.analyses.push.spec import PRECISION, SCAN, PushAsked, read_pushed
from vibrojax.analyses.sweep.run import run_sweep
from vibrojax.errors import Place
from vibrojax.io.provenance import provenance
from vibrojax.io.variables import ORBIT_REASONS, REASONS, VARIABLES, orbit_name
from vibrojax.measures.labels import EQUILIBRIUM, IRREGULAR, REGIMES, UNDECIDED
from vibrojax.models.physics.parameters import differing
from vibrojax.models.scenes import Scene
from vibrojax.periodic.of_dataset import KnownOrbits, known_orbits
from vibrojax.sweep.input.points import VECTOR
from vibrojax.sweep.input.read import read_sweep

SCANS = 5
"""Scans at most, each below the smallest push that the one before found."""

PIECES, ROUNDS = 32, 4
"""In so many pieces a bracket is cut at once, so many times at most."""

PATIENCE = 6.0
"""A motion that is irregular goes on for so many times as long: it may be on its way back."""

SIGNS = (-1, 1)

METHOD = (
    "pushes at the section of the working cycle, scan of them in each direction evenly up to the bound, then as many "
    "below the smallest that leaves, until nothing smaller is found; between that and the greatest below it that is "
    "returned from, the same until that bracket is narrow. What is irregular then goes on for patience times as long. "
    "Basins have holes: what is narrower than the steps of the scans is missed"
)

Pushes = Float[np.ndarray, "points directions pushes"]
PerDirection = Float[np.ndarray, "points directions"]
Regimes = Int[np.ndarray, "points directions"]


class Brackets(NamedTuple):
    """Of each direction the greatest push that is known to return below the smallest that leaves; that, NaN where none
    was found; and the regime that it ends in, 0 there."""

    low: PerDirection
    high: PerDirection
    regime: Regimes


def smallest_push(
    scene: str | Scene[Any],
    *,
    start: str | Sequence[float] | None = None,
    most: Mapping[str, float] | None = None,
    scan: int = SCAN,
    precision: float = PRECISION,
    settle: float = 40.0,
    observe: float = 8.0,
    progress: bool = True,
    **parameters: Any,
) -> xr.Dataset:
    """The smallest push in each state after which a machine no longer returns to its working cycle.

        push = vj.smallest_push("vibro-impact", beta=0.4, gamma=0.75, delta=0.005, start="stuck")
        push.push_v2.sel(sign=1)  # m/s that are added to the striker's velocity

    The working cycle is the orbit that the motion settles on. Where it passes the section (the bit overtakes the drive)
    one state is changed at once, to either side, and the motion goes on for `settle` and `observe`, six times as long
    where it is irregular. A scan up to the bound is followed by scans below the smallest push that leaves, until they
    find no smaller one, and that is refined. Basins have holes, and one that is narrower than the steps of these scans
    is missed: what is given is a push that leaves, the smallest that was found.

    **Arguments:**

    - `scene`: a name or a scene with a drill; `parameters`: any of its (SI), as `simulate` takes them. One or several
      may be sequences of one length: as many working cycles, all pushed at once, numbered along `point`.
    - `start`: of the motion whose cycle is pushed, by default the scene's first.
    - `most`: the greatest push in a state, by its name (x1, x2 [m], v1, v2 [m/s]); by default its whole swing over the
      cycle, or of a velocity that over the period times 2 pi.
    - `scan`: pushes of each scan in a direction; `precision`: the width of the bracket in the end, over the
      push.
    - `settle`, `observe` [s]: for which motions settle and are watched then.
    - `progress`: whether to say on stderr how far it is.

    **Returns:** a dataset. Along `sign` (-1, 1) for each state (here v2): `push_v2`, the smallest push found after
    which the motion ends elsewhere, NaN where there is none up to `bound_v2`; `bracket_v2`: by how much greater it is
    than the next smaller push that is known to return; `regime_v2`: where it ends. Of the working cycle `regime`,
    `period` and the state at the section (`orbit_x1` and so on).

    **Raises:** `InputError` where a name or value is not right, or there is no stable cycle to be pushed out of.

    **Example:**

    >>> point = {"beta": 0.4, "gamma": 0.75, "delta": 0.005, "start": "stuck"}
    >>> pushed = vj.smallest_push("vibro-impact", **point, progress=False)
    >>> f"{1e3 * float(pushed.push_x1.sel(sign=1)):.0f} mm"  # of the bit at the section; it ends in another motion
    '48 mm'
    """
    return push_asked(read_pushed(scene, start, most, scan, precision, settle, observe, parameters), progress)


def push_asked(asked: PushAsked, progress: bool = True) -> xr.Dataset:
    """The smallest pushes, as `smallest_push` gives them; raises `InputError` where no cycle is there to be pushed."""
    sweep = asked.sweep
    cycle = run_sweep(sweep, progress=progress)
    cycle = cycle.isel(start=0, drop=True) if "start" in cycle.dims else cycle
    cycle = cycle if "point" in cycle.dims else cycle.expand_dims("point")
    stable = np.flatnonzero(cycle["stable"].values == 1)
    if not len(stable):
        raise Place("smallest_push").error(_what_instead(cycle.isel(point=0)))
    states = sweep.system.start_states
    section = {name: cycle[orbit_name(name)].values[stable] for name in sweep.system.driving_part().return_states}
    at = np.stack([section.get(name, np.zeros(len(stable))) for name in states], axis=1)
    bound = _bounds(asked, cycle.isel(point=stable))
    scene, values = sweep.system.driving_part(), sweep.lane_values(0, sweep.lanes)[0]
    cycles = known_orbits(scene, cycle, {name: values[name] for name in scene.parameters()}, stable)
    found = _Pushed(asked, stable, at, cycles, progress).smallest(np.repeat(bound, len(SIGNS), axis=1))
    return _described(asked, cycle, stable, bound, found)


def _what_instead(lane: xr.Dataset) -> str:
    """Why there is no cycle to push."""
    reason = ORBIT_REASONS[int(lane["orbit_reason"])]
    if reason == "refused":
        return f"the motion cannot be run ({REASONS[int(lane['reason'])].replace('-', ' ')}); push it elsewhere"
    regime, settled = REGIMES[int(lane["regime"])], json.loads(str(lane.attrs["run"]))["settle"]
    why = "does not repeat" if reason == "not-repeating" else f"has no known orbit, {reason.replace('-', ' ')}"
    return f"the motion {why} ({regime} after {settled:g} s): no cycle to push; give another start or point"


def _bounds(asked: PushAsked, cycle: xr.Dataset) -> Float[np.ndarray, "points states"]:
    """The greatest push in each state."""
    section = asked.sweep.system.driving_part().section
    assert section is not None
    own: dict[str, np.ndarray] = {}
    for swing in section.swings:
        whole = 2 * cycle[swing.amplitude].values
        own[swing.position] = whole
        if swing.velocity is not None:
            own[swing.velocity] = whole * 2 * np.pi / cycle["period"].values
    columns = [
        np.full(cycle.sizes["point"], asked.most[name]) if name in asked.most else own[name]
        for name in asked.sweep.system.start_states
    ]
    return np.stack(columns, axis=1)


class _Pushed:
    """Runs motions that begin on cycles, pushed.

    `points`: those that have a cycle, by index; `at` (points, states): where each passes the section; `cycles`: they.
    """

    def __init__(
        self,
        asked: PushAsked,
        points: Int[np.ndarray, " points"],
        at: Float[np.ndarray, "points states"],
        cycles: KnownOrbits,
        shown: bool,
    ) -> None:
        self._asked, self._points, self._at, self._cycles, self._shown = asked, points, at, cycles, shown

    def smallest(self, bound: PerDirection) -> Brackets:
        """The smallest pushes that leave, each up to its `bound`."""
        scan = np.arange(1, self._asked.scan + 1) / self._asked.scan
        found = Brackets(np.zeros_like(bound), np.full_like(bound, np.nan), np.zeros(bound.shape, int))
        top, wanted = bound, np.ones(bound.shape, bool)
        for _ in range(SCANS):
            before = found.high
            found = self._narrowed(found, top[..., None] * scan, wanted)
            top, wanted = found.high, found.high < np.where(np.isnan(before), np.inf, before)
            if not wanted.any():
                break
        share = np.arange(1, PIECES) / PIECES
        for _ in range(ROUNDS):
            wide = found.high - found.low > self._asked.precision * found.high  # NaN is not
            if not wide.any():
                break
            found = self._narrowed(found, found.low[..., None] + (found.high - found.low)[..., None] * share, wide)
        return found

    def _narrowed(self, found: Brackets, pushes: Pushes, wanted: np.ndarray) -> Brackets:
        """The brackets after more pushes in the directions that are `wanted`: up to the smallest push that leaves, from
        the greatest below it that is returned from."""
        low, high, regime = (x.copy() for x in found)
        tried = pushes[wanted]
        back, left, ends = self._told(np.argwhere(wanted), tried)
        first = np.argmax(left, axis=1)[:, None]
        some = left.any(axis=1)
        high[wanted] = np.where(some, np.take_along_axis(tried, first, axis=1)[:, 0], high[wanted])
        regime[wanted] = np.where(some, np.take_along_axis(ends, first, axis=1)[:, 0], regime[wanted])
        top = np.where(np.isnan(high), np.inf, high)[wanted]
        below = np.max(np.where(back & (tried < top[:, None]), tried, 0.0), axis=1)
        low[wanted] = np.maximum(np.where(low[wanted] < top, low[wanted], 0.0), below)
        return Brackets(low, high, regime)

    def _told(self, directions: np.ndarray, pushes: Float[np.ndarray, "some pushes"]) -> tuple[np.ndarray, ...]:
        """Which pushes the cycle is returned to after, which are left by, and the regimes; as `pushes`.

        `directions` (some, 2): the point of each, and the number of the direction.
        """
        many = pushes.shape[1]
        point, state = np.repeat(directions[:, 0], many), np.repeat(directions[:, 1] // len(SIGNS), many)
        begin = self._at[point]
        begin[np.arange(len(point)), state] += np.repeat(np.array(SIGNS)[directions[:, 1] % 2], many) * pushes.ravel()
        back, left, regime = self._ended(point, begin, 1.0)
        again = np.flatnonzero(left & (regime == IRREGULAR))
        if len(again):
            later = self._ended(point[again], begin[again], PATIENCE)
            for whole, part in zip((back, left, regime), later, strict=True):
                whole[again] = part
        return tuple(x.reshape(pushes.shape) for x in (back, left, regime))

    def _ended(self, point: np.ndarray, begin: np.ndarray, times: float) -> tuple[np.ndarray, ...]:
        """Of motions of points that `begin` somewhere, each (lanes,), after so many `times` as long."""
        sweep, tables = self._asked.sweep, self._asked.tables
        columns = {name: np.array(x)[self._points[point]].tolist() for name, x in self._asked.columns.items()}
        columns |= {f"{VECTOR}{name}": x.tolist() for name, x in zip(sweep.system.start_states, begin.T, strict=True)}
        run = tables["run"] | {"settle": times * tables["run"]["settle"]}
        dataset = run_sweep(read_sweep(tables | {"points": columns, "run": run}), progress=self._shown)
        names = map(orbit_name, sweep.system.driving_part().return_states)
        orbits, regime = (
            np.stack([dataset[name].values for name in names], axis=1),
            dataset["regime"].values.astype(int),
        )
        back = np.zeros(len(point), bool)
        for number, (states, scales) in enumerate(zip(self._cycles.states, self._cycles.scales, strict=True)):
            some = np.flatnonzero((point == number) & (dataset["orbit_cycles"].values == len(states)))
            apart = np.abs(orbits[some, None] - states[None]) / scales
            back[some] = apart.max(axis=2).min(axis=1) < SAME
        on_another = np.isfinite(orbits).all(axis=1) & (dataset["stable"].values != 0) & (regime != UNDECIDED)
        # What only seems irregular, on its long way to an orbit nearby, is not told yet.
        irregular = (regime == IRREGULAR) & (dataset["nearby_cycles"].values == 0)
        return back, ~back & (on_another | irregular | (regime == EQUILIBRIUM)), regime


def _described(
    asked: PushAsked,
    cycle: xr.Dataset,
    stable: Int[np.ndarray, " stable"],
    bound: Float[np.ndarray, "stable states"],
    found: Brackets,
) -> xr.Dataset:
    """The dataset of pushes."""
    sweep, points = asked.sweep, cycle.sizes["point"]
    variables: dict[str, Any] = {}

    def entered(name: str, x: np.ndarray, about: Mapping[str, Any], none: float = np.nan) -> None:
        whole = np.full((points, *x.shape[1:]), none, x.dtype)
        whole[stable] = x
        variables[name] = (("point", "sign")[: x.ndim], whole, about)

    for k, name in enumerate(sweep.system.start_states):
        state, both = sweep.system.states[sweep.system.place(name)], slice(2 * k, 2 * k + 2)
        of, units = f"push in the {state.long_name}, at the section", {"units": state.unit}
        entered(
            f"push_{name}", found.high[:, both], units | {"long_name": f"smallest {of}, that leaves the working cycle"}
        )
        width = found.high[:, both] - found.low[:, both]
        entered(
            f"bracket_{name}", width, units | {"long_name": f"down to the next smaller {of}, that is returned from"}
        )
        entered(f"bound_{name}", bound[:, k], units | {"long_name": f"greatest {of}, that was tried"})
        flags = VARIABLES["regime"].attributes() | {"long_name": f"where the motion ends after the smallest {of}"}
        entered(f"regime_{name}", found.regime[:, both].astype(VARIABLES["regime"].dtype), flags, 0)
    own = ["regime", "period", *map(orbit_name, sweep.system.driving_part().return_states)]
    variables |= {name: ("point", cycle[name].values, cycle[name].attrs) for name in own}
    about = {"units": "1", "long_name": "side to which is pushed: -1 less, 1 more"}
    kept = {name: x for name, x in cycle.coords.items() if x.dims == ("point",)}
    attributes = {
        "title": f"Smallest pushes out of the working cycle: {sweep.scene}",
        "scene": sweep.scene,
        **provenance(),
        "history": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ} smallest_push",
        **sweep.options,
        "start": json.dumps(sweep.starts[0]) if sweep.starts is not None else "",
        "run": cycle.attrs["run"],
        "parameters": json.dumps(sweep.parameters),
        "differing": json.dumps(differing(sweep.system.parameters(), sweep.parameters)),
        "pushes": json.dumps(
            {"method": METHOD, "scan": asked.scan, "precision": asked.precision, "patience": PATIENCE}
        ),
        "Conventions": "CF-1.11",
    }
    dataset = xr.Dataset(variables, {**kept, "sign": ("sign", list(SIGNS), about)}, attributes)
    return dataset if asked.columns else dataset.isel(point=0, drop=True)
