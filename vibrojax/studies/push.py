"""The analysis `push`: the smallest push in each state variable after which a machine leaves its working cycle."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from vibrojax.errors import Place, shown, suggestion
from vibrojax.io.attributes import flags
from vibrojax.io.variables import VARIABLES, orbit_name
from vibrojax.maps.dataset import shared_attributes
from vibrojax.maps.machines import Machines
from vibrojax.maps.run import run_sweep
from vibrojax.measures.labels import EQUILIBRIUM, IRREGULAR, UNDECIDED
from vibrojax.periodic.lane_stages import plan_of, run_lanes
from vibrojax.periodic.orbit_stages import why_no_orbit
from vibrojax.periodic.orbits import Orbits, orbits_of
from vibrojax.physics.parameters import positive
from vibrojax.progress import Progress
from vibrojax.scenes import Scene
from vibrojax.settings.fields import setting
from vibrojax.settings.values import as_table, quantity
from vibrojax.studies.analysis import PictureRule, SummaryPart
from vibrojax.studies.push_analysis import smallest_pushes
from vibrojax.studies.subjects import MachineAnalysis, answered

SCAN, PRECISION = 256, 1e-3
"""Default number of pushes per scan, and default relative width of the final bracket."""

MAX_SCANS = 5
"""Largest number of scans; each scan covers the range below the smallest push that the previous scan found."""

BRACKET_PIECES, BRACKET_ROUNDS = 32, 4
"""Number of pieces into which a bracket is divided in each round, and largest number of rounds."""

PATIENCE = 6.0
"""Factor by which the settling time of irregular motions is extended, because they may still return to the cycle."""

SIGNS = (-1, 1)

METHOD = (
    "pushes at the section of the working cycle, scan of them in each direction evenly up to the bound, then as many "
    "below the smallest that leaves, until nothing smaller is found; between that and the greatest returning push "
    "below it, the same until the bracket is narrow. Motions that are then irregular are run patience times as long. "
    "Basins have holes: a hole narrower than the steps of the scans is missed"
)


def smallest_push(
    scene: str | Scene[Any],
    *,
    start: str | Sequence[float] | None = None,
    most: Mapping[str, float] | None = None,
    scan: int = SCAN,
    precision: float = PRECISION,
    settle: float | None = None,
    observe: float | None = None,
    progress: bool = True,
    **parameters: Any,
) -> xr.Dataset:
    """Find the smallest push in each state variable after which a machine no longer returns to its working cycle.

        push = vj.smallest_push("vibro-impact", beta=0.4, gamma=0.75, delta=0.005, start="stuck")
        push.push_v2.sel(sign=1)  # m/s that are added to the striker's velocity

    The working cycle is the periodic orbit on which the motion settles. A push is a sudden change of one state
    variable, in either direction, when the cycle crosses its section (the bit overtakes the drive). The motion then
    settles for the time `settle`, six times as long if it is irregular, and is observed for the time `observe`. A push
    after which the motion does not return to the cycle is called leaving.

    A first scan tries pushes up to a bound. Further scans below the smallest leaving push follow, until they find no
    smaller one. The bracket of this push is then narrowed. Basins of attraction have holes, and a hole narrower than
    the spacing of the scans is missed. The result is therefore the smallest leaving push that was found.

    **Arguments:**

    - `scene`: name of a scene, or a scene, with a drill; `parameters`: any of its parameters (SI), as in `simulate`.
      Sequences of equal length define several working cycles along the dimension `point`, pushed in one batch.
    - `start`: initial condition of the motion that settles on the cycle, by default the scene's first.
    - `most`: greatest push in each state variable, by name (x1, x2 [m], v1, v2 [m/s]). By default it is the
      peak-to-peak range of a position over the cycle, and for a velocity that of its position times 2 pi/period.
    - `scan`: number of pushes per scan and direction; `precision`: relative width of the final bracket.
    - `settle` [s]: settling time; `observe` [s]: duration of the observation; by default as in a sweep of the scene.
    - `progress`: True to report progress on stderr.

    **Returns:** a dataset.

    - Along `sign` (-1, 1), for each state variable (here v2): `push_v2` is the smallest leaving push that was found,
      NaN if no push up to `bound_v2` leaves. `bracket_v2` is its distance from the next smaller push after which the
      motion is known to return to the cycle. `regime_v2` is the regime in which the motion ends after the push.
    - `regime`, `period` and the state at the section (`orbit_x1` and so on) of the working cycle.

    **Raises:** `InputError` for an invalid name or value, or if there is no stable cycle.

    **Example:**

    >>> point = {"beta": 0.4, "gamma": 0.75, "delta": 0.005, "start": "stuck"}
    >>> pushed = vj.smallest_push("vibro-impact", **point, progress=False)
    >>> f"{1e3 * float(pushed.push_x1.sel(sign=1)):.0f} mm"  # of the bit at the section; it ends in another motion
    '48 mm'
    """
    settings = {"most": most, "scan": scan, "precision": precision}
    return answered(
        Pushes, scene, settings | {"start": start, "settle": settle, "observe": observe}, parameters, progress
    )


_MOST = "most_"


@dataclass(frozen=True, kw_only=True)
class Pushes(MachineAnalysis[Machines]):
    """Find the smallest push in each state variable after which a machine no longer returns to its working cycle."""

    kind = "push"
    pictures = (PictureRule("pushes", lambda held: True, smallest_pushes),)
    always = {"orbits": True}  # noqa: RUF012
    file, numbered = "SCENE-push.nc, SCENE-push-2.nc, ...", True
    scenes = "rotary, vibro-impact or drilling"

    scan: int = setting(SCAN, "pushes of each scan in a direction", least=2, most=10_000)
    precision: float = setting(PRECISION, "relative width of the final bracket", above=0.0)
    most: Mapping[str, Any] = setting(
        dict, "greatest push, m or m/s, as most_x1, most_v1, most_x2, most_v2", read=as_table
    )

    @classmethod
    def words(cls) -> tuple[str, ...]:
        return (*super().words(), *(_MOST + name for name in ("x1", "v1", "x2", "v2")))

    @classmethod
    def of_words(cls, values: dict[str, Any]) -> dict[str, Any]:
        most = {name.removeprefix(_MOST): values.pop(name) for name in list(values) if name.startswith(_MOST)}
        return values | ({"most": most} if most else {})

    def machines(
        self, place: Place, scene: object, parameters: Mapping[str, object], start: object, run: Mapping[str, object]
    ) -> Machines:
        machines = super().machines(place, scene, parameters, start, run)
        system = machines.sweep.system
        missing = [name for name in system.driving_part().return_states if name not in system.start_states]
        if system.driving_part().section is None or missing or machines.first.start is None:
            why = f"{', '.join(missing)} of it cannot be given as a start" if missing else "it has no drill"
            raise place.at("scene").error(f"{shown(machines.sweep.scene)} has no working cycle to push: {why}")
        for name, value in self.most.items():
            if name not in system.start_states:
                hint = suggestion(name, system.start_states)
                raise place.at("most").error(f"{shown(name)} is no state of a start; {hint}")
            quantity(place.at("most").at(name), value, positive(name, 1.0, "1", "greatest push", name))
        return machines

    def compute(self, asked: Machines, progress: bool = True) -> xr.Dataset:
        """Return the smallest pushes; raise `InputError` if there is no stable cycle to push."""
        sweep = asked.sweep
        cycle = run_sweep(sweep, progress=progress)
        cycle = cycle.isel(start=0, drop=True) if "start" in cycle.dims else cycle
        cycle = cycle if "point" in cycle.dims else cycle.expand_dims("point")
        stable = np.flatnonzero(cycle["stable"].values == 1)
        if not len(stable):
            why = why_no_orbit(cycle.isel(point=0))
            raise asked.place.error(f"the motion {why}: no cycle to push; give another start or point")
        scene, values = sweep.system.driving_part(), sweep.lane_values(0, sweep.lanes)[0]
        section = {name: cycle[orbit_name(name)].values[stable] for name in scene.return_states}
        begin = np.stack([section.get(name, np.zeros(len(stable))) for name in sweep.system.start_states], axis=1)
        bound = self._bounds(sweep.system, cycle.isel(point=stable))
        orbits = orbits_of(scene, cycle, values, stable)
        search = _Search(self, asked, stable, orbits, begin, bound, progress)
        search.run()
        return _dataset(self, asked, cycle, stable, search)

    def _bounds(self, system: Scene[Any], cycle: xr.Dataset) -> Float[np.ndarray, "points states"]:
        """Return the greatest push to be tried in each state variable."""
        section = system.driving_part().section
        assert section is not None
        bounds: dict[str, np.ndarray] = {}
        for swing in section.swings:
            bounds[swing.position] = 2 * cycle[swing.amplitude].values
            if swing.velocity is not None:
                bounds[swing.velocity] = bounds[swing.position] * 2 * np.pi / cycle["period"].values
        bounds |= {name: np.full(cycle.sizes["point"], x) for name, x in self.most.items()}
        return np.stack([bounds[name] for name in system.start_states], axis=1)

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        """Return a line for each machine, state variable and sign of the push."""
        return [SummaryPart("pushes", push_lines(ds))]


class _Search:
    """Search for the smallest leaving pushes of stable cycles. Directions are pairs of state variable and sign.

    - `points`: indices of the points with a stable cycle; `orbits`: the cycles.
    - `begin` (points, states): state of the cycle at the section; `bound`: greatest push that is tried in each state.
    - `low`: greatest push below `high` after which the motion is known to return to the cycle.
    - `high`: smallest leaving push found, NaN if none was found.
    - `regime`: regime in which the motion ends after the push `high`, 0 if none was found.
    """

    def __init__(
        self,
        settings: Pushes,
        machines: Machines,
        points: Int[np.ndarray, " points"],
        orbits: list[Orbits],
        begin: Float[np.ndarray, "points states"],
        bound: Float[np.ndarray, "points states"],
        progress: bool,
    ) -> None:
        self._settings, self._sweep, self._progress = settings, machines.sweep, progress
        self._points, self._orbits, self._begin = points, orbits, begin
        self.bound, self._bounds = bound, np.repeat(bound, len(SIGNS), axis=1)
        self.low, self.high = np.zeros_like(self._bounds), np.full_like(self._bounds, np.nan)
        self.regime = np.zeros(self._bounds.shape, int)

    def run(self) -> None:
        scan = np.arange(1, self._settings.scan + 1) / self._settings.scan
        top, mask = self._bounds, np.ones(self._bounds.shape, bool)
        for _ in range(MAX_SCANS):
            before = self.high.copy()
            self._narrow(top[..., None] * scan, mask)
            top, mask = self.high, self.high < np.where(np.isnan(before), np.inf, before)
            if not mask.any():
                break
        share = np.arange(1, BRACKET_PIECES) / BRACKET_PIECES
        for _ in range(BRACKET_ROUNDS):
            mask = self.high - self.low > self._settings.precision * self.high  # False for NaN
            if not mask.any():
                break
            self._narrow(self.low[..., None] + (self.high - self.low)[..., None] * share, mask)

    def _narrow(self, pushes: Float[np.ndarray, "points directions pushes"], mask: np.ndarray) -> None:
        """Update the brackets with the results of `pushes` in the directions selected by `mask`."""
        tried, count = pushes[mask], pushes.shape[-1]
        point, direction = np.repeat(np.argwhere(mask), count, axis=0).T
        begin = self._begin[point]
        begin[np.arange(len(point)), direction // len(SIGNS)] += np.array(SIGNS)[direction % 2] * tried.ravel()
        outcomes = self._simulate(point, begin, 1.0)
        unclear = np.flatnonzero(outcomes[1] & (outcomes[2] == IRREGULAR))
        if len(unclear):
            later = self._simulate(point[unclear], begin[unclear], PATIENCE)
            for whole, part in zip(outcomes, later, strict=True):
                whole[unclear] = part
        returned, leaving, ends = (x.reshape(tried.shape) for x in outcomes)
        first = np.argmax(leaving, axis=1)[:, None]
        leaves = leaving.any(axis=1)
        self.high[mask] = np.where(leaves, np.take_along_axis(tried, first, axis=1)[:, 0], self.high[mask])
        self.regime[mask] = np.where(leaves, np.take_along_axis(ends, first, axis=1)[:, 0], self.regime[mask])
        top = np.where(np.isnan(self.high), np.inf, self.high)[mask]
        below = np.max(np.where(returned & (tried < top[:, None]), tried, 0.0), axis=1)
        self.low[mask] = np.maximum(np.where(self.low[mask] < top, self.low[mask], 0.0), below)

    def _simulate(self, point: np.ndarray, begin: np.ndarray, factor: float) -> tuple[np.ndarray, ...]:
        """Simulate motions of points from the states `begin`, with settling times multiplied by `factor`.

        **Returns:** for each motion, whether it returns to its cycle, whether it leaves the cycle, and its regime.
        """
        sweep = self._sweep
        run = replace(sweep.run, settle=factor * sweep.run.settle)
        inputs = replace(
            sweep.inputs_of(self._points[point]),
            run=run,
            start=np.zeros(len(point), int),
            start_names=(),
            states=tuple(begin.T),
        )
        plan = plan_of(inputs.scene, run, len(point), len(point) / len(np.unique(point)))
        with Progress(len(point), "lanes", self._progress) as bar:
            found = run_lanes(inputs, plan, bar.add).variables
        names = map(orbit_name, sweep.system.driving_part().return_states)
        orbits = np.stack([found[name] for name in names], axis=1)
        regime = found["regime"].astype(int)
        returned = np.zeros(len(point), bool)
        for cycle in self._orbits:
            number = np.searchsorted(cycle.lane, self._points[point]).clip(max=len(cycle) - 1)
            own = (cycle.lane[number] == self._points[point]) & (found["orbit_cycles"] == cycle.states.shape[1])
            returned[own] = cycle.of(number[own]).contain(orbits[own])
        on_another = np.isfinite(orbits).all(axis=1) & (found["stable"] != 0) & (regime != UNDECIDED)
        # An irregular motion near an orbit may still converge to this orbit: it has neither returned nor left.
        irregular = (regime == IRREGULAR) & (found["nearby_cycles"] == 0)
        return returned, ~returned & (on_another | irregular | (regime == EQUILIBRIUM)), regime


def _dataset(
    asked: Pushes, machines: Machines, cycle: xr.Dataset, stable: Int[np.ndarray, " stable"], search: _Search
) -> xr.Dataset:
    """Return the dataset of pushes; points without a stable cycle have NaN, and 0 as regime after the push."""
    sweep, regimes = machines.sweep, VARIABLES["regime"]
    variables: dict[str, Any] = {}

    def add(name: str, x: np.ndarray, long_name: str, about: Mapping[str, Any], fill: float = np.nan) -> None:
        whole = np.full((cycle.sizes["point"], *x.shape[1:]), fill, x.dtype)
        whole[stable] = x
        variables[name] = (("point", "sign")[: x.ndim], whole, {**about, "long_name": long_name})

    for k, name in enumerate(sweep.system.start_states):
        state, pair = sweep.system.states[sweep.system.place(name)], slice(2 * k, 2 * k + 2)
        high, regime = search.high[:, pair], search.regime[:, pair].astype(regimes.dtype)
        push, units = f"push in the {state.long_name}, at the section", {"units": state.unit}
        add(f"push_{name}", high, f"smallest {push}, that leaves the working cycle", units)
        distance = high - search.low[:, pair]
        add(f"bracket_{name}", distance, f"distance to the next smaller {push}, that returns", units)
        add(f"bound_{name}", search.bound[:, k], f"greatest {push}, that was tried", units)
        ends = f"regime in which the motion ends after the smallest {push}"
        add(f"regime_{name}", regime, ends, regimes.attributes(), 0.0)
    own = ["regime", "period", *map(orbit_name, sweep.system.driving_part().return_states)]
    variables |= {name: ("point", cycle[name].values, cycle[name].attrs) for name in own}
    coordinates = {name: x for name, x in cycle.coords.items() if x.dims == ("point",)}
    sign = ("sign", list(SIGNS), {"units": "1", "long_name": "side of the push: -1 less, 1 more"})
    settings = {"method": METHOD, "scan": asked.scan, "precision": asked.precision, "patience": PATIENCE}
    attributes = {
        **shared_attributes(sweep, "push", f"Smallest pushes out of the working cycle: {sweep.scene}", "smallest_push"),
        "start": json.dumps(sweep.starts[0]) if sweep.starts is not None else "",
        "run": cycle.attrs["run"],
        "pushes": json.dumps(settings),
    }
    dataset = xr.Dataset(variables, {**coordinates, "sign": sign}, attributes)
    return dataset if machines.several else dataset.isel(point=0, drop=True)


def push_lines(ds: xr.Dataset) -> list[str]:
    """Return lines of text: the working cycle of each machine, then its smallest pushes.

    The line of each state variable and sign contains the smallest push and the regime in which the motion then ends.
    """
    machines = ds if "point" in ds.dims else ds.expand_dims("point")
    varied = [name for name, data in machines.coords.items() if data.dims == ("point",) and name != "point"]
    meanings = flags(ds["regime"])
    lines = []
    for index in range(machines.sizes["point"]):
        machine = machines.isel(point=index)
        values = [f"{name} = {machine[name].item():g}" for name in varied if machine[name].dtype.kind == "f"]
        lines += [f"{', '.join(values)}:"] if values else []
        regime = meanings[int(machine["regime"])]
        if not float(machine["bound_x1"]) > 0:
            lines.append(f"no stable cycle ({regime})")
            continue
        lines.append(f"working cycle: {regime}, {float(machine['period']):.5g} s")
        states = [str(name).removeprefix("push_") for name in machine.data_vars if str(name).startswith("push_")]
        for state in states:
            push = machine[f"push_{state}"]
            unit = push.attrs["units"].replace(" s-1", "/s")
            for k, sign in enumerate("-+"):
                size, bracket = float(push[k]), float(machine[f"bracket_{state}"][k])
                text = f"none up to {float(machine[f'bound_{state}']):.4g} {unit} leaves it"
                if size == size:
                    regime = meanings[int(machine[f"regime_{state}"][k])]
                    text = f"{size:.4g} {unit} (within {bracket:.1g}): {regime}"
                lines.append(f"  {state} {sign}  {text}")
    return lines
