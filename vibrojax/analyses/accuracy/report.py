"""The accuracy study as a Markdown table."""

import json

import numpy as np
import xarray as xr

_TEXT = ("method", "precision", "setting")
_NUMBERS = ("µs per lane-s", "spread", "worst", "median")
_ERRORS = {
    "period": "period",
    "impact_velocity": "impact velocity",
    "peak_impact_force": "peak force",
    "stick_fraction": "stick fraction",
    "rate_of_penetration": "ROP",
}
_UNITS = {"width": " m/s", "step": " s"}
_READING = (
    "Time is that of all lanes on all cores, copied until each core has a block of them, divided by their number "
    "and the simulated seconds of each, without compiling and without a check run: the median of the "
    "repeats, and half their range as its spread. Worst and median are over the lanes that move like the "
    "reference, of the larger relative error of period and impact velocity (penetration: of the rate of "
    "penetration, ROP); the columns after them are the worst lane's, relative, of the stick fraction the "
    "difference. Settings in bold are on the Pareto front of time and worst error. Rows with a remark had lanes "
    "that failed; they are never on the front."
)


def table(ds: xr.Dataset) -> str:
    """Return the dataset of the study as Markdown: machine, reference, settings, and a table for each scene."""
    about = json.loads(ds.attrs["machine"])
    versions = (f"{name} {value}" for name, value in about.items() if name not in ("processor", "cores"))
    paragraphs = [
        "# Speed against error",
        f"Machine: {about['processor']}, {about['cores']} cores, {', '.join(versions)}",
        f"Reference: {ds.attrs['reference']}.",
        f"Settings: {ds.attrs['settings']}.",
        _READING,
    ]
    for scene in dict.fromkeys(ds["scene"].values.tolist()):
        here = ds.isel(setting=ds["scene"].values == scene)
        lanes, spread = int(here["lanes"].values[0]), float(here["reference_spread"].values[0])
        shown = [name for name in _ERRORS if np.isfinite(here[f"{name}_error_worst"].values).any()]
        numbers = [*_NUMBERS, *(_ERRORS[name] for name in shown), "compile s"]
        rows = [_row(here.isel(setting=index), shown) for index in range(here.sizes["setting"])]
        lines = [f"| {' | '.join(cells)} |" for cells in ([*_TEXT, *numbers, "remark"], *rows)]
        lines.insert(1, "|" + "---|" * len(_TEXT) + "---:|" * len(numbers) + "---|")
        paragraphs += [
            f"## {scene}",
            f"{lanes} periodic lanes; two references differ by {_format(spread, '.1e')}.",
            "\n".join(lines),
        ]
    return "\n\n".join(paragraphs) + "\n"


def _row(setting: xr.Dataset, shown: list[str]) -> list[str]:
    def number(name: str) -> float:
        return float(setting[name])

    spread = (number("time_per_lane_second_max") - number("time_per_lane_second_min")) / 2e-6
    varied = str(setting["varied"].item())
    name = f"{varied} {number('value'):g}{_UNITS.get(varied, '')}"
    errors = ["error_worst", "error_median", *(f"{error}_error_worst" for error in shown)]
    return [
        str(setting["method"].item()),
        str(setting["precision"].item()),
        f"**{name}**" if setting["on_front"].item() else name,
        _format(1e6 * number("time_per_lane_second"), ".3g"),
        _format(spread, ".2g", "± "),
        *(_format(number(error), ".1e") for error in errors),
        _format(number("compile_time"), ".1f"),
        str(setting["remark"].item()),
    ]


def _format(value: float, spec: str, prefix: str = "") -> str:
    return f"{prefix}{value:{spec}}" if np.isfinite(value) else "–"
