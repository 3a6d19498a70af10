"""The commands `orbits`, `curves`, `fit`, `rig` and `accuracy`; `analyses` has those of the others."""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from vibrojax.cli.command import (
    JSON,
    SWEEP,
    Options,
    argument,
    command,
    flag,
    named_values,
    output_options,
    whole,
)
from vibrojax.cli.output import (
    answer,
    dataset_written,
    draw,
    file_facts,
    output,
    output_folder,
    print_json,
    result_at,
    stored_line,
    stored_result,
    write_result,
)
from vibrojax.errors import InputError, Place, counted
from vibrojax.progress import timed
from vibrojax.studies import WORDS

if TYPE_CHECKING:
    import xarray


_DIGEST_LENGTH = 12
"""Number of hexadecimal digits of the SHA-256 by which a fit recognises its data."""

_ORBIT_VARIABLES = ("stable", "multiplier_abs", "regime")
"""Variables in the picture of orbits: of the multipliers, the largest is drawn."""


@command(
    argument("file", "FILE", SWEEP + "a sweep's dataset (.nc), whose sweep is then run again"),
    output_options("NAME-orbits.nc"),
)
def orbits(options: Options) -> None:
    """Find the periodic orbits of a sweep's lanes, with their multipliers and stability."""
    from vibrojax.io.dataset import open_dataset
    from vibrojax.maps.rerun import sweep_with_orbits
    from vibrojax.maps.run import run_to_file
    from vibrojax.studies.sweep import orbit_lines

    file = str(options.file)
    is_dataset = file.endswith(".nc")

    def variables(dataset: "xarray.Dataset") -> list[str]:
        return [name for name in _ORBIT_VARIABLES if name in dataset]

    sweep = sweep_with_orbits(open_dataset(Path(file)) if is_dataset else file)
    out = output(options.out or f"{Path(file).stem if is_dataset else sweep.name}-orbits.nc", drawn=True)
    options.advise("finished chunks are kept; to go on", "orbits", file, "-o", str(out))
    dataset = stored_result(options, out, sweep.identity())
    if dataset is not None:
        line = stored_line(options, dataset, out, variables(dataset))
    else:
        dataset = run_to_file(sweep, out, resume=not options.fresh, progress=not options.quiet)
        line = f"{out}: {counted(sweep.lanes, 'lane')}{draw(options, dataset, out, variables(dataset))}"
    if not options.quiet:
        print("\n".join([line, *orbit_lines(dataset)]))


_CURVE_SETTINGS = ("by", "from", "to", "special")
_CURVE_SYNTAX = "by=NAME from=A to=B [special=I]"


@command(
    argument("file", "FAMILY.nc", "what vibrojax follow has made"),
    argument(
        "values",
        "NAME=VALUE",
        f"{_CURVE_SYNTAX}: the second parameter and its bounds; the number of one special point of the family, from 0 "
        "(by default all that can be continued)",
        nargs="*",
        default=[],
    ),
    argument("--at", "NAME=VALUE", "locate where the curves pass this value of one of the two parameters"),
    output_options("FAMILY-NAME.nc"),
    JSON,
)
def curves(options: Options) -> None:
    """Continue the special points of a family in a second parameter: curves, and the points where several meet."""
    from vibrojax.io.dataset import open_dataset
    from vibrojax.studies.curves import read_curves

    place, file = Place("curves"), Path(str(options.file))
    settings, others = named_values(place, options.values, _CURVE_SETTINGS, lists=False)
    if others:
        raise place.at(next(iter(others))).error(f"is not a setting; write vibrojax curves FAMILY.nc {_CURVE_SYNTAX}")
    missing = [name for name in ("by", "from", "to") if name not in settings]
    if missing:
        raise place.error(f"{' and '.join(missing)} missing; write vibrojax curves FAMILY.nc {_CURVE_SYNTAX}")
    at = None if options.at is None else named_values(place.at("--at"), [options.at], (), lists=False)[1]
    special = whole(settings["special"]) if "special" in settings else None
    spec = read_curves(open_dataset(file), settings["by"], (settings["from"], settings["to"]), special, at)

    def compute() -> "xarray.Dataset":
        from vibrojax.studies.curves import continue_curves

        return continue_curves(spec, progress=not options.quiet)

    def facts(dataset: "xarray.Dataset") -> dict[str, object]:
        from vibrojax.studies.curve_analysis import curves_facts

        return curves_facts(dataset)

    answer(options, f"{file.stem}-{spec.by}.nc", spec.identity(), compute, facts)


_READING = (
    argument(
        "--where",
        "CONDITION",
        'of a rig log: rows to read, like "WOB (klb) < 35", "1000 <= depth (m) < 1200" or Formation=shale',
        nargs="+",
        action="extend",
    ),
    argument("--nulls", "TEXT", "of a rig log: further texts that stand for a missing value", nargs="+"),
)


@command(
    argument(
        "file",
        "FILE",
        "a sweep's .nc, or a rig log as it is exported (CSV, LAS, WITSML, xlsx), or a CSV with columns relief (P/D, "
        "mean force over the force at which the rock yields) and rate_of_penetration, or others that --columns names",
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
    *_READING,
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
    reading = {"where": options.where, "nulls": options.nulls}
    data = read_groups(options.file, options.along, by, columns, **reading)
    groups = data[-1]
    if groups["valid"].any() and not (groups["valid"] & (groups["rate"] > 0)).any():
        lanes = counted(int(groups["is_lane"].sum()), "lane")
        more = "" if file.suffix == ".csv" else f"; vibrojax info {file} says what would give a rate"
        raise InputError(f"{file}: nothing penetrates in any of {lanes}, so there is no rate to fit{more}")
    identity = {"data": f"{file.name}, sha256 {_digest(file)}", "along": options.along, "by": ", ".join(by)}
    identity |= _given(reading)
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
        "AIC: lower is better, by more than 2 clearly so"
        + "; CV: error of rates predicted from other rows, which decides" * bool(law["cv_error"].notnull().any()),
        "",
        *facts["verdict"],
        *([] if options.quiet else [f"{out}{drawn}"]),
    ]
    print("\n".join(lines))


def _given(reading: Mapping[str, Sequence[str] | None]) -> dict[str, str]:
    return {name: "; ".join(words) for name, words in reading.items() if words}


def _digest(file: Path) -> str:
    """Return a digest of the data in a file: of the identity of a dataset, which a repeated run keeps, or of a CSV."""
    from vibrojax.io.identity import digest, stored_identity

    identity = stored_identity(file) if file.suffix == ".nc" else None
    if identity is not None:
        return digest(identity)[:_DIGEST_LENGTH]
    return hashlib.sha256(file.read_bytes()).hexdigest()[:_DIGEST_LENGTH] if file.is_file() else ""


@command(
    argument("file", "FILE", "a rig log as it is exported (CSV, LAS, WITSML, xlsx)"),
    argument(
        "--columns",
        "NAME=COLUMN",
        'which column is what, or one value for all rows, like bit_diameter="8.5 in" or impact_power="12 kW"',
        nargs="+",
        action="extend",
    ),
    *_READING,
    argument(
        "--units", "driller|si", "of the picture and the summary: driller (m/h, rpm, kN, MPa), the default, or si"
    ),
    JSON,
    output_options("FILE-rig.nc"),
)
def rig(options: Options) -> None:
    """Compute specific energies, the founder point and stick-slip of a rig log, and draw tracks over depth."""
    from vibrojax.io.log_columns import read_columns
    from vibrojax.studies.rig_analysis import rig as measures

    file, columns = Path(options.file), read_columns(list(options.columns or []))
    reading = {"where": options.where, "nulls": options.nulls}
    units = options.units or "driller"
    identity = {"rig": f"{file.name}, sha256 {_digest(file)}", "units": units, **_given(reading), **columns}
    computed = measures(
        file, columns, **reading, units=units
    )  # first: wrong input is refused whatever the output holds
    answer(options, f"{file.stem}-rig.nc", identity, lambda: computed)


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
    from vibrojax.io.identity import text_mark
    from vibrojax.studies.accuracy import run_accuracy, table
    from vibrojax.studies.choose import save_picture

    dataset = run_accuracy(quick=options.quick, progress=not options.quiet)
    write_dataset(dataset, dataset_path)
    with atomic_write(table_path) as part:
        part.write_text(table(dataset) + text_mark(), encoding="utf-8")
    dataset_written(options, dataset_path)
    save_picture(dataset, picture_path)
    if not options.quiet:
        print(f"{table_path}: {dataset.sizes['setting']} settings; dataset {dataset_path}, picture {picture_path}")
