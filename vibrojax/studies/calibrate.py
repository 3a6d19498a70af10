"""The analysis `calibrate`: the searches, the uncertainty of the best estimate, its dataset, picture and summary."""

from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.compile.xla import precision
from vibrojax.errors import Place, counted
from vibrojax.io.attributes import flags, text_of
from vibrojax.io.variables import VARIABLES
from vibrojax.pictures.axes import SUPERSCRIPTS, margins, pretty_unit, scale, symbols_of, with_unit
from vibrojax.pictures.plots import FAINT, Axis, Bars, Layer, Line, Look, Plot, Sheet, dots, level, upright
from vibrojax.pictures.style import BIT, IMPACT, other_colour
from vibrojax.progress import Progress
from vibrojax.studies.analysis import PictureRule, SummaryPart, checked_result
from vibrojax.studies.calibration_estimate import CALIBRATION_VARIABLES, VAGUE, estimated
from vibrojax.studies.calibration_file import LAW, Calibration, read_calibration
from vibrojax.studies.calibration_history import VELOCITY
from vibrojax.studies.calibration_model import CONSTANT, RATE, SCREENED, Fit, Model, fit_from, starts
from vibrojax.studies.subjects import FileAnalysis

MIN_EXPONENT = 0.1  # exponent in a combination below which the summary leaves a parameter out
WELL_DETERMINED = 0.1  # nonlinearity up to which the summary trusts standard errors and posterior
LARGE_RESIDUAL = 2.0  # root mean square of the residuals, in standard errors, above which the summary doubts the model

_MARKS = ("o", "s", "^", "D", "v", "P", "X", "<")


ERROR_MODELS = {
    "history": "all samples have the same error (normal), which the residuals give; 95 % intervals by Student's t with "
    "{freedom} degrees of freedom",
    "relative": "all values have the same relative error (normal, proportional to the predicted value), which the "
    "residuals give; 95 % intervals by Student's t with {freedom} degrees of freedom",
    "given": "normal errors with the standard errors given; 95 % intervals by the normal distribution",
}
"""Error models without standard errors of the observations, for a history and for rows, and with them."""


_MOST_ROW_TICKS, _MANY_ROWS = 8, 40  # observations that each have a tick, and from which on marks are small


def calibration_picture(ds: xr.Dataset) -> Sheet:
    """Draw what was measured over the model, the residuals, the posterior of the first two parameters, combinations.

    What was measured and the model are relative to the mean of each variable.
    """
    layers: list[Layer] = [level(0.0, width=0.6)]
    compared: list[Layer] = [Line([-1e3, 1e3], [-1e3, 1e3], FAINT, 0.8, label="measured = model", order=1.0)]
    for k, name in enumerate(str(x) for x in ds["of"].values):
        observed, model, values = (ds[key].values[:, k] for key in ("observed", "predicted", "residual"))
        look: Look = {"marker": _MARKS[k % len(_MARKS)], "colour": other_colour(k), "label": name.replace("_", " ")}
        look |= {"size": 2.0} if len(values) > _MANY_ROWS else {}
        layers.append(dots(ds["observation"].values, values, **look))
        mean = float(np.nanmean(np.abs(observed))) or 1.0
        compared.append(dots(100 * (model / mean - 1), 100 * (observed / mean - 1), **look))
    found = np.concatenate([layer.y for layer in compared[1:] if isinstance(layer, Line)])
    room = 0.08 * float(np.ptp(found[np.isfinite(found)])) or 1.0
    ends = float(np.nanmin(found)) - room, float(np.nanmax(found)) + room
    across, up = (Axis(f"{word} [% from the mean]", limits=ends, intervals=5) for word in ("model", "measured"))
    numbers = ds["observation"].values
    rows = Axis(str(ds["observation"].attrs.get("long_name", "observation")), intervals=4)
    if len(numbers) <= _MOST_ROW_TICKS:
        rows = replace(rows, ticks=[(float(k), str(k)) for k in numbers])
    plots = [
        Plot(compared, across, up, "measured and model"),
        Plot(layers, rows, Axis("residual [standard errors]"), "residuals"),
        _posterior_plot(ds),
        *([_combination_plot(ds)] if ds.sizes["parameter"] > 1 else []),
    ]
    plots = [replace(plot, place=(0, k)) for k, plot in enumerate(plots)]
    size, widths = (2.0 + 2.9 * len(plots), 3.6), (1.0,) * len(plots)
    return Sheet(plots, size, widths, beside=False, **margins(ds, point="; ".join(_estimates(ds))))


def _posterior_plot(ds: xr.Dataset) -> Plot:
    scales = [scale(_value(ds, k)) for k in range(ds.sizes["parameter"])]
    axes = [Axis(with_unit(sign, unit), intervals=5) for sign, (_, unit) in zip(_signs(ds), scales, strict=True)]
    factors = np.array([factor for factor, _ in scales])
    draws, estimate = ds["posterior"].values * factors, ds["estimate"].values * factors
    if len(axes) == 1:
        counts, ends = np.histogram(draws[:, 0], 30)
        bars = Bars(ends[:-1], np.zeros(30), np.diff(ends), counts)
        layers: list[Layer] = [bars, upright(estimate[0], colour=IMPACT)]
        return Plot(layers, axes[0], Axis("draws of the posterior", limits=(0.0, None)), "posterior")
    layers = [
        dots(draws[:, 0], draws[:, 1], colour=BIT, size=1.0, alpha=0.4, label="draws"),
        dots(estimate[:1], estimate[1:2], marker="*", colour=IMPACT, size=10.0, order=3.0, label="estimate"),
    ]
    return Plot(layers, axes[0], axes[1], "posterior")


def _combination_plot(ds: xr.Dataset) -> Plot:
    errors = np.clip(100 * ds["direction_error"].values, 1e-6, 1e4)
    rows = np.arange(len(errors), dtype=float)
    log = bool(errors.max() > 10 * errors.min())
    begin = np.full(len(errors), 0.5 * errors.min() if log else 0.0)
    across = Axis("relative standard error [%]", limits=(float(begin[0]), None), log=log, intervals=5)
    up = Axis(ticks=[(row, _combination(ds, int(row))) for row in rows.tolist()], reversed=True)
    known = errors < 100 * VAGUE
    layers = [
        Bars(begin[k], rows[k] - 0.25, (errors - begin)[k], np.full(k.sum(), 0.5), colour, label=text)
        for k, colour, text in ((known, BIT, "determined"), (~known, FAINT, "vague"))
        if k.any()
    ]
    return Plot(layers, across, up, "combinations of parameters")


def _signs(ds: xr.Dataset) -> list[str]:
    signs = symbols_of(ds)
    return [signs.get(name, name) for name in map(str, ds["parameter"].values)]


def _value(ds: xr.Dataset, k: int) -> xr.DataArray:
    return xr.DataArray(ds["estimate"].values[k], attrs={"units": str(ds["parameter_unit"].values[k])})


def _estimates(ds: xr.Dataset) -> list[str]:
    """Return each parameter with its estimate, its 95 % interval and its unit, or as a value at a bound."""
    lines, reasons = [], flags(ds["reason"])
    columns = ("estimate", "estimate_stderr", "estimate_low", "estimate_high", "low", "high")
    for k, name in enumerate(_signs(ds)):
        factor, unit = scale(_value(ds, k))
        x, error, low, high, least, greatest = (factor * float(ds[column][k]) for column in columns)
        unit = pretty_unit(unit)
        if reasons[int(ds["reason"][k])] == "at-bound":
            end = "lower" if x - least < greatest - x else "upper"
            lines.append(f"{name} = {f'{x:.4g} {unit}'.rstrip()}, at its {end} bound: no interval follows")
            continue
        # The ends of the interval differ in their last two digits.
        digits = min(max(4, 2 + int(np.log10(max(abs(x), error) / error))), 12) if error > 0 else 4
        line = f"{name} = {x:.{digits}g} ± {error:.2g} {unit}".rstrip()
        lines.append(f"{line}, 95 %: {low:.{digits}g} to {high:.{digits}g}")
    return lines


def _combination(ds: xr.Dataset, k: int) -> str:
    """Return a combination as a product of powers, or as a sum if a parameter may be negative."""
    powers, parts = bool((ds["low"].values > 0).all()), []
    for name, x in zip(_signs(ds), ds["direction"].values[k], strict=True):
        if abs(x) >= MIN_EXPONENT:
            power = "" if abs(x - 1) < 0.05 else f"{x:.1f}".translate(SUPERSCRIPTS)
            parts.append(name + power if powers else f"{x:+.1f} {name}".replace("-", "−"))
    return " ".join(parts)


class Calibrations(FileAnalysis[Calibration]):
    """Estimate parameters of a drill from observations of its motion, and state which of them the data determine."""

    kind = "calibration"
    variables = CALIBRATION_VARIABLES
    pictures = (PictureRule("a calibration", lambda held: "posterior" in held.variables, calibration_picture),)
    view = "plots"

    command = "calibrate"
    about = (
        "a calibration: the path of a TOML file with scene, data (a CSV of operating conditions and observations) or "
        "history (a CSV of the bit's velocity over time), [unknown] NAME = [low, high] and, as needed, start, "
        "[parameters], [error], [prior]"
    )
    columns = 'columns of the history and their units, such as time="t (ms)" v1="bit speed (mm/s)"'

    def asked(self, file: Any, columns: Mapping[str, str] | None = None) -> Calibration:
        return read_calibration(file, columns)

    def identity(self, spec: Calibration) -> dict[str, object]:
        problem = spec.problem
        times = {} if problem.history is None else {"time": problem.history.times}
        tables = problem.conditions | dict(zip(problem.of, problem.values.T, strict=True)) | times
        data = {f"data.{name}": x.tolist() for name, x in tables.items()}
        return {"calibration": True, "specification": spec.origin.text} | data

    def compute(self, spec: Calibration, progress: bool = True) -> xr.Dataset:
        problem, searches, name = spec.problem, spec.file.searches, spec.origin.file
        with precision("float64"), Progress(searches, "searches", progress, pace=False) as bar:
            begins = starts(problem)
            if not begins:
                where = f"at any of {SCREENED} points inside the bounds"
                advice = "choose narrower bounds around plausible values, or another start"
                raise Place(name).error(f"no observation has a stable orbit from the start {where}; {advice}")
            fits = []
            for theta, row in begins[:searches]:
                model = Model(problem, theta, row)
                fits.append((fit_from(problem, model, theta), model))
                bar.add(1)
            fit, model = min(fits, key=lambda pair: pair[0].score)
            used = fit.used
            if fault := problem.shortage(used):
                orbits = f"{used.sum()} of {counted(len(used), 'observation')} {'has' if used.sum() == 1 else 'have'}"
                why = f"{orbits} an orbit of one kind inside the bounds: {fault}"
                raise Place(name).error(f"{why}; narrower bounds, another start or more searches may find others")
            return self._dataset(spec, model, fit)

    def _dataset(self, spec: Calibration, model: Model, fit: Fit) -> xr.Dataset:
        problem, history = spec.problem, spec.problem.history
        given, count, freedom = problem.errors is not None, problem.parameters, fit.freedom
        names = problem.names[:count]
        table = estimated(spec.origin.file, problem, model, fit, spec.file.draws)
        if CONSTANT in names:
            rate = table["predicted"][:, problem.of.index(RATE)]
            if not (rate > 0).any():
                fault = "the law C ln(P/D) gives no rate up to P/D = 1, and P/D is below at every observation"
                raise Place(spec.origin.file).error(f"{fault}; vibrojax fit has forms with an onset")
        system = problem.point.system
        parameters = {**system.parameters(), CONSTANT: LAW}
        units = {name: about.units for name, about in VARIABLES.items()} | {VELOCITY: "m s-1"}
        of_rows = "line of the file" if problem.labels[0] else "row of the table, from 0"
        numbered = of_rows if problem.rows else "sample of the history"
        coords: dict[str, Any] = {
            "parameter": [*names],
            "other": [*names],
            "of": [*problem.of],
            "observation": ("observation", problem.labels, {"units": "1", "long_name": numbered}),
            "parameter_unit": ("parameter", [parameters[name].unit for name in names]),
            "parameter_long_name": ("parameter", [parameters[name].long_name for name in names]),
            "of_unit": ("of", [units[name] for name in problem.of]),
        }
        for name, x in problem.conditions.items():
            meaning = {"units": parameters[name].unit, "long_name": parameters[name].long_name}
            if history is not None:
                x = np.append(x, np.full(len(history.times), history.point.parameters[name]))
            coords[name] = ("observation", x, meaning)
        if history is not None:
            times = np.append(np.full(problem.rows, np.nan), history.begin + history.times)
            meaning = {"units": "s", "long_name": "time of a sample of the history"}
            coords["time"] = ("observation", times, meaning)
        if history is not None and history.states:
            coords["state"] = [*history.states]
            coords["state_unit"] = ("state", [system.states[system.place(name)].unit for name in history.states])
            meaning = {"long_name": "state at the first sample of the history, in its own unit"}
            table["first_state"] = ("state", fit.theta[count:], meaning)
        title = str(spec.file.title or f"Calibration of {', '.join(parameters[name].symbol for name in names)}")
        errors = ERROR_MODELS["given" if given else "relative" if history is None else "history"]
        about: dict[str, Any] = {"scene": problem.point.scene, "specification": spec.origin.text}
        about |= {"searches": spec.file.searches, "error_model": errors.format(freedom=freedom)}
        return self.dataset(table, coords, title=title, **about)

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        reasons = [flags(ds["reason"])[int(flag)] for flag in ds["reason"].values]
        both = zip(_estimates(ds), reasons, strict=True)
        lines = [f"{text} ({reason})".removesuffix(" (identified)") for text, reason in both]
        errors = ds["direction_error"].values
        if "confounded" in reasons:
            texts = [f"{_combination(ds, k)} to {_percent(float(e))}" for k, e in enumerate(errors) if e < VAGUE]
            determined = f"{', '.join(texts)}, and not the parameters by themselves" if texts else "no parameter"
            lines.append(f"the data determine {determined}")
        elif "at-bound" in reasons:
            lines.append("the data suggest values beyond a bound; widen the bounds, or examine the model")
        used = int(ds["used"].sum())
        size, freedom = ds.sizes["observation"], int(ds["freedom"])
        others = "; the others have no stable orbit of this kind near the estimate" if used < size else ""
        lines.append(f"{used} of {counted(size, 'observation')} used{others}")
        lines.append(f"error model: {text_of(ds, 'error_model')}")
        if np.isfinite(ds["noise"]):
            lines.append(f"the observations scatter by {_percent(float(ds['noise']))} around the model")
        elif freedom > 0:
            rms = float(np.sqrt(ds["chi_squared"] / freedom))
            doubt = ": the model, the motion or the errors are wrong" if rms > LARGE_RESIDUAL else ""
            lines.append(f"the residuals are {rms:.3g} standard errors{doubt}")
        nonlinearity = float(ds["nonlinearity"])
        if nonlinearity > WELL_DETERMINED:
            text = f"over the posterior the motion differs by {_percent(nonlinearity)} from a linear prediction"
            lines.append(f"{text}; standard errors are rough")
        columns = [ds[f"estimate{end}"].values.tolist() for end in ("", "_stderr", "_low", "_high")]
        parameters = {
            str(name): {"estimate": x, "stderr": error, "interval": [low, high], "reason": reason}  # NaN at a bound
            for name, x, error, low, high, reason in zip(ds["parameter"].values, *columns, reasons, strict=True)
        }
        facts = {
            "parameters": parameters,
            "combinations": {_combination(ds, k): float(errors[k]) for k in range(len(errors))},
            "used": used,
            "error_model": text_of(ds, "error_model"),
            "noise": float(ds["noise"]),
            "nonlinearity": nonlinearity,
        }
        return [SummaryPart("calibration", lines, {"calibration": facts})]


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"


def calibrate(source: str | PathLike[str] | Mapping[str, object], progress: bool = True) -> xr.Dataset:
    """Estimate parameters of a drill from observations of its motion.

        runs = {"v": [1.2, 1.5, 1.8], "period": [...], "impact_velocity": [...]}
        fit = vj.calibrate({"scene": "vibro-impact", "start": "stuck", "data": runs, "unknown": {"mu": [0.2, 0.6]}})

    Each observation is one row of a table: operating conditions, which are parameters of the scene, and observed
    variables of the orbit (period, forces, velocities, powers, rates). Each search begins with the best of several
    sampled motions, whose orbit is continued to the operating conditions of each row. SciPy's `least_squares` minimises
    the residuals, with derivatives of the orbits through all impacts and stick phases. Rows without a stable orbit at
    the end of a search are left out. Of several searches, the result with the greatest likelihood is kept.

    The data may also be a recording of the bit's velocity over time, instead of rows or in addition to rows. A
    recording is compared with a simulated motion, whose initial state is estimated too, unless it is given.

        vj.calibrate({"scene": "rotary", "history": "bit.csv", "unknown": {"mu": [0.1, 0.8], "v_cr": [1.0, 6.0]}})

    **Arguments:** `source`: path of a TOML file, or a dict. It has these entries:

    - `scene`, `start`, `[parameters]`: as in `simulate`.
    - `data`: path of a CSV file or, in a dict, a table. The headers are names of parameters and variables, with units
      as in `peak_impact_force (kN)`; columns `NAME_error` hold standard errors. In the scene `drilling`, `C` [m/s] may
      be unknown too; `rate_of_penetration` is then C ln(relief).
    - `history`: a recording, as a dataset of `simulate`, a table, or the path of a CSV or NetCDF file. A recording has
      the columns `time` [s] and `v1` [m/s], the velocity of the bit relative to the drive; headers may have other
      units, as in `v1 (mm/s)`. Columns `x1`, `x2` and `v2` are initial guesses for the first state. A recording may
      also be the entry `data` of a table `[history]`, which may have `columns` (NAME = COLUMN), `window` (begin and end
      [s]), `start` (the state at the first sample) and operating conditions.
    - `[unknown]` has NAME = [low, high] for each parameter to estimate; `[prior]` has NAME = [mean, standard
      deviation]; `[error]` has NAME = standard error of a variable. If no standard errors are given, all observed
      values have the same relative error, which is estimated from the residuals.
    - `searches`: number of searches, by default 3. `draws`: number of draws from the posterior, by default 1000.
      `seed`: by default 0. `title`.

    **Returns:** a dataset. Variables along `parameter` are `estimate`, `estimate_stderr`, the 95 % interval from
    `estimate_low` to `estimate_high`, and `reason`. Further variables are the `correlation` of parameters, combinations
    of parameters (`direction`) with their errors, draws from the `posterior`, and the estimated `first_state`.
    Variables along `observation` are `observed`, `predicted`, `residual`, `used` (1 or 0), and the `time` of samples of
    a recording.

    **Raises:** `InputError` if the input is invalid, if too few observations have a stable orbit, or if no search
    converges.

    **Example:**

    >>> runs = {"v": [1.2, 1.5, 1.8], "period": [0.230586, 0.229602, 0.228930]}  # of the orbits at beta = 0.4
    >>> about = {"scene": "vibro-impact", "start": "stuck", "parameters": {"delta": 0.005, "gamma": 0.75}}
    >>> fit = vj.calibrate({**about, "data": runs, "unknown": {"beta": [0.3, 0.5]}, "searches": 1}, progress=False)
    >>> f"{float(fit.estimate[0]):.2f}"
    '0.40'
    """
    analysis = Calibrations()
    return checked_result(analysis, analysis.run(source, progress))
