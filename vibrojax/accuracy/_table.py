"""The study as a table to read."""

import json

import numpy as np
import xarray as xr

_COLUMNS = ("method", "precision", "setting", "µs per lane-s", "spread", "worst", "median")
_MORE = ("period", "impact_velocity", "peak_impact_force", "stick_fraction", "rate_of_penetration")
_TITLES = ("period", "impact velocity", "peak force", "stick fraction", "ROP")
_READING = (
    "Time is that of all lanes on all cores, copied until each core has a block of them, divided by their number "
    "and the seconds that each is simulated, without compiling and without a check run: the median of the "
    "repeats, and half their range as its spread. Worst and median are over the lanes that move like the "
    "reference, of the larger relative error of period and impact velocity (penetration: of the rate of "
    "penetration, ROP); the columns after them are the worst lane's, relative, of the stick fraction the "
    "difference. Settings in bold are on the Pareto front of time and worst error. Rows with a remark had lanes "
    "that failed; they are never on the front."
)
_UNITS = {"width": " m/s", "step": " s"}


def table(ds: xr.Dataset) -> str:
    """The dataset of the study as Markdown: what was measured, how, on what, and a table for each scene."""
    about = json.loads(ds.attrs["machine"])
    lines = [
        "# Speed against error",
        "",
        f"Machine: {about['processor']}, {about['cores']} cores, "
        + ", ".join(f"{name} {value}" for name, value in about.items() if name not in ("processor", "cores")),
        "",
        f"Reference: {ds.attrs['reference']}.",
        "",
        f"Settings: {ds.attrs['settings']}.",
        "",
        _READING,
    ]
    for scene in dict.fromkeys(ds["scene"].values.tolist()):
        lines += ["", f"## {scene}", "", *_scene(ds.isel(setting=ds["scene"].values == scene))]
    return "\n".join([*lines, ""])


def _scene(ds: xr.Dataset) -> list[str]:
    shown = [name for name in _MORE if np.isfinite(ds[f"{name}_error_worst"].values).any()]
    titles = [title for name, title in zip(_MORE, _TITLES, strict=True) if name in shown]
    header = [*_COLUMNS, *titles, "compile s", "remark"]
    lanes, floor = int(ds["lanes"].values[0]), float(ds["reference_spread"].values[0])
    numbers = [column in _COLUMNS[3:] or column in titles or column == "compile s" for column in header]
    return [
        f"{lanes} periodic lanes; two references differ by {_error(floor)}.",
        "",
        "| " + " | ".join(header) + " |",
        "|" + "|".join("---:" if number else "---" for number in numbers) + "|",
        *("| " + " | ".join(_row(ds.isel(setting=index), shown)) + " |" for index in range(ds.sizes["setting"])),
    ]


def _row(one: xr.Dataset, shown: list[str]) -> list[str]:
    time = 1e6 * float(one["time_per_lane_second"])
    spread = (float(one["time_per_lane_second_max"]) - float(one["time_per_lane_second_min"])) / 2e-6
    varied = str(one["varied"].item())
    setting = f"{varied} {float(one['value']):g}{_UNITS.get(varied, '')}"
    compiling = float(one["compile_time"])
    return [
        str(one["method"].item()),
        str(one["precision"].item()),
        f"**{setting}**" if one["on_front"].item() else setting,
        f"{time:.3g}" if np.isfinite(time) else "–",
        f"± {spread:.2g}" if np.isfinite(spread) else "–",
        *(_error(float(one[name])) for name in ("error_worst", "error_median")),
        *(_error(float(one[f"{name}_error_worst"])) for name in shown),
        f"{compiling:.1f}" if np.isfinite(compiling) else "–",
        str(one["reason"].item()),
    ]


def _error(value: float) -> str:
    return f"{value:.1e}" if np.isfinite(value) else "–"
