"""Fit the rate-of-penetration law to a sweep's dataset or to rig data.

A CSV file needs the columns relief (or mean_force and threshold) and rate_of_penetration, in SI units; further columns
may distinguish groups of rows.
"""

from argparse import ArgumentParser
from pathlib import Path
from typing import TYPE_CHECKING

from vibrojax.analyses.glossary import WORDS
from vibrojax.cli.completion import add_argument, files
from vibrojax.cli.output import Options, ResultFiles, add_json, draw, file_facts, output, picture_beside, print_json
from vibrojax.errors import InputError
from vibrojax.progress import timed

if TYPE_CHECKING:
    import xarray


def arguments(parser: ArgumentParser) -> None:
    about = "a sweep's .nc, or a CSV with columns relief (P/D, mean force over the force at which the rock yields) "
    about += "and rate_of_penetration, or others that --columns names"
    add_argument(parser, "file", completer=files(".nc", ".csv"), metavar="FILE", nargs="?", help=about)
    parser.add_argument("--along", metavar="AXIS", help="the axis to fit along (frequency, else v; of a CSV: its rows)")
    about = (
        "of a CSV: which column is what, in which unit, like "
        'rate_of_penetration="ROP (m/h)" mean_force="WOB (kN)", or one value for all rows, like threshold="150 kN"'
    )
    parser.add_argument("--columns", metavar="NAME=COLUMN", nargs="+", action="extend", help=about)
    parser.add_argument("--by", metavar="COLUMN", action="append", help="of a CSV: fit the rows of each of its values")
    add_json(parser)
    parser.add_argument("-o", dest="out", metavar="FIT.nc", help="where to write (FILE-fit.nc in this folder)")


def run(options: Options) -> None:
    words = list(options.columns or [])
    if options.file is None and words and "=" not in words[-1]:
        options.file = words.pop()  # FILE may follow the columns
    if options.file is None:
        raise InputError("fit: the following arguments are required: FILE; see vibrojax fit --help")
    out = output(options.out or f"{Path(options.file).stem}-fit.nc")
    picture = picture_beside(out)
    from vibrojax.analyses.rop_law import fit_rop, law_facts, law_table
    from vibrojax.analyses.rop_law.columns import columns_lines, read_columns
    from vibrojax.io.dataset import write_dataset

    with timed("read and fit"):
        fit = fit_rop(options.file, options.along, options.by or (), progress=False, columns=read_columns(words))
    with timed("write"):
        write_dataset(fit, out)
    drawn = draw(options, fit, out, picture)
    facts = law_facts(fit)
    if options.json:
        print_json({"file": options.file, **facts, **file_facts(ResultFiles(out, picture, {}), drawn)})
        return
    columns = columns_lines(fit)
    before = [*columns, ""] if columns and not options.quiet else []
    after = [] if options.quiet else [f"{out}{drawn}"]
    print("\n".join([*before, *law_table(facts), "", *_legend(fit), "", *facts["verdict"], *after]))


def _legend(fit: "xarray.Dataset") -> list[str]:
    """Return lines that explain the columns of the table."""
    lane = "a row of the CSV" if "columns" in fit.attrs else WORDS["lane"]
    return [
        f"forms of the rate of penetration: {fit.attrs['formulas']}",
        f"eta: the relief P/D, {WORDS['relief P/D']}; eta0: where it begins; a lane: {lane}",
        "AIC: by how much a form describes the data better (lower is better, by 2 or more clearly so)",
    ]
