"""The analysis `rig`: summary, and picture of rate over weight and of tracks over depth."""

from typing import ClassVar

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vibrojax.io.attributes import text_of
from vibrojax.io.riglog import LIMITS_OF_LOGS, log_lines
from vibrojax.io.variables import Variable
from vibrojax.pictures.axes import label, pretty_unit, scale
from vibrojax.pictures.sheet import write_margins
from vibrojax.pictures.style import BIT, FAINT, IMPACT, new_figure, styled
from vibrojax.studies.analysis import Analysis, PictureRule, Source, SummaryPart
from vibrojax.studies.rig_measures import FOUNDER_REASONS, SCHEMA, rig

TRACKS = (
    *("rate_of_penetration", "weight_on_bit", "rotary_speed", "torque"),
    *("specific_energy", "percussive_specific_energy", "stick_slip_index", "torque_stick_slip"),
)
"""Variables that are drawn over depth, as far as the log has them."""


@styled
def rig_picture(ds: xr.Dataset) -> Figure:
    """Draw the rate over the weight with the founder point, and the tracks over depth or row."""
    tracks = [name for name in TRACKS if name in ds and np.isfinite(ds[name].values).any()]
    figure = new_figure(4.4 + 1.5 * len(tracks), 5.0)
    axes = figure.subplots(1, 1 + len(tracks), squeeze=False, width_ratios=[2.2, *[1.0] * len(tracks)])[0]
    if "weight_on_bit" in ds:
        _draw_founder(axes[0], ds)
    else:
        axes[0].set_axis_off()
    over = "depth" if "depth" in ds and np.isfinite(ds["depth"].values).all() else None
    height = ds[over].values if over else np.arange(ds.sizes["row"])
    for track, name in zip(axes[1:], tracks, strict=True):
        track.plot(ds[name].values * scale(ds[name])[0], height, color=BIT, linewidth=0.6)
        track.set_ylim(height.max(), height.min())
        track.set_title(name.replace("_", " "), fontsize="small", loc="left", wrap=True)
        unit = pretty_unit(scale(ds[name])[1])
        track.set_xlabel(f"[{unit}]" if unit else "")
        track.grid(True)
        if track is not axes[1]:
            track.set_yticklabels([])
    if tracks:
        axes[1].set_ylabel("depth [m]" if over else "row")
    write_margins(figure, ds, point=LIMITS_OF_LOGS)
    return figure


def _draw_founder(axes: Axes, ds: xr.Dataset) -> None:
    weight, rate = ds["weight_on_bit"], ds["rate_of_penetration"]
    across, up = scale(weight)[0], scale(rate)[0]
    axes.plot(weight.values * across, rate.values * up, ".", color=FAINT, markersize=3)
    founder = float(ds["founder_weight"])
    if np.isfinite(founder):
        below, above = float(ds["slope_below"]), float(ds["slope_above"])
        x = np.array([np.nanmin(weight.values), founder, np.nanmax(weight.values)])
        rise = below * np.minimum(x - founder, 0.0) + above * np.maximum(x - founder, 0.0)
        inside = below * np.minimum(weight.values - founder, 0.0) + above * np.maximum(weight.values - founder, 0.0)
        level = np.nanmean(rate.values - inside)
        axes.plot(x * across, (level + rise) * up, color=BIT)
        axes.plot(founder * across, level * up, "*", color=IMPACT, markersize=10)
        axes.set_title(f"founder point at {founder * across:.3g} {pretty_unit(scale(weight)[1])}", loc="left")
    else:
        axes.set_title("no founder point", loc="left")
    axes.set_xlabel(label(weight))
    axes.set_ylabel(label(rate))
    axes.grid(True)


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
