"""Measures of rig logs: specific energies, the founder point, and the stick-slip index from torque."""

from collections.abc import Mapping
from os import PathLike
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float
from scipy.stats import f as f_distribution

from vibrojax.errors import InputError
from vibrojax.io.kinds import dataset_attributes
from vibrojax.io.log_columns import LINE
from vibrojax.io.riglog import read_log
from vibrojax.io.variables import Variable

MIN_ROWS = 30
"""Least number of rows from which a founder point is sought."""

INSIDE = (0.1, 0.9)
"""Quantiles of the weight between which the founder point is sought, so that each line has rows."""

CANDIDATES = 81
"""Number of weights at which the bend of the two lines is tried."""

FLATTER = 0.5
"""Ratio of the slopes above and below a bend up to which it counts as a founder point."""

SIGNIFICANCE = 0.01
"""Probability of a bend that good by chance, from neighbours that are correlated, up to which it counts."""

WINDOW = 30.0
"""Length [s] of the windows of the stick-slip index from torque: several periods of a drill string's torsion."""

SLOWEST_SAMPLING = 2.0
"""Longest time [s] between rows for that index. Rarer rows miss the torque's extremes within a period."""

FOUNDER_REASONS = ("found", "no-bend", "too-few-rows", "no-weight")
_ROW: tuple[str, ...] = ("row",)

SCHEMA: dict[str, tuple[tuple[str, ...], Variable]] = {
    "specific_energy": (_ROW, Variable("J m-3", "mechanical specific energy W/A + omega T/(A R) (Teale 1965)")),
    "percussive_specific_energy": (_ROW, Variable("J m-3", "power of the impacts over volume drilled per second")),
    "torque_stick_slip": (
        _ROW,
        Variable("1", "stick-slip index (Tmax - Tmin)/(2 Tmean) of the surface torque over 30 s around the row"),
    ),
    "founder_weight": ((), Variable("N", "weight on bit above which the rate rises less: founder point")),
    "slope_below": ((), Variable("m s-1 N-1", "rate per weight below the founder point, or everywhere")),
    "slope_above": ((), Variable("m s-1 N-1", "rate per weight above the founder point")),
    "founder_reason": ((), Variable("1", "whether there is a founder point", np.int8, FOUNDER_REASONS)),
}

Rows = Float[np.ndarray, " rows"]


def rig(
    source: str | PathLike[str] | xr.Dataset,
    *,
    dialect: str | None = None,
    columns: Mapping[str, str] | None = None,
) -> xr.Dataset:
    """Compute from a rig log what drilling engineers look at: specific energies, founder point, stick-slip.

        log = vj.rig("log.csv", columns={"bit_diameter": "8.5 in"})
        vj.picture(log)

    With the weight W [N], the rotary speed omega [rad/s], the torque T [N m], the rate R [m/s] and the area A of a bit
    of the given diameter, the mechanical specific energy is W/A + omega T/(A R) (Teale 1965). In field units this is 4
    WOB/(pi D²) + 480 TOR RPM/(D² ROP). The percussive one is the power of the impacts over A R. It needs the column or
    value `impact_power`, which rotary rigs do not have.

    The founder point is the bend of two connected lines, rate over weight, fitted by least squares. It counts if the
    rate rises less than half as fast above it, and if an F test finds it significant at 1 % for the number of
    independent rows, n (1 - r)/(1 + r) with the correlation r of neighbouring residuals. A concave law, such as C
    ln(P/D), bends as well: compare the forms of the law by [vibrojax.fit_rop][] before a bend is called foundering.

    At least three definitions of the stick-slip index are in use. `torque_stick_slip` is (Tmax - Tmin)/(2 Tmean) of the
    surface torque. A `stick_slip_index` of the log is kept as given.

    **Arguments:** `source`: path of a log as in [vibrojax.read_log][], or its result; `dialect`, `columns`: as there.

    **Returns:** the log with `specific_energy`, `percussive_specific_energy` [J/m³] and `torque_stick_slip` along
    `row`, where its columns allow them (else NaN; `notes` says why), `founder_weight` [N], `slope_below`, `slope_above`
    and `founder_reason`.

    **Raises:** `InputError`.

    **Example:**

    >>> import pandas as pd
    >>> table = pd.DataFrame({"WOB (kN)": [100, 120], "RPM (rpm)": 120, "Torque (kN.m)": 5, "ROP (m/h)": [18, 20]})
    >>> log = vj.rig(vj.read_log("export", table=table, columns={"bit_diameter": "8.5 in"}))
    >>> (log.specific_energy / 1e6).values.round().tolist()  # MPa
    [346.0, 312.0]
    """
    log = source if isinstance(source, xr.Dataset) else read_log(source, dialect=dialect, columns=columns)
    # Names of other columns may hold what a netCDF file does not accept.
    log = log.drop_vars([name for name in log.coords if name != LINE])
    if "rate_of_penetration" not in log:
        raise InputError("rig: the log has no rate of penetration; name its column by columns")
    none = np.full(log.sizes["row"], np.nan)
    columns_of = {str(name): log[name].values.astype(float) for name in log.data_vars if log[name].dims == ("row",)}
    rate, area = columns_of["rate_of_penetration"], np.pi / 4 * columns_of.get("bit_diameter", none) ** 2
    weight, torque = (columns_of.get(name, none) for name in ("weight_on_bit", "torque"))
    speed, power = (columns_of.get(name, none) for name in ("rotary_speed", "impact_power"))
    with np.errstate(divide="ignore", invalid="ignore"):
        energies = {
            "specific_energy": np.where(rate > 0, weight / area + speed * torque / (area * rate), np.nan),
            "percussive_specific_energy": np.where(rate > 0, power / (area * rate), np.nan),
        }
    founder = founder_point(weight, rate)
    index = torque_stick_slip(columns_of.get("time", none), torque)
    values: dict[str, object] = {**energies, "torque_stick_slip": index, **founder._asdict()}
    notes = [str(log.attrs.get("notes", ""))] if log.attrs.get("notes") else []
    needed = {
        "specific_energy": ("weight_on_bit", "rotary_speed", "torque", "bit_diameter"),
        "percussive_specific_energy": ("impact_power", "bit_diameter"),
        "torque_stick_slip": ("time", "torque"),
    }
    for name, names in needed.items():
        if missing := [column for column in names if column not in columns_of]:
            hint = ', which columns may give, like bit_diameter="8.5 in"' * ("bit_diameter" in missing)
            notes.append(f"{name} is not known: the log has no {' and no '.join(missing)}{hint}")
        elif name == "torque_stick_slip" and not np.isfinite(index).any():
            notes.append(f"{name} is not known: rows are more than {SLOWEST_SAMPLING:g} s apart")
    table = {
        name: (dims, np.asarray(values[name], about.dtype), about.attributes())
        for name, (dims, about) in SCHEMA.items()
    }
    title = str(log.attrs.get("title", "rig log"))
    return log.assign(table).assign_attrs(
        log.attrs | dataset_attributes("rig", title, "rig") | {"notes": "; ".join(notes)}
    )


class Founder(NamedTuple):
    """The bend of two connected lines, rate over weight; the weight and the second slope are NaN without a bend."""

    founder_weight: float
    slope_below: float
    slope_above: float
    founder_reason: int


def founder_point(weight: Rows, rate: Rows) -> Founder:
    """Return the founder point of rates [m/s] over weights [N]; rows are in order of depth."""
    known = np.isfinite(weight) & np.isfinite(rate)
    nothing = Founder(np.nan, np.nan, np.nan, FOUNDER_REASONS.index("no-weight"))
    if not known.any():
        return nothing
    if known.sum() < MIN_ROWS or np.ptp(weight[known]) == 0:
        return nothing._replace(founder_reason=FOUNDER_REASONS.index("too-few-rows"))
    x, y = weight[known] / np.abs(weight[known]).max(), rate[known]
    scale = float(np.abs(weight[known]).max())

    def fit(bend: float | None) -> tuple[np.ndarray, np.ndarray]:
        columns = [np.ones_like(x), x] + ([] if bend is None else [np.maximum(x - bend, 0.0)])
        matrix = np.stack(columns, axis=1)
        coefficients = np.linalg.lstsq(matrix, y)[0]
        return coefficients, y - matrix @ coefficients

    line, off = fit(None)
    low, high = np.quantile(x, INSIDE)
    bends = np.linspace(float(low), float(high), CANDIDATES)
    fits = [fit(float(bend)) for bend in bends]
    best = int(np.argmin([residual @ residual for _, residual in fits]))
    coefficients, residual = fits[best]
    below, above = float(coefficients[1]), float(coefficients[1] + coefficients[2])
    correlation = float(np.clip(residual[1:] @ residual[:-1] / max(residual @ residual, 1e-300), 0.0, 0.99))
    freedom = len(x) * (1 - correlation) / (1 + correlation) - 4
    gain = (off @ off - residual @ residual) / 2 / max(residual @ residual / max(freedom, 1e-9), 1e-300)
    chance = f_distribution.sf(gain, 2, freedom) if freedom > 1 else 1.0
    if not (below > 0 and above <= FLATTER * below and chance <= SIGNIFICANCE):
        return Founder(np.nan, float(line[1]) / scale, np.nan, FOUNDER_REASONS.index("no-bend"))
    return Founder(float(bends[best]) * scale, below / scale, above / scale, FOUNDER_REASONS.index("found"))


def torque_stick_slip(time: Rows, torque: Rows) -> Rows:
    """Return (Tmax - Tmin)/(2 Tmean) over `WINDOW` around each row; NaN where rows are too far apart."""
    result = np.full(len(time), np.nan)
    if len(time) < 2 or not np.isfinite(time).all():
        return result
    begins = np.searchsorted(time, time - WINDOW / 2)
    ends = np.searchsorted(time, time + WINDOW / 2, side="right")
    for row, (begin, end) in enumerate(zip(begins, ends, strict=True)):
        part, times = torque[begin:end], time[begin:end]
        full = times[-1] - times[0] >= 0.8 * WINDOW and np.diff(times).max(initial=0.0) <= SLOWEST_SAMPLING
        if full and np.isfinite(part).all() and part.mean() > 0:
            result[row] = np.ptp(part) / (2 * part.mean())
    return result
