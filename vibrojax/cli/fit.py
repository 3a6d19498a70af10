"""Fit the rate-of-penetration law to a sweep's dataset or to rig data.

A CSV needs the columns relief (or mean_force and threshold) and rate_of_penetration, in SI units; further columns may
tell groups of rows apart.
"""

import math
from argparse import ArgumentParser
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from vibrojax.analyses.glossary import WORDS
from vibrojax.cli.completion import files, with_completer
from vibrojax.cli.output import JSON_HELP, Options, dataset_written, draw, output, picture_beside, print_json
from vibrojax.errors import InputError
from vibrojax.progress import timed

if TYPE_CHECKING:
    import xarray

_GROUPS_SHOWN = 12


def arguments(parser: ArgumentParser) -> None:
    """Add the command's arguments to `parser`."""
    file = parser.add_argument(
        "file",
        metavar="FILE",
        nargs="?",
        help="a sweep's .nc, or a CSV with columns relief (P/D, mean force over the force at which the rock yields) "
        "and rate_of_penetration, or others that --columns names",
    )
    with_completer(file, files(".nc", ".csv"))
    parser.add_argument("--along", metavar="AXIS", help="the axis to fit along (frequency, else v; of a CSV: its rows)")
    parser.add_argument(
        "--columns",
        metavar="NAME=COLUMN",
        nargs="+",
        action="extend",
        help="of a CSV: which column is what, in which unit, like "
        'rate_of_penetration="ROP (m/h)" mean_force="WOB (kN)", or one value for all rows, like threshold="150 kN"',
    )
    parser.add_argument("--by", metavar="COLUMN", action="append", help="of a CSV: fit the rows of each of its values")
    parser.add_argument("--json", action="store_true", help=JSON_HELP)
    parser.add_argument("-o", dest="out", metavar="FIT.nc", help="where to write (FILE-fit.nc in this folder)")


def run(options: Options) -> None:
    """Run the command."""
    words = list(options.columns or [])
    if options.file is None and words and "=" not in words[-1]:
        options.file = words.pop()  # it may stand behind the columns too
    if options.file is None:
        raise InputError("fit: the following arguments are required: FILE; see vibrojax fit --help")
    out = output(options.out or f"{Path(options.file).stem}-fit.nc")
    picture = picture_beside(out)
    from vibrojax.analyses.rop_law import fit_rop, verdict
    from vibrojax.analyses.rop_law.columns import columns_lines, read_columns
    from vibrojax.io.dataset import write_dataset

    with timed("read and fit"):
        fit = fit_rop(options.file, options.along, options.by or (), progress=False, columns=read_columns(words))
    with timed("write"):
        write_dataset(fit, out)
    dataset_written(options, out)
    drawn = draw(fit, picture)
    if options.json:
        print_json(_facts(fit, options.file, out, picture if drawn else None))
        return
    taken = columns_lines(fit)
    before = [*taken, ""] if taken and not options.quiet else []
    after = [] if options.quiet else [f"{out}{drawn}"]
    print("\n".join([*before, *tables(fit), "", *_legend(fit), "", *verdict(fit), *after]))


def _legend(fit: "xarray.Dataset") -> list[str]:
    """What stands in the table."""
    lane = "a row of the CSV" if "columns" in fit.attrs else WORDS["lane"]
    return [
        f"forms of the rate of penetration: {fit.attrs['formulas']}",
        f"eta: the relief P/D, {WORDS['relief P/D']}; eta0: where it begins; a lane: {lane}",
        "AIC: by how much a form describes the data better (lower is better, by 2 or more clearly so)",
    ]


def _facts(fit: "xarray.Dataset", file: str, out: Path, picture: Path | None) -> dict[str, object]:
    """What `--json` prints: of each group its coordinates, and of each form its coefficients and why one is null."""
    import numpy as np

    from vibrojax.analyses.rop_law import table, verdict
    from vibrojax.analyses.trajectory.analysis import features
    from vibrojax.io.attributes import table_of

    names, _ = table(fit, "aic")
    dims = [dim for dim in fit["aic"].dims if dim != "form"]
    where = list(np.ndindex(*(fit.sizes[dim] for dim in dims)))
    of_forms = [str(name) for name, one in fit.data_vars.items() if set(one.dims) == {*dims, "form"}]
    groups = []
    for name, index in zip(names, where, strict=True):
        fit_of_group = fit.isel(dict(zip(dims, index, strict=True)))
        scalars = {str(name): data for name, data in fit_of_group.coords.items() if data.ndim == 0}
        coordinates = {name: data.item() for name, data in scalars.items()}
        forms = {str(form): features(fit_of_group.sel(form=form)[of_forms]) for form in fit["form"].values}
        groups.append({"name": name, "coordinates": coordinates, "forms": forms})
    return {
        "file": file,
        "along": fit.attrs["along"],
        "columns": table_of(fit, "columns") or None,
        "groups": groups,
        "verdict": verdict(fit),
        "dataset": str(out),
        "picture": None if picture is None else str(picture),
    }


def tables(fit: "xarray.Dataset") -> list[str]:
    """A table of the forms for each of the first groups of lanes, and how many there are more."""
    from vibrojax.analyses.rop_law import table

    names = ("C", "C_stderr", "eta0", "eta0_stderr", "exponent", "exponent_stderr", "r_squared", "aic", "used")
    values = {name: table(fit, name)[1] for name in (*names, "left_out", "reason", "r_squared_reason")}
    groups = table(fit, "aic")[0]
    meanings = str(fit["reason"].attrs["flag_meanings"]).split()
    lines: list[str] = []
    for group, name_of_group in enumerate(groups[:_GROUPS_SHOWN]):
        row = {name: column[group] for name, column in values.items()}
        left_out = f", {row['left_out'][0]} left out" if row["left_out"][0] else ""
        lines += [""] * bool(lines) + [f"{name_of_group}: {row['used'][0]} lanes along {fit.attrs['along']}{left_out}"]
        lines.append(f"  {'form':<9}{'C [m/s]':<24}{'eta0':<22}{'exponent':<20}{'R2':>8}{'AIC':>10}")
        for index, form in enumerate(fit["form"].values):
            at = {name: column[index] for name, column in row.items()}
            notes = [meanings[int(at[name])] for name in ("reason", "r_squared_reason")]
            lines.append(f"  {form:<9}{_row(at, notes)}".rstrip())
    return lines + ([f"and {len(groups) - _GROUPS_SHOWN} groups more"] if len(groups) > _GROUPS_SHOWN else [])


def _row(at: Mapping[str, float], reasons: list[str]) -> str:
    """Return a form's coefficients with standard errors and the reasons for what is missing."""
    if not math.isfinite(at["C"]):
        return reasons[0]
    cells = [_with_error(at["C"], at["C_stderr"]), _with_error(at["eta0"], at["eta0_stderr"])]
    cells.append(_with_error(at["exponent"], at["exponent_stderr"]))
    text = f"{cells[0]:<24}{cells[1]:<22}{cells[2]:<20}{at['r_squared']:>8.4f}{at['aic']:>10.2f}"
    notes = ", ".join(reason for reason in reasons if reason != "identified")
    return f"{text}  {notes}" if notes else text


def _with_error(value: float, error: float) -> str:
    """A coefficient and its standard error; nothing where the form has none."""
    return f"{value:.4g} ± {error:.2g}" if math.isfinite(value) else ""
