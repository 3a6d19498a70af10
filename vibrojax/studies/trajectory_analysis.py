"""The analysis `trajectory`: pictures and summary of one motion over time."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import xarray as xr

from vibrojax.errors import Place, counted
from vibrojax.io.attributes import attribute_of, flags, parameters_of, run_of
from vibrojax.maps.read import Point, read_point
from vibrojax.measures.labels import FEWEST_RETURNS
from vibrojax.pictures.axes import pretty_unit, scale
from vibrojax.pictures.time_history import pulses, response, states_over_time, trajectory
from vibrojax.scenes import HasRock
from vibrojax.settings.code_identity import code_identity
from vibrojax.settings.fields import setting
from vibrojax.studies.analysis import PictureRule, SummaryPart
from vibrojax.studies.frequencies import frequency_part
from vibrojax.studies.subjects import MachineAnalysis
from vibrojax.studies.trajectory_run import simulate_point

SECTION = "to the section (the bit overtakes the drive)"

REPORTED_DRIFT = 1e-3
"""Relative distance from the settled motion above which the summary reports it: half a digit of printed values."""

DURATION_MARGIN = 1.15
"""Ratio of the recommended duration to the shortest sufficient duration."""


@dataclass(frozen=True, kw_only=True)
class Trajectories(MachineAnalysis[Point]):
    """Simulate one point: write its trajectory as a dataset, and a picture."""

    kind, command = "trajectory", "simulate"
    view = "motion"
    run_settings = ()
    file, lists, numbered = "SCENE.nc, SCENE-2.nc, ...", False, True
    pictures = (
        PictureRule("motion", lambda held: held.bit_on_rock and held.swept_sine, response),
        PictureRule("motion", lambda held: held.bit_on_rock, pulses),
        PictureRule("motion", lambda held: held.drill, trajectory),
        PictureRule("motion", lambda held: held.run, states_over_time),
    )

    duration: float | None = setting(None, "simulated time, s", unit="s", above=0.0)
    sampling: float | None = setting(None, "interval of the samples, s", unit="s", above=0.0)
    error: float | None = setting(None, "accepted relative error: 0.0001", above=0.0)
    method: str | None = setting(None, "located, smoothed or diffrax")
    solver: str | None = setting(None, "a solver of diffrax")
    step: float | None = setting(None, "greatest step, s", unit="s", above=0.0)
    smoothing: float | None = setting(None, "width of the friction switch, m/s", unit="m s-1", above=0.0)

    def machines(
        self, place: Place, scene: object, parameters: Mapping[str, object], start: object, run: Mapping[str, object]
    ) -> Point:
        return read_point(place, scene, parameters, start)

    def arguments(self) -> dict[str, Any]:
        """Return the settings that were given."""
        return {name: value for name, value in vars(self).items() if value is not None}

    def identity(self, asked: Point) -> dict[str, object]:
        return {**asked.identity(), **self.arguments(), **code_identity(asked.system, asked.options)}

    def file_name(self, asked: Point) -> str:
        return f"{asked.scene}.nc"

    def compute(self, asked: Point, progress: bool = True) -> xr.Dataset:
        return simulate_point(asked, **self.arguments(), progress=progress)

    def facts(self, ds: xr.Dataset, asked: Point) -> Mapping[str, object]:
        return {
            "scene": asked.scene,
            **asked.options,
            "start": asked.start,
            "parameters": asked.parameters,
            **({"bit_radius": asked.hole_radius} if isinstance(asked.system, HasRock) else {}),
            "duration": float(ds["time"][-1]),
            "run": attribute_of(ds, "run"),
            "found": features(ds),
            **frequency_part(ds).facts,
            "solver": attribute_of(ds, "solver"),
        }

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        return [SummaryPart("found", feature_lines(ds), {"found": features(ds)}), frequency_part(ds)]


def features(ds: xr.Dataset) -> dict[str, object]:
    """Return the scalar variables of a trajectory by name; flags are replaced by their meanings."""
    single = {str(name): data for name, data in ds.data_vars.items() if data.ndim == 0}
    return {name: flags(data)[int(data)] if flags(data) else data.item() for name, data in single.items()}


def feature_lines(ds: xr.Dataset) -> list[str]:
    """Describe regime, period, impacts and rate of penetration; return no lines if nothing was measured."""
    run = run_of(ds)
    if not {"settle", "observe"} <= set(run) or "time" not in ds.dims:
        return []
    values = {str(name): float(data) for name, data in ds.data_vars.items() if data.ndim == 0}
    lines = [_regime_line(ds, values)] if "regime" in values else []
    if "rate_of_penetration" in values:
        lines += _penetration_lines(ds, values)
    if not lines:
        return []
    if power := _power_line(ds, values):
        lines.append(power)
    last = f"measured from {run['settle']:.4g} s to the end at {run['settle'] + run['observe']:.4g} s"
    if "returns" in values:
        last += f": {counted(int(values['returns']), 'return')} {SECTION if 'x1' in ds else 'to the section'}"
    drift = values.get("drift_estimate", math.nan)
    if drift > REPORTED_DRIFT:
        far = f"by some {100 * drift:.2g} %" if math.isfinite(drift) else "and its returns do not tell how far"
        last += f"; still on its way to where it settles, {far}: a longer duration brings it there"
    return [*lines, last]


def _regime_line(ds: xr.Dataset, values: dict[str, float]) -> str:
    regime = flags(ds["regime"])[int(ds["regime"])]
    returns, period = int(values["returns"]), values.get("period", math.nan)
    if regime == "equilibrium":
        speed = parameters_of(ds).get("v") if "x1" in ds else None
        moves = "nothing moves" if speed is None else f"the bit moves steadily with the drive, at {speed:.4g} m/s"
        return f"equilibrium: {'the bit rests' if speed == 0 else moves}"
    if regime == "undecided" and returns < FEWEST_RETURNS:
        advice = "give a longer duration"
        if returns > 1:
            observed, last = run_of(ds)["observe"], float(ds["time"][-1])
            advice = f"give duration={DURATION_MARGIN * (FEWEST_RETURNS + 1) * period / observed * last:.2g}"
        count = (
            f"{returns} returns to the section are" if returns > 1 else ("one return is", "no return is")[not returns]
        )
        return f"undecided: {count} too few to judge by, {FEWEST_RETURNS} are needed; {advice}"
    if regime == "undecided":
        return "undecided: the swing steadily grows or decays; a longer duration shows what it ends in"
    if regime == "failed":
        return "failed: the motion does not stay finite"
    cycles = int(values["cycles"])
    if "impacts" not in values:
        repeats = {0: "does not repeat", 1: "repeats"}.get(cycles, f"repeats after {cycles} returns")
        return f"{regime}: {repeats}, with {period:.5g} s from return to return"
    blows = values["impacts"]
    energy = f" and {values['impact_energy']:.4g} J" if "impact_energy" in values else ""
    unit = pretty_unit(str(ds["impact_velocity"].attrs.get("units", "m s-1"))) if blows else ""
    strength = f", at {values['impact_velocity']:.4g} {unit}{energy}" if blows else ""
    mean = ", on average" if blows > 1 or not cycles else ""
    if not cycles:
        often = f"a blow every {period / blows:.4g} s" if blows else "no blow"
        return f"{regime}: it does not repeat; {often}{mean + strength if blows else ''}"
    each = f"each period of {period:.5g} s" if cycles == 1 else f"each repeat, of {cycles} periods of {period:.5g} s"
    count = {0: "no blow", 1: "one blow"}.get(int(blows), f"{blows:.0f} blows")
    return f"{regime}: {count} in {each}{mean if blows else ''}{strength}"


def _power_line(ds: xr.Dataset, values: dict[str, float]) -> str:
    """Return impact power, specific energy and stick-slip index as text; quantities that are undefined are left out."""
    parts = []
    for name in ("impact_power", "specific_energy", "stick_slip_index"):
        if math.isfinite(values.get(name, math.nan)) and (name != "impact_power" or values[name] > 0):
            factor, unit = scale(ds[name])
            radius = ds[name].attrs.get("bit_radius")
            hole = "" if radius is None else f" (hole of radius {radius:g} m)"
            parts.append(f"{name.replace('_', ' ')} {factor * values[name]:.4g} {pretty_unit(unit)}".rstrip() + hole)
    return ", ".join(parts).replace("stick slip", "stick-slip")


def _penetration_lines(ds: xr.Dataset, values: dict[str, float]) -> list[str]:
    rate, relief, slip = (values.get(name, math.nan) for name in ("rate_of_penetration", "relief", "slip_per_impact"))
    threshold = parameters_of(ds)["threshold"]
    event = "pulse" if "regime" not in values else "blow"
    force = f"mean force {values['mean_force'] / 1e3:.4g} kN over the {threshold / 1e3:.4g} kN at which the rock yields"
    lines = [f"relief P/D {relief:.4g}: {force}"] if math.isfinite(relief) else []
    if not math.isfinite(rate):
        return [f"no whole {event} was observed, so there is no rate of penetration; give a longer duration", *lines]
    if rate == 0:
        return [f"no penetration: {_rock_below_threshold(ds, threshold)}", *lines]
    growth = f", {1e3 * slip:.4g} mm for each {event} (slip)" if math.isfinite(slip) else ""
    return [f"rate of penetration {rate:.4g} m/s ({3600 * rate:.4g} m/h){growth}", *lines]


def _rock_below_threshold(ds: xr.Dataset, threshold: float) -> str:
    """Describe how far the force of the rock stays below the threshold D while it is observed, and what would raise it.

    The inertia of the bit takes a part of the contact force, which can therefore exceed D.
    """
    run = run_of(ds)
    is_observed = (ds["time"] >= run["settle"]) & (ds["time"] <= run["settle"] + run["observe"])
    force = float(ds["rock_force"].where(is_observed).max()) if "rock_force" in ds else math.nan
    if not math.isfinite(force):
        return "the rock does not yield"
    change = "a greater v" if "impact_velocity" in ds else "a greater force"
    return (
        f"the rock force reaches {force / 1e3:.4g} kN, {force / threshold:.2g} of the threshold D = "
        f"{threshold / 1e3:.4g} kN at which the rock yields; a softer rock or {change} raises it"
    )
