"""The analysis `rig`: summary, and picture of rate over weight and of tracks over depth."""

from textwrap import fill
from typing import ClassVar

import numpy as np
import xarray as xr

from vibrojax.io.attributes import text_of
from vibrojax.io.riglog import LIMITS_OF_LOGS, log_lines
from vibrojax.io.variables import Variable
from vibrojax.pictures.axes import axis, margins, pretty_unit, scale
from vibrojax.pictures.plots import FAINT, Axis, Layer, Line, Plot, Sheet, dots
from vibrojax.pictures.style import BIT, IMPACT
from vibrojax.studies.analysis import Analysis, PictureRule, Source, SummaryPart
from vibrojax.studies.rig_measures import FOUNDER_REASONS, SCHEMA, rig

TRACKS = (
    *("rate_of_penetration", "weight_on_bit", "rotary_speed", "torque"),
    *("specific_energy", "percussive_specific_energy", "stick_slip_index", "torque_stick_slip"),
)
"""Variables that are drawn over depth, as far as the log has them."""

_TITLE_LETTERS = 18  # of a line above a track


def rig_picture(ds: xr.Dataset) -> Sheet:
    """Draw the rate over the weight with the founder point, and the tracks over depth or row."""
    tracks = [name for name in TRACKS if name in ds and np.isfinite(ds[name].values).any()]
    plots = [_founder_plot(ds)] if "weight_on_bit" in ds else []
    over = "depth" if "depth" in ds and np.isfinite(ds["depth"].values).all() else None
    height = ds[over].values if over else np.arange(ds.sizes["row"])
    ends = float(height.min()), float(height.max())
    up = Axis("depth [m]" if over else "row", over or "", ends, reversed=True, group="depth")
    for k, name in enumerate(tracks, 1):
        factor, unit = scale(ds[name])
        line = Line(ds[name].values * factor, height, BIT, 0.6)
        across = Axis(f"[{pretty_unit(unit)}]" if pretty_unit(unit) else "", name, intervals=3)
        plots.append(Plot([line], across, up, fill(name.replace("_", " "), _TITLE_LETTERS), (0, k)))
    widths = [2.2, *[1.0] * len(tracks)]
    return Sheet(plots, (4.4 + 1.5 * len(tracks), 5.0), widths, **margins(ds, point=LIMITS_OF_LOGS))


def _founder_plot(ds: xr.Dataset) -> Plot:
    weight, rate = ds["weight_on_bit"], ds["rate_of_penetration"]
    across, up = scale(weight)[0], scale(rate)[0]
    layers: list[Layer] = [dots(weight.values * across, rate.values * up, colour=FAINT, size=1.5)]
    founder, title = float(ds["founder_weight"]), "no founder point"
    if np.isfinite(founder):
        below, above = float(ds["slope_below"]), float(ds["slope_above"])
        x = np.array([np.nanmin(weight.values), founder, np.nanmax(weight.values)])
        rise = below * np.minimum(x - founder, 0.0) + above * np.maximum(x - founder, 0.0)
        inside = below * np.minimum(weight.values - founder, 0.0) + above * np.maximum(weight.values - founder, 0.0)
        height = np.nanmean(rate.values - inside)
        layers.append(Line(x * across, (height + rise) * up, BIT, 1.5))
        layers.append(dots([founder * across], [height * up], marker="*", colour=IMPACT, size=10.0, order=3.0))
        title = f"founder point at {founder * across:.3g} {pretty_unit(scale(weight)[1])}"
    return Plot(layers, axis(weight), axis(rate), title)


class Rigs(Analysis):
    """Compute specific energies, the founder point and stick-slip of a rig log, and draw tracks over depth."""

    kind = "rig"
    variables: ClassVar[dict[str, Variable]] = {name: about for name, (_, about) in SCHEMA.items()}
    pictures = (PictureRule("a rig log", lambda held: "founder_weight" in held.variables, rig_picture),)

    def run(self, source: Source, progress: bool = True) -> xr.Dataset:
        """Compute the measures, as [vibrojax.rig][] does."""
        return rig(source)

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        """Return how the log was read, the founder point, the medians of the measures, and what the log can inform."""
        lines = []
        reason = FOUNDER_REASONS[int(ds["founder_reason"])]
        if reason == "found":
            factor, unit = scale(ds["founder_weight"])
            lines.append(f"founder point at a weight of {factor * float(ds['founder_weight']):.4g} {pretty_unit(unit)}")
            share = float(ds["slope_above"] / ds["slope_below"])
            lines[-1] += f"; above it the rate rises with {share:.2f} of the slope below"
        else:
            lines.append(f"no founder point ({reason})")
        facts: dict[str, object] = {"founder_weight": float(ds["founder_weight"]), "founder_reason": reason}
        for name in ("specific_energy", "percussive_specific_energy", "torque_stick_slip"):
            values = ds[name].values[np.isfinite(ds[name].values)]
            facts[name] = float(np.median(values)) if len(values) else None
            if len(values):
                factor, unit = scale(ds[name])
                low, middle, high = factor * np.quantile(values, [0.1, 0.5, 0.9])
                unit = pretty_unit(unit)
                lines.append(
                    f"{name.replace('_', ' ')}: median {middle:.3g}, 80 % from {low:.3g} to {high:.3g} {unit}".rstrip()
                )
        lines += [part for part in text_of(ds, "notes").split("; ") if " is not known: " in part]
        read = [line for line in log_lines(ds) if line not in lines]
        return [SummaryPart("log", read, {}), SummaryPart("rig", [*lines, LIMITS_OF_LOGS], {"rig": facts})]
