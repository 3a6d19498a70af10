"""Commands that read rig logs: fits of the rate-of-penetration law, and measures of a log."""

import hashlib
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vibrojax.cli.arguments import MANY, Options, argument, command, result_options
from vibrojax.cli.output import result
from vibrojax.errors import InputError, counted
from vibrojax.progress import timed
from vibrojax.studies import WORDS

if TYPE_CHECKING:
    import xarray

_READING = (
    argument(
        "--where",
        "CONDITION",
        'conditions on the rows of a rig log to read, such as "WOB (klb) < 35", "depth (m) >= 1200" or Formation=shale',
        **MANY,
    ),
    argument("--nulls", "TEXT", "further texts that mark a missing value in a rig log", nargs="+"),
)


@command(
    argument(
        "file",
        "FILE",
        "a sweep's dataset (.nc), a rig log as exported (CSV, LAS, WITSML, xlsx), or a CSV with the columns relief "
        "(P/D, mean force over the force at which the rock yields) and rate_of_penetration, or others (see --columns)",
        nargs="?",
    ),
    argument("--along", "AXIS", "axis along which rates are fitted (default: frequency, else v; for a CSV, its rows)"),
    argument(
        "--columns",
        "NAME=COLUMN",
        "columns of a CSV and their units, such as "
        'rate_of_penetration="ROP (m/h)" mean_force="WOB (kN)", or one value for all rows, such as threshold="150 kN" '
        "or rock=granite, which sets the threshold; threshold=unknown is the default for rig logs",
        **MANY,
    ),
    argument(
        "--by",
        "COLUMN",
        "column of a CSV, such as the formation; the rows of each of its values are fitted separately",
        action="append",
    ),
    *_READING,
    *result_options("FILE-fit.nc"),
)
def fit(options: Options) -> None:
    """Fit the rate-of-penetration law to a sweep's dataset or to rig data."""
    given = list(options.columns or [])
    if options.file is None and given and "=" not in given[-1]:
        options.file = given.pop()  # FILE may follow the columns
    if options.file is None:
        raise InputError("fit: the following arguments are required: FILE; see vibrojax fit --help")
    from vibrojax.io.riglog import log_lines
    from vibrojax.studies.rop_law import USES, fit_rop
    from vibrojax.studies.rop_results import law_facts, tables

    file, by = Path(options.file), options.by or []
    columns, reading, identity = _reading(options, given)
    default, data = _data(file, "fit", "data")
    identity |= {"data": data, "along": options.along, "by": ", ".join(by), "fit": True}
    identity |= {f"columns.{name}": text for name, text in columns.items()}

    def fitted(*_: Path | ExitStack) -> "xarray.Dataset":
        with timed("fit"):
            law = fit_rop(options.file, options.along, by, progress=False, columns=columns, **reading)
        if (law["data_use"] == USES.index("censored")).any() and not (law["data_use"] == USES.index("fitted")).any():
            lanes = counted(int((law["data_use"] > 0).sum()), "lane")
            more = "" if file.suffix == ".csv" else f"; vibrojax info {file} says what would give a rate"
            raise InputError(f"{file}: nothing penetrates in any of {lanes}, so there is no rate to fit{more}")
        return law

    ds = result(options, default, identity, fitted, reused=False)
    law = ds.dataset
    facts, sources = law_facts(law), [] if options.quiet else log_lines(law)
    lane = f"a row of {file.name}" if "columns" in law.attrs else WORDS["lane"]
    lines = [
        *sources,
        *[""] * bool(sources),
        *tables(law),
        "",
        f"forms of the rate of penetration: {law.attrs['formulas']}",
        f"η: the relief P/D, {WORDS['relief P/D']}; η₀: where it begins; a lane: {lane}",
        "AIC: lower is better, by more than 2 clearly so"
        + "; CV: error of rates predicted from other rows, which decides" * bool(law["cv_error"].notnull().any()),
        "",
        *facts["verdict"],
    ]
    ds.print(options, lines, {"file": options.file, **facts})


def _reading(options: Options, words: list[str]) -> tuple[dict[str, str], dict[str, Any], dict[str, Any]]:
    """Return the columns, the other arguments of reading, and these as an identity states them."""
    from vibrojax.io.log_columns import checked_columns, read_columns

    columns, reading = read_columns(words), {"where": options.where, "nulls": options.nulls}
    checked_columns(columns)  # before an existing output is read
    return columns, reading, {name: "; ".join(words) for name, words in reading.items() if words}


def _data(file: Path, kind: str, key: str) -> tuple[str, str]:
    """Return the name of a result of a file's data, and the data as its identity states them: name and digest.

    The digest is that of the identity of a dataset, which a repeated run keeps, or of the content of another file. The
    name states the ending of the data where a result of another file, with other data under `key`, has the name.
    """
    from vibrojax.io.identity import digest, stored_identity

    identity = stored_identity(file) if file.suffix == ".nc" else None
    text = digest(identity) if identity is not None else hashlib.sha256().hexdigest()
    if identity is None and file.is_file():
        with open(file, "rb") as content:
            text = hashlib.file_digest(content, "sha256").hexdigest()
    name = f"{file.stem}-{kind}.nc"
    source = str((stored_identity(Path(name)) or {}).get(key, file.name)).partition(", sha256 ")[0]
    name = name if source == file.name else f"{file.stem}-{file.suffix[1:]}-{kind}.nc"
    return name, f"{file.name}, sha256 {text[:12]}"


@command(
    argument("file", "FILE", "a rig log as exported (CSV, LAS, WITSML, xlsx)"),
    argument(
        "--columns",
        "NAME=COLUMN",
        'columns of the log and their units, or one value for all rows: bit_diameter="8.5 in", impact_power="12 kW"',
        **MANY,
    ),
    *_READING,
    argument(
        "--units", "driller|si", "units of the picture and the summary: driller (m/h, rpm, kN, MPa; default) or si"
    ),
    *result_options("FILE-rig.nc"),
)
def rig(options: Options) -> None:
    """Compute specific energies, the founder point and stick-slip of a rig log, and draw tracks over depth."""
    from vibrojax.studies.rig_analysis import rig as measures

    file, units = Path(options.file), options.units or "driller"
    columns, reading, given = _reading(options, list(options.columns or []))
    default, data = _data(file, "rig", "rig")
    identity = {"rig": data, "units": units, **given, **columns}

    ds = result(options, default, identity, lambda *_: measures(file, columns, **reading, units=units))
    ds.print(options)
