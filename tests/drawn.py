"""Datasets for tests of pictures: sweeps, runs, families and fits that are made up, and how to read their plots."""

import json
from itertools import combinations

import matplotlib
import numpy as np
import xarray as xr

from vibrojax.io.variables import VARIABLES, described
from vibrojax.pictures.branches import MARKS
from vibrojax.pictures.plots import Cells, Line, as_sheet, labelled_layers, legend_of, resolved
from vibrojax.pictures.style import drawable
from vibrojax.scenes import SCENES
from vibrojax.studies.analysis import analysis_of

PARAMETERS = SCENES["penetration"]().parameters() | SCENES["drilling"]().parameters()
UNITS = {"x1": "m", "v1": "m s-1", "x2": "m", "v2": "m s-1"}


def dataset(variables, coords, **attrs):
    """Return a dataset whose variables and axes have the attributes that a sweep gives them."""
    return with_axes(xr.Dataset(described(variables, VARIABLES), attrs=attrs), **coords)


def with_axes(ds, **coords):
    ds = ds.assign_coords(coords)
    for name in PARAMETERS.keys() & ds.coords.keys():
        about = PARAMETERS[name]
        ds[name].attrs = {"units": about.unit, "long_name": about.long_name, "symbol": about.symbol}
    return ds


def lanes(grid, starts=("drive", "stuck"), regime=None):
    """Return a sweep dataset with patches of regimes, impact velocity and period over `grid` and the starts."""
    values = {name: np.asarray(axis, float) for name, axis in grid.items()}
    along = np.meshgrid(*values.values(), np.arange(len(starts)), indexing="ij")
    mesh = dict(zip([*values, "start"], along, strict=True))
    beta, gamma, v = (mesh.get(name, default) for name, default in (("beta", 0.4), ("gamma", 0.75), ("v", 1.5)))
    far = np.hypot((beta - 0.5) / 0.45, (gamma - 0.72) / 0.3) + 25 * mesh.get("delta", -0.005) - 0.3 * mesh["start"]
    ripple = 0.12 * np.sin(17 * beta + 23 * gamma + 2 * v)
    flags = np.digitize(far + ripple, [0.9, 1.3, 1.6, 2.2])
    regimes = np.array([3, 4, 5, 6, 2])[flags] + 0 * mesh["start"]
    regimes = np.where(beta > 1.12 - 0.05 * gamma, 0, regimes) if regime is None else np.full(regimes.shape, regime)
    period = np.where(regimes == 0, np.nan, 0.25 - 0.02 * gamma / (0.5 + beta) + 0 * far)
    velocity = np.where(regimes == 2, np.nan, 1.2 * v + 2.6 * np.exp(-(far**2)) + 0.2 * ripple)
    shown = {"regime": regimes, "impact_velocity": velocity, "period": period}
    dims = (*values, "start")
    return dataset({name: (dims, x) for name, x in shown.items()}, values | {"start": list(starts)}, title="a sweep")


def square(count=9, **further):
    return {"beta": np.linspace(0.1, 1.2, count), "gamma": np.linspace(0.3, 1.2, count), **further}


def points(count=40, also_v=False):
    draw = np.random.default_rng(3)
    ds = lanes({"point": np.arange(count)}, ("drive",)).isel(start=0, drop=True)
    ds["regime"].values[:] = draw.choice([2, 3, 3, 6], count)
    axes = {"beta": draw.uniform(0.1, 1.2, count), "gamma": draw.uniform(0.3, 1.2, count)}
    axes |= {"start": np.array(["drive", "stuck"])[np.arange(count) % 2]}
    axes |= {"v": draw.uniform(0.5, 2, count)} if also_v else {}
    return with_axes(ds, **{name: ("point", values) for name, values in axes.items()})


def returns(grid, keep=24, starts=("drive", "stuck")):
    ds = lanes(grid, starts)
    several = np.random.default_rng(5).standard_normal((*ds["regime"].shape, keep))
    two = np.where(np.arange(keep) % 2, 0.5, -0.5)
    spread = xr.where(ds["regime"] == 6, 0.35, 0.0).values[..., None] * several
    doubled = xr.where(ds["regime"] == 5, 0.4, 0.0).values[..., None] * two
    kept = ds["impact_velocity"].values[..., None] * (1 + 0.3 * (spread + doubled))
    ds["return_impact_velocity"] = ((*ds["regime"].dims, "return_index"), kept, {"units": "m s-1"})
    return ds


def run(duration=12.0, impacts=True, events=True):
    """Return a trajectory at 4.4 Hz in which the bit sticks for a part of each cycle."""
    time = np.arange(0.0, duration, 5e-4)
    turn, growth = 2 * np.pi * 4.4 * time, 1 - 0.6 * np.exp(-time)
    x1, v1 = growth * 0.05 * np.sin(turn), growth * 0.05 * 27.65 * np.cos(turn)
    x2, v2 = growth * 0.03 * np.sin(turn - 0.4) - 0.035, growth * 0.03 * 27.65 * np.cos(turn - 0.4)
    force = np.where(x2 > -0.006, 50e6 * (x2 + 0.006) / 100, 0.0)
    ds = xr.Dataset(coords={"time": ("time", time, {"units": "s"})})
    for (name, units), values in zip(UNITS.items(), (x1, v1, x2, v2), strict=True):
        ds[name] = ("time", values, {"units": units, "long_name": name})
    ds["friction_force"] = ("time", 981 * np.sign(v1 + 1.5), {"units": "N"})
    ds["stuck"] = ("time", (v1 < -1.3).astype(np.int8), {"flag_values": np.arange(2, dtype=np.int8)})
    if impacts:
        ds["impact_force"] = ("time", force, {"units": "N"})
    if impacts and events:
        hits = time[1:][(force[1:] > 0) & (force[:-1] <= 0)]
        meanings = {"flag_values": np.arange(1, 6, dtype=np.int8), "flag_meanings": "stick slip impact release section"}
        ds["event_time"] = ("event", np.concatenate([hits, hits + 1e-3]), {"units": "s"})
        ds["event_kind"] = ("event", np.repeat([3, 4], hits.size).astype(np.int8), meanings)
    scene, gap = ("vibro-impact", {"delta": -0.006}) if impacts else ("rotary", {})
    parameters = json.dumps({"beta": 0.4, "gamma": 0.75, "v": 1.5, **gap})
    return ds.assign_attrs(scene=scene, start="drive", parameters=parameters)


def meshed(grid):
    return dict(zip(grid, np.meshgrid(*grid.values(), indexing="ij"), strict=True)) if grid else {}


def rock(grid, **fixed):
    """Return a penetration sweep with slips that grow from an onset and rates proportional to the frequency."""
    inputs = {"force": 2e5, "frequency": 20.0, "threshold": 15e4, "k3": 3e8, "zeta": 1.1} | fixed | meshed(grid)
    slip = np.maximum(inputs["force"] - 1.1 * inputs["threshold"], 0.0) / inputs["k3"] / inputs["zeta"]
    force = inputs["force"] * 4e-3 * inputs["frequency"]
    shown = {"rate_of_penetration": slip * inputs["frequency"], "relief": force / inputs["threshold"]}
    shown |= {"mean_force": force, "slip_per_impact": slip}
    shape = tuple(len(values) for values in grid.values())
    variables = {name: (tuple(grid), np.broadcast_to(values, shape).copy()) for name, values in shown.items()}
    parameters = json.dumps(fixed | {"pulse_width": 4e-3})
    return dataset(variables, grid, title="a rock", scene="penetration", parameters=parameters)


def law(grid):
    """Return a fit with C proportional to the force. The form "line" is best, except "onset" at the largest force."""
    shape = tuple(len(values) for values in grid.values())
    force = np.broadcast_to(meshed(grid).get("force", np.asarray(2e5)), shape)
    C = np.stack([-1e-7 * force, 5e-8 * force, 1.5e-7 * force, 5e-7 * force, 6e-7 * force], axis=-1)
    aic = np.stack([0 * force - x for x in (80.0, 90.0, 110.0, 300.0, 297.0)], axis=-1)
    aic[force > 2.9e5, 2] = -400.0
    dims, attributes = (*grid, "form"), {"units": "m s-1", "long_name": "coefficient"}
    variables = {"C": (dims, C, attributes), "C_stderr": (dims, 0.05 * np.abs(C), attributes), "aic": (dims, aic)}
    formulas = "literal: C ln(η); percent: C ln(100 η); onset: C ln(η/η₀); line: C (η − η₀)"
    coords = {**grid, "form": ["literal", "percent", "onset", "line", "power"]}
    return dataset(variables, coords, title="a law", along="frequency", formulas=formulas)


FOLD, DOUBLING, END = range(3)
FLAGS = {"flag_values": np.arange(3, dtype=np.int8), "flag_meanings": "fold period-doubling end"}
STABILITY = {"flag_values": np.arange(-1, 2, dtype=np.int8), "flag_meanings": "not-known unstable stable"}
MACHINE = {"scene": "vibro-impact", "friction": "stribeck"}


def one_family(low=0.4, high=1.0, family=0):
    """Return a family that runs down from `high` to a fold at 0.5, then back up, unstable, to 0.8. The part before the
    fold is stable up to a period doubling at 0.9 and unstable above it. A branch of two returns runs from 0.9 to
    `high`."""
    down = np.concatenate([np.linspace(high, 0.9, 5), np.linspace(0.9, 0.5, 9)[1:]])
    up = np.linspace(0.5, 0.8, 7)[1:]
    doubled = np.linspace(0.9, high, 6)
    gamma = np.concatenate([down, up, doubled])
    branch = np.repeat([0, 1], [down.size + up.size, doubled.size])
    stable = np.concatenate([down <= 0.9, np.zeros(up.size), np.ones(doubled.size)])
    # At the fold, the multipliers are those on the side from which the continuation reached it.
    velocity = np.concatenate([2 + (down - 0.5), 2 - (up - 0.5), np.full(doubled.size, 2.4)])
    half_gap = np.where(branch == 1, np.sqrt(np.maximum(gamma - 0.9, 0.0)), 0.0)
    least, greatest, largest = velocity - half_gap, velocity + half_gap, np.where(stable, 0.5, 3.0)
    special = [(END, high, 0), (DOUBLING, 0.9, 0), (FOLD, 0.5, 0), (END, 0.8, 0), (END, high, 1)]
    kind, value, special_branch = map(np.array, zip(*special, strict=True))
    points = {"gamma": gamma, "branch": branch, "cycles": branch + 1, "impacts": branch + 1.0}
    points |= {"impact_velocity": velocity, "impact_velocity_min": least, "impact_velocity_max": greatest}
    points |= {"orbit_x1": -0.07 * gamma, "point_family": np.full(gamma.size, family)}
    at_special = {"special_value": value, "special_branch": special_branch, "special_note": np.full(kind.size, "")}
    at_special |= {"special_family": np.full(kind.size, family)}
    ds = xr.Dataset({name: ("point", x) for name, x in points.items()})
    ds = ds.assign({name: ("special", x) for name, x in at_special.items()})
    ds["stable"] = ("point", stable.astype(np.int8), STABILITY)
    ds["special_kind"] = ("special", kind.astype(np.int8), FLAGS)
    ds["multiplier_abs"] = (("point", "multiplier"), np.stack([largest, np.full(gamma.size, 0.25)], axis=1))
    ds["multiplier_arg"] = (("point", "multiplier"), np.tile([np.pi / 2, 0.0], (gamma.size, 1)))
    for name in ("impact_velocity", "impact_velocity_min", "impact_velocity_max", "orbit_x1"):
        ds[name].attrs = {"units": "m" if name == "orbit_x1" else "m s-1", "long_name": name}
    ds["gamma"].attrs = {"units": "1", "long_name": "frequency ratio", "symbol": "γ"}
    attributes = {"title": "a family", "along": "gamma", "span": [low, high], "start": "stuck", **MACHINE}
    return ds.assign_attrs(attributes, parameters=json.dumps({"beta": 0.4, "delta": -0.005}))


def several_families(values=(0.3, 0.4, 0.5)):
    parts, by = [one_family(family=number) for number in range(len(values))], {"combine_attrs": "override"}
    along = lambda dim: xr.concat([part[[n for n in part if dim in part[n].dims]] for part in parts], dim, **by)
    ds = xr.merge([along("point"), along("special")], **by)
    number = ("family", np.arange(len(values)), {"units": "1", "long_name": "number"})
    beta = ("family", np.array(values), {"units": "1", "long_name": "mass ratio", "symbol": "β"})
    attributes = {**parts[0].attrs, "parameters": json.dumps({"delta": -0.005})}
    return ds.assign_coords(family=number, beta=beta).assign_attrs(attributes)


def swept(**more):
    ds = returns({"gamma": np.linspace(0.6, 0.95, 15), **more})
    parameters = {"delta": -0.005} | ({} if "beta" in more else {"beta": 0.4})
    return ds.assign_attrs(parameters=json.dumps(parameters), **MACHINE)


def carried(keep=True):
    """Return lanes that are carried up and down."""
    ds = swept().rename(start="direction").assign_coords(direction=["up", "down"])
    ds = ds.assign(cycles=xr.ones_like(ds["regime"]), error_estimate=xr.zeros_like(ds["period"]))
    ds = ds if keep else ds.drop_vars("return_impact_velocity")
    return ds.assign_attrs(run=json.dumps({"carry": "gamma"}))


def basin(states, grid=None, named=(), keep=0):
    """Return a sweep from state vectors and then from named starts, with single impacts where x2 > 0 and gamma < 0.8.
    `states` holds the vectors by state name, each (vectors,). The velocity of single impacts grows with beta."""
    grid = {name: np.asarray(axis, float) for name, axis in (grid or {}).items()}
    count = len(next(iter(states.values())))
    rows = {name: np.concatenate([states.get(name, np.zeros(count)), np.full(len(named), np.nan)]) for name in UNITS}
    names = [*(json.dumps([float(rows[name][indices]) for name in UNITS]) for indices in range(count)), *named]
    mesh = np.meshgrid(*grid.values(), np.arange(len(names)), indexing="ij")
    indices = dict(zip([*grid, "start"], mesh, strict=True))
    single = (rows["x2"][indices["start"]] > 0) & (indices.get("gamma", 0.7) < 0.8)
    velocity = np.where(single, 2.0 + indices.get("beta", 0.4), 0.3)
    shown = {"regime": np.where(single, 3, 6), "impact_velocity": velocity, "period": np.where(single, 0.23, 0.21)}
    shown |= {"hidden_motion": np.ones(single.shape)}
    along = {f"start_{name}": ("start", values, {"units": UNITS[name]}) for name, values in rows.items()}
    variables = {name: ((*grid, "start"), values) for name, values in shown.items()}
    ds = dataset(variables, {**grid, "start": names, **along}, title="many starts")
    if keep:
        ds["return_impact_velocity"] = ds["impact_velocity"].expand_dims(return_index=keep, axis=-1)
    return ds


def plane(x=12, v=10):
    x2, v2 = np.meshgrid(np.linspace(-0.05, 0.05, x), np.linspace(-3.0, 3.0, v), indexing="ij")
    return {"x2": x2.ravel(), "v2": v2.ravel(), "v1": np.full(x * v, -1.5)}


def sample(count=100):
    draw = np.random.default_rng(1)
    return {name: draw.uniform(-1.0, 1.0, count) * (0.05 if name[0] == "x" else 3.0) for name in UNITS}


LONG = {"beta": np.linspace(0.25, 0.6, 8), "gamma": np.linspace(0.6, 0.9, 7)}


def sheet_of(ds, over=()):
    """Return the sheet of a dataset's picture."""
    return as_sheet(analysis_of(ds).plots(drawable(ds), over))


def cells(sheet, name=None):
    """Return the first cells of each plot that shows the regimes, or the colour map `name`, with their titles."""
    first = [(plot.title, layer) for plot in sheet.plots for layer in plot.layers[:1] if isinstance(layer, Cells)]
    return [(title, layer) for title, layer in first if layer.colour_map.name == (name or "regimes")]


def plot_of(sheet, **criterion):
    """Return the first plot with a title, or a label of y, that contains a text."""
    ((name, text),) = criterion.items()
    return next(plot for plot in resolved(sheet.plots) if text in (plot.title if name == "title" else plot.y.label))


def orbit_lines(plot):
    """Return the solid and the dashed lines through orbits, without the border of stability."""
    drawn = [layer for layer in plot.layers if isinstance(layer, Line) and not layer.marker and len(layer.x) > 2]
    return [[line for line in drawn if (line.dash != "-") == dashed] for dashed in (False, True)]


def marks_of(plot):
    """Return the places of special points by the colour and marker of their kind."""
    kinds = {(look["marker"], look["colour"]): kind for kind, look in MARKS.items()}
    places = {}
    for layer in plot.layers:
        if isinstance(layer, Line) and not layer.dash and (layer.marker, layer.colour) in kinds:
            places.setdefault(kinds[layer.marker, layer.colour], []).append((layer.x[0], layer.y[0]))
    return places


def labels(sheet):
    """Return the texts of the legends of a sheet."""
    own = [layer.label for plot in resolved(sheet.plots) if plot.keys for layer in labelled_layers(plot)]
    return own + [layer.label for group in legend_of(sheet) for layer in group]


def scales(sheet):
    """Return the quantities that have a colour bar."""
    return list({id(plot.scale): plot.scale for plot in resolved(sheet.plots) if plot.scale is not None}.values())


def check_texts(figure):
    """Check that all visible texts, except tick labels, lie within the figure without overlap."""
    figure.draw_without_rendering()
    visible = [text for text in figure.findobj(matplotlib.text.Text) if text.get_visible() and text.get_text().strip()]
    ticks = {id(text) for axes in figure.axes for axis in (axes.xaxis, axes.yaxis) for text in axis.get_ticklabels()}
    placed = [(text.get_text(), text.get_window_extent()) for text in visible if id(text) not in ticks]
    whole = figure.bbox.padded(1)
    for text, box in placed:
        assert whole.x0 <= box.x0 and box.x1 <= whole.x1 and whole.y0 <= box.y0 and box.y1 <= whole.y1, text
    for (text_a, a), (text_b, b) in combinations(placed, 2):
        assert not a.padded(-1).overlaps(b.padded(-1)), (text_a, text_b)
