"""The smallest push in each state after which a machine no longer returns to its working cycle: `smallest_push`."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from vibrojax.coexistence.alike import told_apart
from vibrojax.errors import Place, shown, suggestion
from vibrojax.input.definition import Sweep
from vibrojax.input.point import read_point
from vibrojax.input.points import VECTOR
from vibrojax.input.read import read_sweep
from vibrojax.input.values import quantity
from vibrojax.label import REGIMES
from vibrojax.physics.parameters import differing, positive
from vibrojax.scenes import Scene
from vibrojax.store.provenance import provenance
from vibrojax.store.variables import ORBIT_REASONS, REASONS, VARIABLES, orbit_name
from vibrojax.sweep import run_sweep

SCAN, PRECISION = 64, 1e-3
"""Pushes of a first scan, up to the bound; and the width of the bracket in the end, over the push."""

PIECES, ROUNDS = 32, 4
"""In so many pieces a bracket is cut at once, so many times at most."""

SIGNS = (-1, 1)

METHOD = (
    "pushes at the section of the working cycle, scan of them in each direction evenly up to the bound; between the "
    "first after which the motion ends elsewhere and the last before that which it returns from, the same again until "
    "that bracket is narrow. A basin with a hole narrower than the bound over scan may be left by a smaller push"
)

Pushes = Float[np.ndarray, "points directions pushes"]


@dataclass(frozen=True, eq=False)
class PushAsked:
    """Whose working cycles are pushed: `sweep`, of one motion each; `columns`: what differs between them, by name; and
    as `smallest_push` takes them, `most`, `scan` and `precision`."""

    sweep: Sweep
    tables: dict[str, Any]
    columns: dict[str, list[Any]]
    most: dict[str, float]
    scan: int
    precision: float

    def identity(self) -> dict[str, object]:
        """What the result depends on, as flat JSON values."""
        own = {"scan": self.scan, "precision": self.precision, **{f"most_{name}": x for name, x in self.most.items()}}
        return self.sweep.identity() | own


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
    one state is changed at once, to either side, and the motion goes on for `settle` and `observe`. It is a scan, and
    then a refinement of the first push that leaves: basins may have holes, and one that is narrower than the bound over
    `scan` may be missed.

    **Arguments:**

    - `scene`: a name or a scene with a drill; `parameters`: any of its (SI), as `simulate` takes them. One or several
      may be sequences of one length: as many working cycles, all pushed at once, numbered along `point`.
    - `start`: of the motion whose cycle is pushed, by default the scene's first.
    - `most`: the greatest push in a state, by its name (x1, x2 [m], v1, v2 [m/s]); by default its whole swing over the
      cycle, or of a velocity that over the period times 2 pi.
    - `scan`: pushes of the first scan in each direction; `precision`: the width of the bracket in the end, over the
      push.
    - `settle`, `observe` [s]: for which motions settle and are watched then.
    - `progress`: whether to say on stderr how far it is.

    **Returns:** a dataset. Along `sign` (-1, 1) for each state (here v2): `push_v2`, the smallest push found after
    which the motion ends elsewhere, NaN where there is none up to `bound_v2`; `bracket_v2`: by how much greater it is
    than the next smaller push that is known to return; `regime_v2`: where it ends. Of the working cycle `regime`,
    `period` and the state at the section (`orbit_x1` and so on).

    **Raises:** `InputError` where a name or value is not right, or there is no stable cycle to be pushed out of.
    """
    return push_asked(read_pushed(scene, start, most, scan, precision, settle, observe, parameters), progress)


def read_pushed(
    scene: str | Scene[Any],
    start: object,
    most: object,
    scan: object,
    precision: object,
    settle: object,
    observe: object,
    parameters: Mapping[str, Any],
) -> PushAsked:
    """What is asked for, checked; raises `InputError`, one line, at the first thing that is wrong."""
    place = Place("smallest_push")
    columns = {name: list(x) for name, x in parameters.items() if _is_column(x)}
    fixed = {name: x for name, x in parameters.items() if name not in columns}
    for name, column in columns.items():
        if not column:
            raise place.at(name).error("is empty; give a value")
    point = read_point(place, scene, fixed | {name: column[0] for name, column in columns.items()}, start)
    system = point.system
    lacking = [name for name in system.driving_part().return_states if name not in system.start_states]
    if system.driving_part().section is None or lacking or point.start is None:
        what = f"{', '.join(lacking)} of it cannot be given as a start" if lacking else "it has no drill"
        raise place.at("scene").error(f"{shown(point.scene)} has no working cycle to push: {what}")
    if isinstance(scan, bool) or not isinstance(scan, int) or not 2 <= scan <= 10_000:
        raise place.at("scan").error(f"{shown(scan)} is not a whole number from 2 to 10000")
    within = quantity(place.at("precision"), precision, positive("precision", PRECISION, "1", "precision", "precision"))
    bounds = {}
    for name, value in dict(most if isinstance(most, Mapping) else {}).items():
        if name not in system.start_states:
            raise place.at("most").error(
                f"{shown(name)} is no state of a start; {suggestion(name, system.start_states)}"
            )
        about = positive(name, 1.0, "1", "greatest push", name)
        bounds[name] = quantity(place.at("most").at(name), value, about)
    if most is not None and not isinstance(most, Mapping):
        raise place.at("most").error(f"{shown(most)} is no table; give one like {{'v2': 3.0}}")
    tables: dict[str, Any] = {
        "scene": scene,
        "parameters": fixed,
        "run": {"orbits": True, "settle": settle, "observe": observe},
        "unusual": True,
    }
    start_item = point.start if isinstance(point.start, str) else list(point.start)
    asked = {"starts": [start_item]} | ({"points": columns} if columns else {})
    return PushAsked(read_sweep(tables | asked), tables, columns, bounds, scan, within)


def _is_column(x: object) -> bool:
    return isinstance(x, (list, tuple)) or (isinstance(x, np.ndarray) and x.ndim > 0)


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
    pushed = _Pushed(asked, stable, at, progress)
    low, high, regime = pushed.smallest(np.repeat(bound, len(SIGNS), axis=1))
    return _described(asked, cycle, stable, bound, low, high, regime)


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

    `points`: those that have a cycle, by index; `at` (points, states): where each passes the section.
    """

    def __init__(
        self, asked: PushAsked, points: Int[np.ndarray, " points"], at: Float[np.ndarray, "points states"], shown: bool
    ) -> None:
        self._asked, self._points, self._at, self._shown = asked, points, at, shown

    def smallest(
        self, bound: Float[np.ndarray, "points directions"]
    ) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."], Int[np.ndarray, "..."]]:
        """The greatest push that is known to return below the smallest that leaves; that, NaN where there is none up to
        its `bound`; and the regime that it ends in, 0 there; each (points, directions)."""
        low, high, regime = np.zeros_like(bound), np.full_like(bound, np.nan), np.zeros(bound.shape, int)
        pushes = bound[..., None] * np.arange(1, self._asked.scan + 1) / self._asked.scan
        for _ in range(1 + ROUNDS):
            low, high, regime = _narrowed(pushes, *self._run(pushes), low, high, regime)
            wide = high - low > self._asked.precision * high  # NaN is not
            if not wide.any():
                break
            between = low[..., None] + (high - low)[..., None] * np.arange(1, PIECES) / PIECES
            # Where nothing is left to be narrowed the cycle itself is run again, which ends at once.
            pushes = np.where(wide[..., None], between, 0.0)
        return low, high, regime

    def _run(self, pushes: Pushes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which pushes the cycle is returned to after, which are left by, and the regimes; as `pushes`."""
        points, directions, many = pushes.shape
        begin = np.repeat(self._at[:, None], 1 + directions * many, axis=1)
        for direction in range(directions):
            state, sign = divmod(direction, len(SIGNS))
            begin[:, 1 + direction * many : 1 + (direction + 1) * many, state] += SIGNS[sign] * pushes[:, direction]
        lanes = begin.shape[1]
        columns: dict[str, list[Any]] = {
            name: np.repeat(np.array(x)[self._points], lanes).tolist() for name, x in self._asked.columns.items()
        }
        states = self._asked.sweep.system.start_states
        columns |= {f"{VECTOR}{name}": begin[..., k].ravel().tolist() for k, name in enumerate(states)}
        sweep = read_sweep(self._asked.tables | {"points": columns})
        dataset = run_sweep(sweep, progress=self._shown)
        scene = sweep.system.driving_part()
        values, _ = sweep.lane_values(0, sweep.lanes)
        motions = told_apart(scene, dataset, {name: values[name] for name in scene.parameters()}, lanes)
        ended = motions.of_lane.reshape(points, lanes)
        back = ended == ended[:, :1]
        # What only seems irregular, on its long way to an orbit nearby, is not told yet.
        left = (ended >= 0) & ~back & ~(dataset["nearby_cycles"].values.reshape(points, lanes) > 0)
        regime = dataset["regime"].values.reshape(points, lanes)
        shape = pushes.shape
        return back[:, 1:].reshape(shape), left[:, 1:].reshape(shape), regime[:, 1:].reshape(shape)


def _narrowed(
    pushes: Pushes,
    back: np.ndarray,
    left: np.ndarray,
    regimes: np.ndarray,
    low: Float[np.ndarray, "points directions"],
    high: Float[np.ndarray, "points directions"],
    regime: Int[np.ndarray, "points directions"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The brackets after more pushes: up to the first that leaves, from the last below it that is returned from."""
    some = left.any(axis=2)
    first = np.argmax(left, axis=2)
    high = np.where(some, np.take_along_axis(pushes, first[..., None], axis=2)[..., 0], high)
    regime = np.where(some, np.take_along_axis(regimes, first[..., None], axis=2)[..., 0], regime)
    below = back & (pushes < np.where(np.isnan(high), np.inf, high)[..., None])
    return np.maximum(low, np.max(np.where(below, pushes, 0.0), axis=2)), high, regime


def _described(
    asked: PushAsked,
    cycle: xr.Dataset,
    stable: Int[np.ndarray, " stable"],
    bound: Float[np.ndarray, "stable states"],
    low: Float[np.ndarray, "stable directions"],
    high: Float[np.ndarray, "stable directions"],
    regime: Int[np.ndarray, "stable directions"],
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
        entered(f"push_{name}", high[:, both], units | {"long_name": f"smallest {of}, that leaves the working cycle"})
        width = high[:, both] - low[:, both]
        entered(
            f"bracket_{name}", width, units | {"long_name": f"down to the next smaller {of}, that is returned from"}
        )
        entered(f"bound_{name}", bound[:, k], units | {"long_name": f"greatest {of}, that was tried"})
        flags = VARIABLES["regime"].attributes() | {"long_name": f"where the motion ends after the smallest {of}"}
        entered(f"regime_{name}", regime[:, both].astype(VARIABLES["regime"].dtype), flags, 0)
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
        "pushes": json.dumps({"method": METHOD, "scan": asked.scan, "precision": asked.precision}),
        "Conventions": "CF-1.11",
    }
    found = xr.Dataset(variables, {**kept, "sign": ("sign", list(SIGNS), about)}, attributes)
    return found if asked.columns else found.isel(point=0, drop=True)
