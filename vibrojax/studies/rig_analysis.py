"""The analysis `rig`: specific energies, founder point and stick-slip of a rig log, drawn as tracks over depth."""

from collections.abc import Mapping
from textwrap import fill
from typing import Any, ClassVar

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.errors import InputError, Place, shell_assignment, shown
from vibrojax.io.attributes import text_of
from vibrojax.io.log_columns import KNOWN, LINE, RATE, ROTATION_SPEED, WEIGHT
from vibrojax.io.riglog import LIMITS_OF_LOGS, Nulls, Source, Where, log_lines, read_log, to_dataset
from vibrojax.io.variables import Variable
from vibrojax.pictures.axes import in_units, margins, pretty_unit
from vibrojax.pictures.contents import POINT
from vibrojax.pictures.layout import is_narrow
from vibrojax.pictures.plots import FAINT, Axis, Layer, Line, Look, Plot, Sheet, dots, upright
from vibrojax.pictures.style import BIT, IMPACT
from vibrojax.settings.values import choice, warn_if_far
from vibrojax.studies.analysis import Analysis, PictureRule, SummaryPart
from vibrojax.studies.analysis import Source as AnalysisSource
from vibrojax.studies.rop_group import LEAST_CLEANED, Founder, clean

# The stick-slip index of torque has windows of several periods of a drill string's torsion. Rows farther apart miss the
# torque's extremes within a period.
WINDOW, SLOWEST_SAMPLING = 30.0, 2.0  # s
MOST_FORMATIONS = 20  # greatest number of texts in a column that are taken for names of formations or bits

_NO_FOUNDER = {
    "no-bend": "the rate over the weight has no bend",
    "too-few-rows": "too few rows to tell",
    "no-weight": "no weight on bit",
}
FOUNDER_REASONS = ("found", *_NO_FOUNDER)
_NEEDED = {
    "specific_energy": (WEIGHT, ROTATION_SPEED, "torque", "bit_diameter"),
    "percussive_specific_energy": ("impact_power", "bit_diameter"),
    "torque_stick_slip": ("time", "torque"),
}
SCHEMA = {
    "specific_energy": Variable("J m-3", "mechanical specific energy W/A + ω T/(A R) (Teale 1965)"),
    "percussive_specific_energy": Variable("J m-3", "impact power over the volume drilled per second"),
    "torque_stick_slip": Variable(
        "1", "stick-slip index (Tmax - Tmin)/(2 Tmean) of the surface torque over 30 s around the row"
    ),
    "founder_weight": Variable("N", "weight on bit above which the rate does not rise: founder point"),
    "slope_below": Variable("m s-1 N-1", "rate per weight below the founder point, or everywhere"),
    "slope_above": Variable("m s-1 N-1", "rate per weight above the founder point"),
    "founder_reason": Variable("1", "whether there is a founder point", np.int8, FOUNDER_REASONS),
}
TRACKS = (RATE, WEIGHT, ROTATION_SPEED, "torque", *_NEEDED, "stick_slip_index")
"""Variables that are drawn over depth, as far as the log has them."""

_DRILLERS = {"m s-1": (3600.0, "m/h"), "rad s-1": (30 / np.pi, "rpm"), "N": (1e-3, "kN"), "N m": (1e-3, "kN m")}
_DRILLERS |= {"J m-3": (1e-6, "MPa"), "Pa": (1e-6, "MPa")}
"""Factor and name of the units of drillers, by SI unit."""

UNITS = ("driller", "si")
_WIDTH_OF_PAGE = 7.5  # [inch] up to which the tracks are below the founder point
_TITLE_LETTERS = 18  # of a line above a track
_TRIM = (2.0, 98.0)  # percentiles: values further away than these differ are not drawn, but counted
_LOG_SPAN = 30.0  # ratio of the largest to the least energy from which its axis is logarithmic

Rows = Float[np.ndarray, " rows"]


def rig(
    source: Source,
    columns: Mapping[str, str] | None = None,
    where: Where = None,
    nulls: Nulls = None,
    units: str = "driller",
) -> xr.Dataset:
    """Compute specific energies, founder point and stick-slip index from a rig log.

        log = vj.rig("log.csv", columns={"bit_diameter": "8.5 in"})
        vj.picture(log)

    The mechanical specific energy is W/A + ω T/(A R) (Teale 1965). W is the weight on bit [N], ω the rotary
    speed [rad/s], T the torque [N m], R the rate of penetration [m/s], and A the area of the bit [m²]. The percussive
    specific energy is the power of the impacts, `impact_power`, divided by the volume A R drilled per second.

    The founder point is the weight on the bit above which the rate of penetration does not rise; see
    [vibrojax.fit_rop][]. The variable `torque_stick_slip` is (Tmax - Tmin)/(2 Tmean) of the surface torque.

    **Arguments:** `source`, `columns`, `where`, `nulls`: as for [vibrojax.read_log][]; `units`: units of pictures and
    summaries, "driller" (m/h, rpm, kN, MPa) or "si". The dataset is in SI units.

    **Returns:** the log with `specific_energy`, `percussive_specific_energy` [J/m³] and `torque_stick_slip` along
    `row`, and with `founder_weight` [N], `slope_below`, `slope_above` and `founder_reason`. A quantity whose columns
    are missing from the log is NaN, and the attribute `notes` states why.

    **Raises:** `InputError` if the log cannot be read.

    **Example:**

    >>> import pandas as pd
    >>> table = pd.DataFrame({"WOB (kN)": [100, 120], "RPM (rpm)": 120, "Torque (kN.m)": 5, "ROP (m/h)": [18, 20]})
    >>> log = vj.rig(table, columns={"bit_diameter": "8.5 in"})
    >>> (log.specific_energy / 1e6).values.round().tolist()  # MPa
    [346.0, 312.0]
    """
    table = read_log(source, columns, where, nulls)
    for header, name, median, likely in table.attrs["unusual"]:
        warn_if_far(Place(table.attrs["title"], f"column {header}"), KNOWN[name], median, likely)
    if RATE not in table:
        raise InputError(f'rig: the log has no rate of penetration; name its column: --columns {RATE}="ROP (m/h)"')
    of = table.reindex(columns=[RATE, WEIGHT, ROTATION_SPEED, "torque", "bit_diameter", "impact_power", "time"])
    rate, weight, speed, torque, diameter, power, clock = of.to_numpy(float).T
    with np.errstate(divide="ignore", invalid="ignore"):
        area = np.where(rate > 0, np.pi / 4 * diameter**2, np.nan)
        values = {
            "specific_energy": weight / area + speed * torque / (area * rate),
            "percussive_specific_energy": power / (area * rate),
            "torque_stick_slip": torque_stick_slip(clock, torque),
        }
    notes = list(table.attrs["notes"])
    for name, needed in _NEEDED.items():
        if missing := [column for column in needed if column not in table]:
            hint = ', which columns may give, like bit_diameter="8.5 in"' * ("bit_diameter" in missing)
            notes.append(f"{name} is not known: the log has no {' and no '.join(missing)}{hint}")
        elif name == "torque_stick_slip" and not np.isfinite(values[name]).any():
            fault = f"rows in order of time, at most {SLOWEST_SAMPLING:g} s apart, and a torque above 0 are needed"
            notes.append(f"{name} is not known: {fault}")
    for name, x in table.items():
        if x.dtype.kind == "O" and 1 < (count := x.nunique()) <= MOST_FORMATIONS:
            one = shell_assignment(str(name), str(x.iloc[0]))
            each = f"--where {one} keeps one, and vibrojax fit --by {shown(str(name))} fits each"
            notes.append(f"the founder point is of all {count} values of {name} together: {each}")
    measures: dict[str, Any] = {name: ("row", value) for name, value in values.items()}
    measures |= {name: ((), value) for name, value in founder_point(weight, rate).items()}
    own, log = Rigs().dataset(measures, {}, title=table.attrs["title"]), to_dataset(table)
    # Names of other columns may hold what a netCDF file does not accept.
    log = log.drop_vars([name for name in log.coords if name != LINE]).assign(own.data_vars)
    drawn_in = choice(Place("rig", "units"), units, UNITS)
    return log.assign_attrs(own.attrs | {"notes": "; ".join(notes), "drawn_in": drawn_in})


def founder_point(weight: Rows, rate: Rows) -> dict[str, float]:
    """Return the founder weight [N], the slopes below and above it, and why there is none; rows in order of depth."""
    known = np.isfinite(weight) & np.isfinite(rate) & (weight > 0)
    x, y, slope, founder = weight[known], rate[known], np.nan, Founder()
    reason = "too-few-rows" if x.size else "no-weight"
    if x.size >= LEAST_CLEANED and np.ptp(x):
        founder, wrong = clean(x / np.median(x), x, y)
        below = ~np.any([*wrong.values(), x > founder.weight], axis=0)
        slope = np.polyfit(x[below] / x.max(), y[below], 1)[0] / x.max()
        reason = "found" if founder.is_known else "no-bend"
    measures = {"founder_weight": founder.weight, "slope_below": slope, "slope_above": -founder.fall}
    return measures | {"founder_reason": FOUNDER_REASONS.index(reason)}


def torque_stick_slip(time: Rows, torque: Rows) -> Rows:
    """Return (Tmax - Tmin)/(2 Tmean) over `WINDOW` around each row; NaN where rows are too far apart."""
    result = np.full(len(time), np.nan)
    if len(time) < 2 or not (np.diff(time) >= 0).all():
        return result
    begins = np.searchsorted(time, time - WINDOW / 2)
    ends = np.searchsorted(time, time + WINDOW / 2, side="right")
    for row, (begin, end) in enumerate(zip(begins, ends, strict=True)):
        part, times = torque[begin:end], time[begin:end]
        full = times[-1] - times[0] >= 0.8 * WINDOW and np.diff(times).max(initial=0.0) <= SLOWEST_SAMPLING
        if full and np.isfinite(part).all() and part.mean() > 0:
            result[row] = np.ptp(part) / (2 * part.mean())
    return result


def vertical(ds: xr.Dataset) -> tuple[Axis, Rows]:
    """Return the axis of the tracks, the depth or else the row, and its value of each row."""
    name = "depth" if "depth" in ds and np.isfinite(ds["depth"].values).all() else "row"
    height = ds[name].values.astype(float) if name == "depth" else np.arange(ds.sizes["row"], dtype=float)
    ends = float(height.min()), float(height.max())
    return Axis("depth [m]" if name == "depth" else "row", name, ends, reversed=True, group="depth"), height


def rig_picture(ds: xr.Dataset) -> Sheet:
    """Draw the rate over the weight with the founder point, and the tracks over depth or row.

    In a chosen width, the tracks are below the founder point.
    """
    tracks = [name for name in TRACKS if name in ds and np.isfinite(ds[name].values).any()]
    down, height = vertical(ds)
    founder, force = float(ds["founder_weight"]) * _unit(ds, "N")[0], _unit(ds, "N")[1]
    look = Look(colour=IMPACT, dash="--", width=1.0, label=f"founder point, {founder:.3g} {force}")
    mark: list[Layer] = [upright(founder, **look)] if np.isfinite(founder) else []
    size, below = (4.4 + 1.5 * len(tracks), 5.6), int(is_narrow(_WIDTH_OF_PAGE) and WEIGHT in ds)
    plots = []
    if WEIGHT in ds:
        across, up = (_axis(ds, name, name.replace("_", " "), 7) for name in (WEIGHT, RATE))
        cloud = dots(_drawn(ds, WEIGHT)[0], _drawn(ds, RATE)[0], colour=FAINT, size=1.5)
        title = "" if mark else "no founder point"
        plots.append(Plot([cloud, *mark], across, up, title, (0, 0, 1, len(tracks) or 1) if below else (0, 0)))
    for k, name in enumerate(tracks, 1 - below):
        line = Line(_drawn(ds, name)[0], height, BIT, 0.6, marker=".", size=1.0)
        title = fill(name.replace("_", " ").replace("percussive specific", "percussive"), _TITLE_LETTERS)
        plots.append(Plot([line, *mark * (name == WEIGHT)], _axis(ds, name), down, title, (below, k)))
    about = margins(ds, point=LIMITS_OF_LOGS)
    if below:
        return Sheet(plots, (size[0], 1.5 * size[1]), heights=(1.0, 1.6), **about)
    return Sheet(plots, size, [2.4, *[1.0] * len(tracks)], **about)


def _axis(ds: xr.Dataset, name: str, text: str = "", intervals: int = 4) -> Axis:
    """Return an axis on which no spike flattens the other values; its label says how many are beyond."""
    values, unit = _drawn(ds, name)
    known = values[np.isfinite(values)]
    near, far = np.percentile(known, _TRIM)
    is_log = "energy" in name and near > 0 and known.max() > _LOG_SPAN * near
    low, high = max(known.min(), 2 * near - far), min(known.max(), 2 * far - near)
    margin = 0.06 * (high - low) or 0.05 * abs(high) or 1.0
    limits = (near / 2, known.max() * 1.3) if is_log else (low - margin, high + margin)
    beyond = int(((known < limits[0]) | (known > limits[1])).sum())
    label = " ".join(filter(None, (text, f"[{unit}]" if unit else "", f"\n{beyond} beyond" if beyond else "")))
    return Axis(label, name, limits, log=bool(is_log), intervals=intervals)


def _unit(ds: xr.Dataset, unit: str) -> tuple[float, str]:
    """Return factor and name of the unit in which values in an SI unit are drawn and printed."""
    return ({} if ds.attrs.get("drawn_in") == "si" else _DRILLERS).get(unit, (1.0, pretty_unit(unit)))


def _drawn(ds: xr.Dataset, name: str) -> tuple[Rows, str]:
    factor, unit = _unit(ds, str(ds[name].attrs.get("units", "1")))
    return ds[name].values * factor, unit


class Rigs(Analysis):
    """Compute specific energies, the founder point and stick-slip of a rig log, and draw tracks over depth."""

    kind = "rig"
    variables: ClassVar[dict[str, Variable]] = SCHEMA
    pictures = (PictureRule("a rig log", lambda held: "specific_energy" in held.variables, rig_picture),)

    def run(self, source: AnalysisSource, progress: bool = True) -> xr.Dataset:
        return rig(source)

    def page_cells(self, ds: xr.Dataset) -> tuple[xr.Dataset, None]:
        down, height = vertical(ds)
        units = {} if ds.attrs.get("drawn_in") == "si" else _DRILLERS
        rows = in_units(ds.drop_vars(down.name, errors="ignore"), units).rename(row=POINT)
        return rows.assign_coords({down.name: (POINT, height, {"units": "m" * (down.name == "depth")})}), None

    def page_text(self, ds: xr.Dataset) -> list[SummaryPart]:
        return self.summary(ds)[::-1]

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        reason, (factor, unit) = FOUNDER_REASONS[int(ds["founder_reason"])], _unit(ds, "N")
        founder, does = float(ds["founder_weight"]), "falls" if float(ds["slope_above"]) < 0 else "does not rise"
        lines = [f"founder point at a weight of {factor * founder:.4g} {unit}; above it the rate {does}"]
        lines = lines if reason == "found" else [f"no founder point: {_NO_FOUNDER[reason]}"]
        facts: dict[str, object] = {"founder_weight": founder, "founder_reason": reason}
        for name in _NEEDED:
            values, unit = _drawn(ds, name)
            if known := np.isfinite(values).any():
                low, middle, high = np.nanquantile(values, [0.1, 0.5, 0.9])
                about = f"median {middle:.4g}, 80 % from {low:.4g} to {high:.4g} {unit}"
                lines.append(f"{name.replace('_', ' ')}: {about}".rstrip())
            facts[name] = float(np.nanmedian(ds[name].values)) if known else None
        unknown = [part for part in text_of(ds, "notes").split("; ") if " is not known: " in part]
        read = [line for line in log_lines(ds) if line not in unknown]
        return [SummaryPart("log", read, {}), SummaryPart("rig", [*lines, *unknown, LIMITS_OF_LOGS], {"rig": facts})]
