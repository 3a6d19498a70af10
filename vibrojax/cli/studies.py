"""The commands `fit`, `rig`, `study`, `calibrate` and `accuracy`."""

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

from vibrojax.cli.command import JSON, Options, argument, command, flag, output_options
from vibrojax.cli.output import (
    answer,
    dataset_written,
    file_facts,
    output,
    output_folder,
    print_json,
    result_at,
    write_result,
)
from vibrojax.errors import InputError, counted
from vibrojax.progress import timed
from vibrojax.studies import WORDS

if TYPE_CHECKING:
    import xarray

_DIGEST_LENGTH = 12
"""Number of hexadecimal digits of the SHA-256 by which a fit recognises its data."""


@command(
    argument(
        "file",
        "FILE",
        "a sweep's .nc, or a rig log as it is exported (CSV, LAS), or a CSV with columns relief (P/D, mean force over "
        "the force at which the rock yields) and rate_of_penetration, or others that --columns names",
        nargs="?",
    ),
    argument("--along", "AXIS", "the axis to fit along (frequency, else v; of a CSV: its rows)"),
    argument(
        "--columns",
        "NAME=COLUMN",
        "of a CSV: which column is what, in which unit, like "
        'rate_of_penetration="ROP (m/h)" mean_force="WOB (kN)", or one value for all rows, like threshold="150 kN" or '
        "rock=granite, whose threshold it takes; threshold=unknown is the default of rig logs",
        nargs="+",
        action="extend",
    ),
    argument("--by", "COLUMN", "of a CSV: fit the rows of each of its values, such as formations", action="append"),
    argument(
        "--dialect",
        "NAME",
        "of a rig log: pason, rigcloud, usrop, witsml, las, semicolon, generic or plain (detected by its columns)",
    ),
    argument("--fastest", "RATE", 'of a rig log: rate above which a row is dropped ("500 ft/h")'),
    flag("--segments", "of a rig log: fit intervals of depth, as many as the data suggest"),
    JSON,
    output_options("FILE-fit.nc"),
)
def fit(options: Options) -> None:
    """Fit the rate-of-penetration law to a sweep's dataset or to rig data."""
    words = list(options.columns or [])
    if options.file is None and words and "=" not in words[-1]:
        options.file = words.pop()  # FILE may follow the columns
    if options.file is None:
        raise InputError("fit: the following arguments are required: FILE; see vibrojax fit --help")
    from vibrojax.io.log_columns import read_columns
    from vibrojax.io.riglog import log_lines
    from vibrojax.studies.rop_law import fit_groups, read_groups
    from vibrojax.studies.rop_results import law_facts, law_table

    file, columns, by = Path(options.file), read_columns(words), options.by or []
    output(options.out or f"{file.stem}-fit.nc")
    reading = {"dialect": options.dialect, "fastest": options.fastest}
    data = read_groups(options.file, options.along, by, columns, options.segments, **reading)
    groups = data[-1]
    if groups["valid"].any() and not (groups["valid"] & (groups["rate"] > 0)).any():
        lanes = counted(int(groups["is_lane"].sum()), "lane")
        more = "" if file.suffix == ".csv" else f"; vibrojax info {file} says what would give a rate"
        raise InputError(f"{file}: nothing penetrates in any of {lanes}, so there is no rate to fit{more}")
    identity = {"data": f"{file.name}, sha256 {_digest(file)}", "along": options.along, "by": ", ".join(by)}
    identity |= {name: text for name, text in reading.items() if text} | (
        {"segments": True} if options.segments else {}
    )
    identity |= {"fit": True} | {f"columns.{name}": text for name, text in columns.items()}
    out = result_at(options, f"{file.stem}-fit.nc", identity)
    with timed("fit"):
        law = fit_groups(*data)
    drawn = write_result(options, law, out, identity)
    facts = law_facts(law)
    if options.json:
        print_json({"file": options.file, **facts, **file_facts(out, drawn)})
        return
    sources = log_lines(law)
    lane = "a row of the CSV" if "columns" in law.attrs else WORDS["lane"]
    lines = [
        *([*sources, ""] if sources and not options.quiet else []),
        *law_table(facts),
        "",
        f"forms of the rate of penetration: {law.attrs['formulas']}",
        f"eta: the relief P/D, {WORDS['relief P/D']}; eta0: where it begins; a lane: {lane}",
        "AIC: by how much a form describes the data better (lower is better, by 2 or more clearly so)"
        + "; CV: error of rates predicted from other rows" * bool(law["cv_error"].notnull().any()),
        "",
        *facts["verdict"],
        *([] if options.quiet else [f"{out}{drawn}"]),
    ]
    print("\n".join(lines))


def _digest(file: Path) -> str:
    """Return a digest of the data in a file: of the identity of a dataset, which a repeated run keeps, or of a CSV."""
    from vibrojax.io.manifest import digest, stored_identity

    identity = stored_identity(file) if file.suffix == ".nc" else None
    if identity is not None:
        return digest(identity)[:_DIGEST_LENGTH]
    return hashlib.sha256(file.read_bytes()).hexdigest()[:_DIGEST_LENGTH] if file.is_file() else ""


@command(
    argument("file", "FILE", "a rig log as it is exported (CSV, LAS)"),
    argument(
        "--columns",
        "NAME=COLUMN",
        'which column is what, or one value for all rows, like bit_diameter="8.5 in" or impact_power="12 kW"',
        nargs="+",
        action="extend",
    ),
    argument(
        "--dialect",
        "NAME",
        "pason, rigcloud, usrop, witsml, las, semicolon, generic or plain (detected by its columns)",
    ),
    JSON,
    output_options("FILE-rig.nc"),
)
def rig(options: Options) -> None:
    """Compute specific energies, the founder point and stick-slip of a rig log, and draw tracks over depth."""
    from vibrojax.io.log_columns import read_columns
    from vibrojax.studies.rig_measures import rig as measures

    file, columns = Path(options.file), read_columns(list(options.columns or []))
    identity = {"rig": f"{file.name}, sha256 {_digest(file)}", "dialect": options.dialect, **columns}

    def compute() -> "xarray.Dataset":
        return measures(file, dialect=options.dialect, columns=columns)

    answer(options, f"{file.stem}-rig.nc", identity, compute)


@command(
    argument("file", "FILE", "a study: a bundled name, like drill, or the path of a TOML file"),
    output_options("NAME-study.nc"),
    JSON,
)
def study(options: Options) -> None:
    """Find which parameters decide about a machine: effects, interactions and Sobol indices; FILE is a study (TOML)."""
    from vibrojax.studies.effects_spec import read_study

    spec = read_study(options.file)
    name = f"{Path(options.file).stem}-study.nc"
    options.advise("finished chunks are kept; to go on", "study", options.file, "-o", options.out or name)

    def compute() -> "xarray.Dataset":
        from vibrojax.maps.run import lanes_beside
        from vibrojax.studies.effects_run import study_of

        out, resume = Path(options.out or name), not options.fresh
        with lanes_beside(spec.sweep, out, resume=resume, progress=not options.quiet) as lanes:
            return study_of(spec, lanes)

    answer(options, name, spec.identity(), compute)


@command(
    argument(
        "file",
        "FILE",
        "a calibration: the path of a TOML file with scene, data (a CSV of operating conditions and observations) or "
        "history (a CSV of the bit's velocity over time), [unknown] NAME = [low, high] and, as needed, start, "
        "[parameters], [error], [prior]",
    ),
    argument(
        "--columns",
        "NAME=COLUMN",
        'of the history: which column is what, in which unit, like time="t (ms)" v1="bit speed (mm/s)"',
        nargs="+",
        action="extend",
    ),
    output_options("NAME-calibration.nc"),
    JSON,
)
def calibrate(options: Options) -> None:
    """Estimate parameters of a drill from observations of its motion, and say which the data determine."""
    from vibrojax.io.log_columns import read_columns
    from vibrojax.studies.calibration_spec import read_calibration

    spec = read_calibration(options.file, read_columns(options.columns or []))

    def compute() -> "xarray.Dataset":
        from vibrojax.studies.calibration_run import find_calibration

        return find_calibration(spec, progress=not options.quiet)

    answer(options, f"{Path(options.file).stem}-calibration.nc", spec.identity(), compute)


@command(
    argument("-o", "DIR", "the folder to write to (accuracy)", dest="out", default="accuracy"),
    flag("--quick", "few settings of two scenes, to see that it works"),
)
def accuracy(options: Options) -> None:
    """Measure speed against error on this machine: write a dataset, a table and a picture.

    An interrupted run keeps nothing, since timings of different runs must not be mixed in one table.
    """
    dataset_path, table_path, picture_path = output_folder(options.out, ("accuracy.nc", "accuracy.md", "accuracy.png"))
    options.advise("nothing is kept; to start again", "accuracy", "-o", options.out, *["--quick"] * options.quick)
    from vibrojax.io.atomic import atomic_write
    from vibrojax.io.dataset import write_dataset
    from vibrojax.io.ownership import text_mark
    from vibrojax.pictures.choose import save_picture
    from vibrojax.studies.accuracy_run import run_accuracy, table

    dataset = run_accuracy(quick=options.quick, progress=not options.quiet)
    write_dataset(dataset, dataset_path)
    with atomic_write(table_path) as part:
        part.write_text(table(dataset) + text_mark(), encoding="utf-8")
    dataset_written(options, dataset_path)
    save_picture(dataset, picture_path)
    if not options.quiet:
        print(f"{table_path}: {dataset.sizes['setting']} settings; dataset {dataset_path}, picture {picture_path}")
