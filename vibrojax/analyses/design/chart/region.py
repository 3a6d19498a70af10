"""The designer's chart: the map over mass ratio and frequency ratio at a design's other values, and what it gains.

The chart's variables are added to the dataset of the design, from which the page is drawn.
"""

from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float
from scipy.ndimage import binary_erosion, maximum_filter, minimum_filter

from vibrojax.analyses.design.spec import DesignSpec
from vibrojax.analyses.sweep.run import run_sweep
from vibrojax.errors import shown
from vibrojax.io.variables import Variable
from vibrojax.measures.labels import REGIMES
from vibrojax.models.physics.rock import ROCKS
from vibrojax.sweep.input.read import read_sweep

BETA, GAMMA = (0.1, 0.8), (0.4, 1.1)
"""Ranges of the mass ratio and the frequency ratio on the chart."""

CELLS = 71
"""Number of values of each ratio: a hundredth apart."""

RECTANGLE = {"beta": (0.25, 0.6), "gamma": (0.6, 0.8)}
"""The region that the source recommends (chapter 7)."""

CHARTED = ("impact_energy", "blow_frequency", "peak_impact_force", "rate_of_penetration", "impact_power", "drive_power")
"""Variables of the chart, as far as the scene has them."""

REGIONS = ("other", "single-impact", "robust")
"""Meanings of the flags of `chart_region`."""

MOST_STARTS_NAMED = 4
"""Largest number of starts that the page names."""

SAME_MOTION = 0.02
"""Relative spread of the impact energy over the starts, up to which their motions count as one."""

CLIFF = 0.4
"""Difference of the impact energy between neighbouring cells, relative to the chart's greatest, from which another
motion begins between them."""


def charted(ds: xr.Dataset, spec: DesignSpec, progress: bool = True) -> xr.Dataset:
    """Return the design's dataset with the variables of its chart.

    **Raises:** `InputError` if the scene has no mass ratio and frequency ratio, or no impacts.
    """
    names = spec.template.system.parameters()
    if not {"beta", "gamma"} <= set(names) or "impact_energy" not in spec.variables:
        raise spec.place.at("scene").error(
            f"{shown(spec.template.scene)} has no chart; it needs beta, gamma and impacts"
        )
    if clash := {"striker_frequency"} & {*spec.varied, *spec.tables["parameters"]}:
        raise spec.place.at(min(clash)).error("has no chart; give gamma instead")
    best = {name: float(ds[name][0]) for name in spec.varied}
    values = {**spec.tables["parameters"], **spec.fixed, **best}
    own = {name: float(values.get(name, names[name].default)) for name in ("beta", "gamma")}
    others = {name: x for name, x in values.items() if name not in own}
    base = {key: x for key, x in spec.tables.items() if key not in ("parameters", "title")} | {"parameters": others}
    base["run"] = {**base.get("run", {}), "orbits": False}
    axes = {"beta": np.linspace(*BETA, CELLS), "gamma": np.linspace(*GAMMA, CELLS)}
    lanes = run_sweep(read_sweep(base | {"grid": {name: x.tolist() for name, x in axes.items()}}), progress=progress)
    centre = {name: sum(ends) / 2 for name, ends in RECTANGLE.items()}
    places = {name: [centre[name], own[name]] for name in own}
    points = run_sweep(read_sweep(base | {"points": places}), progress=False)
    single = _single(lanes)
    box = _box(spec, axes)
    energy = np.where(single, _worst(lanes, "impact_energy"), np.nan)
    known = np.nan_to_num(energy)
    cliff = maximum_filter(known, footprint=box) - minimum_filter(known, footprint=box) > CLIFF * known.max()
    robust = binary_erosion(single, box, border_value=1) & ~cliff
    data: dict[str, Any] = {}
    meaning = "same single impact from every start; robust: in the cells around, and within the tolerances, as well"
    about = Variable("1", meaning, np.int8, REGIONS)
    flags = single.astype(np.int8) + robust
    data["chart_region"] = (("chart_beta", "chart_gamma"), flags.astype(np.int8), about.attributes())
    for name in (name for name in CHARTED if name in lanes):
        words = {key: str(lanes[name].attrs[key]) for key in ("units", "long_name")}
        data[f"chart_{name}"] = (("chart_beta", "chart_gamma"), np.where(single, _worst(lanes, name), np.nan), words)
        data[f"compared_{name}"] = ("compared", _worst(points, name), words)
    for name in own:
        words = {key: str(lanes[name].attrs[key]) for key in ("units", "long_name")}
        data[f"compared_{name}"] = ("compared", np.array(places[name]), words)
    coords = {
        "compared": (
            "compared",
            ["centre", "best"],
            {"long_name": "centre of the source's rectangle, and the best point"},
        ),
        **{f"chart_{name}": (f"chart_{name}", x, dict(lanes[name].attrs)) for name, x in axes.items()},
    }
    result = ds.assign(data).assign_coords(coords)
    count = int(ds.attrs["lanes"]) + lanes.regime.size + points.regime.size
    return result.assign_attrs(chart_values=_values_text(spec, others), lanes=count)


def _values_text(spec: DesignSpec, values: dict[str, Any]) -> str:
    """Return the rock, the drive speed, the other values that were given, and the starts."""
    names = spec.template.system.parameters()
    numbers = {name: float(x) for name, x in values.items() if isinstance(x, (int, float))}
    rock = {name: numbers.get(name, names[name].default) for name in ("threshold", "k3") if name in names}
    words = []
    if rock:
        same = [name for name, about in ROCKS.items() if (about.threshold, about.k3) == tuple(rock.values())]
        stiffness = f"D = {rock['threshold'] / 1e3:g} kN, k3 = {rock['k3'] / 1e6:g} MN/m"
        words.append(f"{same[0]} ({stiffness})" if same else f"rock with {stiffness}")
    if "v" in names and not {"rpm"} & set(numbers):
        words.append(f"drive speed {numbers.get('v', names['v'].default):g} m/s")
    words += [f"{name} = {x:g}" for name, x in numbers.items() if name not in ("v", *rock)]
    starts = [str(start) for start in spec.template.starts or ()]
    return ", ".join(words) + (f"; starts: {', '.join(starts)}" if 0 < len(starts) <= MOST_STARTS_NAMED else "")


def _single(lanes: xr.Dataset) -> Bool[np.ndarray, "beta gamma"]:
    """Return the cells in which every start leads to the same single impact."""
    single, energy = lanes["regime"] == REGIMES.index("single-impact"), lanes["impact_energy"]
    if "start" not in single.dims:
        return np.asarray(single.values)
    same = energy.max("start") <= (1 + SAME_MOTION) * energy.min("start")
    return np.asarray((single.all("start") & same).values)


def _worst(lanes: xr.Dataset, name: str) -> Float[np.ndarray, "..."]:
    """Return a variable's worst value over the starts: the greatest of forces and of drive power, else the least."""
    x = lanes[name]
    if "start" not in x.dims:
        return np.asarray(x.values)
    return np.asarray((x.max("start") if name in ("peak_impact_force", "drive_power") else x.min("start")).values)


def _box(spec: DesignSpec, axes: dict[str, np.ndarray]) -> Bool[np.ndarray, "..."]:
    """Return the cells around a cell in which a robust point must be single: the tolerances, at least one cell."""
    sizes = []
    for name, axis in axes.items():
        width = spec.tolerances.get(name, 0.0)
        sizes.append(2 * max(1, int(np.ceil(width / (axis[1] - axis[0]) - 1e-9))) + 1)
    return np.ones(sizes, bool)
