"""The analysis `push`: the smallest push in each state variable after which a machine leaves its working cycle."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float, Shaped

from vibrojax.errors import InputError, Place, shown
from vibrojax.io.attributes import flags, parameters_of, run_of
from vibrojax.io.variables import Variable, orbit_name
from vibrojax.lanes.inputs import Index
from vibrojax.lanes.labels import variables_of
from vibrojax.maps.dataset import coordinates
from vibrojax.maps.machines import Machines
from vibrojax.maps.read import read_sweep
from vibrojax.maps.run import run_sweep
from vibrojax.maps.starts import VECTOR
from vibrojax.maps.sweep import Sweep
from vibrojax.measures.labels import EQUILIBRIUM, IRREGULAR, UNDECIDED
from vibrojax.periodic.lane_stages import plan_of, run_lanes
from vibrojax.periodic.orbit_stages import why_no_orbit
from vibrojax.periodic.orbits import Orbits, orbits_of
from vibrojax.physics.parameters import positive
from vibrojax.pictures.axes import axis, margins, number, quantity_text, scale, symbol, values_along, with_unit
from vibrojax.pictures.colours import REGIME_COLOURS, regime_cells, regime_names
from vibrojax.pictures.contents import POINT, varied
from vibrojax.pictures.plots import Axis, Bars, Key, Layer, Line, Look, Plot, Sheet, Text, dots, key, level, patch
from vibrojax.pictures.starts import SYMBOLS
from vibrojax.progress import Progress
from vibrojax.scenes import Scene
from vibrojax.settings.fields import setting
from vibrojax.settings.names import known_options
from vibrojax.settings.values import as_table, known_keys, quantity
from vibrojax.studies.analysis import PictureRule, SummaryPart
from vibrojax.studies.subjects import MachineAnalysis, answered

_PUSH = "push_"
_SIDES = {-1: ("#0072B2", "v", "negative push"), 1: ("#D55E00", "^", "positive push")}
_RETURNS: Look = {"edge": "#B3B3B3"}  # every push tried returns
_PALE = "#F2F2F2"
_BOUND: Look = {"colour": "#808080", "dash": "--", "width": 0.9}
_MOTION = "motion"
"""Dimension of the explorer page: the motion on the working cycle, and after the smallest push in each state."""


def smallest_pushes(ds: xr.Dataset) -> Sheet:
    """Draw the smallest push in each state variable, with a panel for each variable.

    Several machines are drawn as curves over their parameter, and one machine as a bar, for each sign of the push.
    """
    if POINT in ds.dims and ds.sizes[POINT] == 1:
        ds = ds.isel({POINT: 0})
    states, several = _pushed(ds), POINT in ds.dims
    along = sorted((counts := varied(ds)), key=lambda name: -counts[name]) or [POINT]  # that of most values first
    plots = [_curves(ds, state, along) if several else _sides(ds, state) for state in states]
    known = [ds[f"bound_{state}"] > 0 for state in states]
    returning = any(bool((ds[f"{_PUSH}{s}"].isnull() & k).any()) for s, k in zip(states, known, strict=True))
    leaving = any(bool(ds[f"{_PUSH}{state}"].notnull().any()) for state in states)
    keys: list[Key] = [key(side, colour=c, marker=m, width=1.0) for c, m, side in _SIDES.values() if several]
    if not several:
        names = regime_names(ds["regime"])
        ends = {int(flag) for state in states for flag in regime_cells(ds[f"regime_{state}"]) if flag > 0}
        keys += [patch(REGIME_COLOURS[flag], names[flag]) for flag in sorted(ends)]
    if returning:
        hollow = dots(label="every push tried returns", marker=_SIDES[1][1], face="none")  # of either side
        keys.append(hollow if several else patch(_PALE, hollow.label, **_RETURNS))
    keys.append(key("greatest push tried", **_BOUND))
    none_leaves = "No push up to the greatest tried leaves the working cycle"
    each = f"One line for each value of {', '.join(symbol(ds[name]) for name in along[1:])}" * (len(along) > 1)
    about = margins(ds, none_leaves if returning and not (leaving or several) else "", each)
    placed = [replace(plot, place=divmod(k, 2)) for k, plot in enumerate(plots)]
    return Sheet(placed, (8.6, 2.3 * -(-len(states) // 2) + 0.6), keys=[keys], **about)


def _curves(ds: xr.Dataset, state: str, along: list[str]) -> Plot:
    """Draw the smallest pushes of machines over the first parameter, in a line for each value of the others."""
    (factor, unit), (over, *others) = scale(ds[f"bound_{state}"]), along
    x = values_along(ds[over]) if over in ds.coords else np.arange(ds.sizes[POINT], dtype=float)
    order = np.lexsort((x, *(ds[name].values for name in others)))
    ends = 1 + np.flatnonzero(np.diff(x[order]) < 0)  # of the lines
    pushes = factor * np.stack([ds[f"bound_{state}"], *(ds[f"{_PUSH}{state}"].sel(sign=sign) for sign in _SIDES)])
    x, bound, *both = np.insert(np.vstack([x, pushes])[:, order], ends, np.nan, axis=1)
    layers: list[Layer] = []
    for y, (sign, (colour, marker, _)) in zip(both, _SIDES.items(), strict=True):
        stays = np.isnan(y) & (bound > 0)
        layers.append(Line(x, y, colour, 1.0, marker=marker))
        layers.append(dots(x[stays], bound[stays], colour=colour, marker=marker, size=5.0 + sign, face="none"))
    layers.append(Line(x, bound, **_BOUND))
    top = 1.12 * float(np.nanmax(pushes))
    across = axis(ds[over], group="over") if over in ds.coords else Axis("machine", group="over")
    up = Axis(with_unit(f"push in {SYMBOLS.get(state, state)}", unit), limits=(-0.03 * top, top or 1.0))
    return Plot(layers, across, up, at={_MOTION: _after(state)})


def _sides(ds: xr.Dataset, state: str) -> Plot:
    """Draw the smallest push of one machine as a bar for each sign, in the colour of the regime that follows."""
    (factor, unit), push = scale(ds[f"bound_{state}"]), ds[f"{_PUSH}{state}"]
    bound = float(ds[f"bound_{state}"].values * factor)
    stable = bound > 0
    layers: list[Layer] = [level(bound, **_BOUND)] if stable else []
    for side, (size, flag) in enumerate(zip(push.values * factor, regime_cells(ds[f"regime_{state}"]), strict=True)):
        leaves = bool(np.isfinite(size))
        height = float(size) if leaves else bound if stable else 0.0
        look: Look = {"edge": "#595959"} if leaves else _RETURNS
        fill = REGIME_COLOURS[int(flag)] if leaves else _PALE
        layers.append(Bars([side - 0.3], [0.0], [0.6], [height], fill, **look))
        if leaves or not stable:
            text = number(float(f"{size:.3g}")) if leaves else "no stable\ncycle"
            layers.append(Text(float(side), height, text, baseline="bottom", halo=1.5, offset=(0.0, 3.0)))
    ticks = [(float(k), _SIDES[int(sign)][2].removesuffix(" push")) for k, sign in enumerate(ds["sign"].values)]
    top = 1.13 * float(np.nanmax([bound, *(push.values * factor)]))
    label = with_unit(f"push in {SYMBOLS.get(state, state)}", unit)
    size_axis = Axis(label, limits=(0.0, top or 1.0), ticks=None if stable else [])
    across = Axis("push", "sign", ticks=ticks, limits=(-0.6, len(push) - 0.4), group="over")
    return Plot(layers, across, size_axis, at={_MOTION: _after(state)})


def _after(state: str) -> str:
    return f"after the push in {SYMBOLS.get(state, state)}"


SCAN, PRECISION = 256, 1e-3  # default number of pushes per scan, and default relative width of the final bracket

MAX_SCANS = 5  # each scan covers the range below the smallest push that the previous scan found
BRACKET_PIECES, BRACKET_ROUNDS = 32, 4  # into which a bracket is divided in each round, and most rounds
PATIENCE = 6.0  # times the settling time for irregular motions, because they may still return to the cycle
SIGNS = (-1, 1)

METHOD = (
    "The state of the working cycle is pushed at the section. In each direction, a scan divides the range up to the "
    "bound evenly; further scans divide the range below the smallest push that leaves, until none is smaller. The "
    "interval between this push and the greatest push below it that returns is then divided until it is narrow. "
    "Irregular motions are simulated patience times as long. A scan misses holes of a basin that are narrower than "
    "its steps."
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
    variable, in either direction, when the cycle crosses the section (the bit overtakes the drive). After a push, the
    motion settles for `settle` seconds and is observed for `observe` seconds.

    **Arguments:**

    - `scene`: a scene with a drill, or its name; `parameters`: parameters of the scene (SI), as in `simulate`.
      Parameters that are sequences of equal length define several machines, along the dimension `point`.
    - `start`: initial condition of the motion that settles on the working cycle, by default the scene's first initial
      condition.
    - `most`: greatest push in each state variable, by name (x1, x2 [m], v1, v2 [m/s]). The default for a position is
      its peak-to-peak range over the cycle, and the default for a velocity is this range times 2 pi/period.
    - `scan`: number of pushes per scan and direction; `precision`: relative width to which the bracket is narrowed.
    - `settle` [s]: settling time; `observe` [s]: duration of the observation; by default as in a sweep of the scene.

    **Returns:** a dataset.

    - Variables of each state variable, such as v2, along `sign`, the direction of the push (-1 or 1). `push_v2` is the
      smallest push after which the motion leaves the cycle; it is NaN if the motion returns after all pushes up to
      `bound_v2`. `bracket_v2` is the distance of this push from the next smaller push, after which the motion returns.
      `regime_v2` is the regime in which the motion ends after the push.
    - Variables of the working cycle: `regime`, `period` and the state at the section (`orbit_x1` and so on).

    **Raises:** `InputError` for an invalid name or value, or if the motion does not settle on a stable cycle.

    **Example:**

    >>> point = {"beta": 0.4, "gamma": 0.75, "delta": 0.005, "start": "stuck"}
    >>> pushed = vj.smallest_push("vibro-impact", **point, progress=False)
    >>> f"{1e3 * float(pushed.push_x1.sel(sign=1)):.0f} mm"  # of the bit at the section; it ends in another motion
    '48 mm'
    """
    run = {"start": start, "settle": settle, "observe": observe}
    return answered(Pushes, scene, run | {"most": most, "scan": scan, "precision": precision}, parameters, progress)


_MOST = "most_"


@dataclass(frozen=True, kw_only=True)
class Pushes(MachineAnalysis[Machines]):
    """Find the smallest push in each state variable after which a machine no longer returns to its working cycle."""

    kind = "push"
    pictures = (PictureRule("pushes", lambda held: True, smallest_pushes),)
    always = {"orbits": True}  # noqa: RUF012
    file = "SCENE-push.nc, SCENE-push-2.nc, ..."
    scenes = "rotary, vibro-impact or drilling"

    scan: int = setting(SCAN, "number of pushes per scan and direction", least=2, most=10_000)
    precision: float = setting(PRECISION, "relative width of the final bracket", above=0.0)
    most: Mapping[str, Any] = setting(
        dict, "bounds of the pushes, m or m/s: most_x1, most_v1, most_x2, most_v2", read=as_table
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
        if system.driving_part().section is None or missing or machines.sweep.starts is None:
            why = f"{', '.join(missing)} of it cannot be given as a start" if missing else "it has no drill"
            raise place.at("scene").error(f"{shown(machines.sweep.scene)} has no working cycle to push: {why}")
        known_keys(place.at("most"), dict(self.most), system.start_states)
        for name, value in self.most.items():
            quantity(place.at("most").at(name), value, positive(name, 1.0, "1", "greatest push", name))
        return machines

    def compute(self, spec: Machines, progress: bool = True) -> xr.Dataset:
        sweep = spec.sweep
        cycle = run_sweep(sweep, progress=progress)
        cycle = cycle.isel(start=0, drop=True) if "start" in cycle.dims else cycle
        cycle = cycle if "point" in cycle.dims else cycle.expand_dims("point")
        stable = np.flatnonzero(cycle["stable"].values == 1)
        if not len(stable):
            why = why_no_orbit(cycle.isel(point=0))
            raise spec.place.error(f"the motion {why}: no cycle to push; give another start or point")
        scene, system = sweep.system.driving_part(), sweep.system
        orbits = orbits_of(scene, cycle, sweep.lane_values(0, sweep.lanes)[0], stable)
        section = {name: cycle[orbit_name(name)].values[stable] for name in scene.return_states}
        begin = np.stack([section.get(name, np.zeros(len(stable))) for name in system.start_states], axis=1)
        bound = self._bounds(system, cycle.isel(point=stable))

        # A direction is a state variable and a sign; `high`: smallest leaving push found, NaN if there is none.
        # `low`: greatest push below it after which the motion is known to return; `regime`: where `high` leads.
        top = np.repeat(bound[..., None], len(SIGNS), axis=2)
        low, high, regime = np.zeros_like(top), np.full_like(top, np.nan), np.zeros(top.shape, int)

        def narrow(pushes: Float[np.ndarray, "points states signs pushes"], mask: np.ndarray) -> None:
            if not mask.any():
                return
            tried = pushes[mask]
            point, state, side = np.repeat(np.argwhere(mask), pushes.shape[-1], axis=0).T
            states = begin[point]
            states[np.arange(len(point)), state] += np.array(SIGNS)[side] * tried.ravel()
            outcomes = _outcomes(sweep, orbits, stable[point], states, 1.0, progress)
            unclear = np.flatnonzero(outcomes[1] & (outcomes[2] == IRREGULAR))
            if len(unclear):
                later = _outcomes(sweep, orbits, stable[point[unclear]], states[unclear], PATIENCE, progress)
                for whole, part in zip(outcomes, later, strict=True):
                    whole[unclear] = part
            returned, leaving, ends = (x.reshape(tried.shape) for x in outcomes)
            first, leaves = np.argmax(leaving, axis=1)[:, None], leaving.any(axis=1)
            high[mask] = np.where(leaves, np.take_along_axis(tried, first, axis=1)[:, 0], high[mask])
            regime[mask] = np.where(leaves, np.take_along_axis(ends, first, axis=1)[:, 0], regime[mask])
            limit = np.where(np.isnan(high), np.inf, high)[mask]
            below = np.max(np.where(returned & (tried < limit[:, None]), tried, 0.0), axis=1)
            low[mask] = np.maximum(np.where(low[mask] < limit, low[mask], 0.0), below)

        mask = np.ones(top.shape, bool)
        for _ in range(MAX_SCANS):
            before = high.copy()
            narrow(top[..., None] * (np.arange(1, self.scan + 1) / self.scan), mask)
            top, mask = high, high < np.where(np.isnan(before), np.inf, before)
        for _ in range(BRACKET_ROUNDS):
            mask = high - low > self.precision * high  # False for NaN
            narrow(low[..., None] + (high - low)[..., None] * (np.arange(1, BRACKET_PIECES) / BRACKET_PIECES), mask)
        found = {_PUSH: high, "bracket_": high - low, "bound_": bound, "regime_": regime}
        return self._dataset(spec, cycle, stable, found)

    def _dataset(
        self, spec: Machines, cycle: xr.Dataset, stable: Index, found: Mapping[str, Shaped[np.ndarray, "stable ..."]]
    ) -> xr.Dataset:
        """Return the dataset of pushes; points without a stable cycle have NaN, and 0 as regime after the push."""
        sweep, system = spec.sweep, spec.sweep.system
        variables: dict[str, Any] = {}
        for k, name in enumerate(system.start_states):
            state = system.states[system.place(name)]
            push = f"push in the {state.long_name}, at the section"
            leaves, returns = "after which the motion leaves the working cycle", "after which the motion returns"
            ends_in = f"regime in which the motion ends after the smallest {push}"
            for part, about in {
                _PUSH: Variable(state.unit, f"smallest {push}, {leaves}"),
                "bracket_": Variable(state.unit, f"distance to the next smaller {push}, {returns}"),
                "bound_": Variable(state.unit, f"greatest tried {push}"),
                "regime_": replace(variables_of(system)["regime"], long_name=ends_in),
            }.items():
                x = found[part][:, k]
                whole = np.full((cycle.sizes["point"], *x.shape[1:]), 0 if part == "regime_" else np.nan)
                whole[stable] = x
                variables[part + name] = about.entry(("point", "sign")[: x.ndim], whole)
        own = ["regime", "period", *map(orbit_name, system.driving_part().return_states)]
        variables |= {name: ("point", cycle[name].values, cycle[name].attrs) for name in own}
        coordinates = {name: x for name, x in cycle.coords.items() if x.dims == ("point",)}
        sign = ("sign", list(SIGNS), {"units": "1", "long_name": "sign of the push"})
        settings = {"method": METHOD, "scan": self.scan, "precision": self.precision, "patience": PATIENCE}
        stated: dict[str, Any] = {"run": cycle.attrs["run"], "pushes": json.dumps(settings)}
        stated["start"] = json.dumps(sweep.starts[0]) if sweep.starts is not None else ""
        title = f"Smallest pushes out of the working cycle: {sweep.scene}"
        dataset = self.dataset(variables, {**coordinates, "sign": sign}, of=sweep, title=title, **stated)
        return dataset if spec.several else dataset.isel(point=0, drop=True)

    def _bounds(self, system: Scene[Any], cycle: xr.Dataset) -> Float[np.ndarray, "points states"]:
        section = system.driving_part().section
        assert section is not None
        bounds: dict[str, np.ndarray] = {}
        for swing in section.swings:
            bounds[swing.position] = 2 * cycle[swing.amplitude].values
            if swing.velocity is not None:
                bounds[swing.velocity] = bounds[swing.position] * 2 * np.pi / cycle["period"].values
        bounds |= {name: np.full(cycle.sizes["point"], x) for name, x in self.most.items()}
        return np.stack([bounds[name] for name in system.start_states], axis=1)

    def page_cells(self, ds: xr.Dataset) -> tuple[xr.Dataset, Sweep] | None:
        """Return the machines with the number of the lane of each motion, and the sweep of these lanes.

        Motions are those on the working cycle and after the smallest push in each state variable; if every push
        returns, that is the working cycle.
        """
        states, over = _pushed(ds), (POINT, "sign", _MOTION)
        machines = (ds if POINT in ds.dims else ds.expand_dims(POINT)).transpose(POINT, "sign", ...)
        count, names = machines.sizes[POINT], [orbit_name(name) for name in states]
        cycle = np.stack([machines[x].values if x in ds else np.zeros(count) for x in names], axis=-1)
        pushes, ends = (np.stack([machines[part + x].values for x in states], -1) for part in (_PUSH, "regime_"))
        pushes = np.nan_to_num(pushes * machines["sign"].values[:, None])[..., None] * np.eye(len(states))
        begin = cycle[:, None, None] + np.pad(pushes, [(0, 0), (0, 0), (1, 0), (0, 0)])
        ends = np.pad(ends, [(0, 0), (0, 0), (1, 0)])
        regime = np.where(ends > 0, ends, machines["regime"].values[:, None, None])
        machine = np.broadcast_to(np.arange(count)[:, None, None], regime.shape)
        known, number = np.isfinite(begin).all(axis=-1), np.full(regime.shape, -1, np.int32)
        lanes, index = np.unique(np.column_stack([machine[known], begin[known]]), axis=0, return_inverse=True)
        number[known] = index.ravel()
        columns = {str(name): x.values for name, x in machines.coords.items() if x.dims == (POINT,) and name != POINT}
        points = {name: x[lanes[:, 0].astype(int)].tolist() for name, x in columns.items()}
        points |= {VECTOR + name: x.tolist() for name, x in zip(states, lanes.T[1:], strict=True)}
        fixed = parameters_of(ds) | {name: ds.attrs[name] for name in known_options() if name in ds.attrs}
        run = {name: x for name, x in run_of(ds).items() if name in self.run_settings}
        scene = str(ds.attrs.get("scene", ""))
        try:
            sweep = read_sweep({"scene": scene, "parameters": fixed, "points": points, "run": run, "unusual": True})
        except InputError:  # a system without a name
            return None
        held: dict[str, Any] = {"regime": (over, regime, ds["regime"].attrs), "lane_number": (over, number)}
        held["period"] = machines["period"].assign_attrs(long_name="period of the working cycle")
        for name, x in zip(states, np.moveaxis(begin, -1, 0), strict=True):
            held[VECTOR + name] = over, x, coordinates(sweep, {})[VECTOR + name][2]
        shown = machines.assign(held).assign_coords({_MOTION: ["on the working cycle", *map(_after, states)]})
        return (shown if POINT in ds.dims else shown.isel({POINT: 0}, drop=True)), sweep

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        """Return the working cycle of each machine, and a line for each state variable and sign of the push.

        The line contains the smallest push and the regime in which the motion then ends.
        """
        machines = ds if "point" in ds.dims else ds.expand_dims("point")
        named = [name for name, data in machines.coords.items() if data.dims == ("point",) and name != "point"]
        meanings, lines = flags(ds["regime"]), []
        for index in range(machines.sizes["point"]):
            machine = machines.isel(point=index)
            values = [f"{name} = {machine[name].item():g}" for name in named if machine[name].dtype.kind == "f"]
            lines += [f"{', '.join(values)}:"] if values else []
            regime = meanings[int(machine["regime"])]
            if not float(machine[f"bound_{_pushed(machine)[0]}"]) > 0:
                lines.append(f"no stable cycle ({regime})")
                continue
            lines.append(f"working cycle: {regime}, {float(machine['period']):.5g} s")
            for state in _pushed(machine):
                push, bracket, ends = (machine[f"{part}_{state}"].values for part in ("push", "bracket", "regime"))
                bound = machine[f"bound_{state}"]
                for k, sign in enumerate("-+"):
                    text = f"{quantity_text(push[k], bound, 4)} (within {quantity_text(bracket[k], bound, 1)})"
                    text += f": {meanings.get(int(ends[k]))}"
                    if np.isnan(push[k]):
                        text = f"none up to {quantity_text(float(bound), bound, 4)} leaves it"
                    lines.append(f"  {SYMBOLS.get(state, state)} {sign}  {text}")
        return [SummaryPart("pushes", lines)]


def _outcomes(
    sweep: Sweep, orbits: list[Orbits], lanes: Index, begin: np.ndarray, factor: float, progress: bool
) -> tuple[np.ndarray, ...]:
    """Simulate motions of lanes from the states `begin`, with settling times multiplied by `factor`.

    **Returns:** for each motion, whether it returns to its cycle, whether it leaves the cycle, and its regime.
    """
    run = replace(sweep.run, settle=factor * sweep.run.settle)
    start = np.zeros(len(lanes), int)
    inputs = replace(sweep.inputs_of(lanes), run=run, start=start, start_names=(), states=tuple(begin.T))
    plan = plan_of(inputs.scene, run, len(lanes), len(lanes) / len(np.unique(lanes)))
    with Progress(len(lanes), "lanes", progress) as bar:
        found = run_lanes(inputs, plan, bar.add).variables
    names = map(orbit_name, sweep.system.driving_part().return_states)
    states, regime = np.stack([found[name] for name in names], axis=1), found["regime"].astype(int)
    returned = np.zeros(len(lanes), bool)
    for cycle in orbits:
        number = np.searchsorted(cycle.lane, lanes).clip(max=len(cycle) - 1)
        own = (cycle.lane[number] == lanes) & (found["orbit_cycles"] == cycle.states.shape[1])
        returned[own] = cycle.of(number[own]).contain(states[own])
    on_another = np.isfinite(states).all(axis=1) & (found["stable"] != 0) & (regime != UNDECIDED)
    # An irregular motion near an orbit may still converge to this orbit: it has neither returned nor left.
    irregular = (regime == IRREGULAR) & (found["nearby_cycles"] == 0)
    return returned, ~returned & (on_another | irregular | (regime == EQUILIBRIUM)), regime


def _pushed(ds: xr.Dataset) -> list[str]:
    return [str(name).removeprefix(_PUSH) for name in ds.data_vars if str(name).startswith(_PUSH)]
