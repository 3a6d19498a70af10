"""The commands of analyses: what they analyse is read and checked, then computed, written, drawn and summarised."""

import dataclasses
import hashlib
import re
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from vibrojax.cli.command import (
    JSON,
    Command,
    Options,
    argument,
    command,
    explained,
    flag,
    named_values,
    output_options,
    point_arguments,
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
    stored_picture,
    stored_result,
    write_result,
)
from vibrojax.errors import InputError, Place, counted, shown
from vibrojax.progress import timed
from vibrojax.studies import FAMILY_WORDS, WORDS

if TYPE_CHECKING:
    import xarray

    from vibrojax.studies.analysis import Analysis
    from vibrojax.studies.subjects import FileAnalysis, MachineAnalysis

_DIGEST_LENGTH = 12
"""Number of hexadecimal digits of the SHA-256 by which a fit recognises its data."""

_SWEEP = "a sweep: a bundled name, like regime-map, or the path of a TOML file; or "

_HALF_WIDTH = re.compile(r"\+-|±|\+/-")

_START = "start (a name, or [x1,x1',x2,x2'])"


def study_command(kind: str, summary: str) -> Command:
    """Return the command of a kind of analysis; the analysis is imported only when the command is used."""
    subjects: dict[str, tuple[Callable[[Any, Any], None], Callable[[Any, Options], None]]] = {
        "machines": (_add_machines, _run_machines),
        "file": (_add_file, _run_file),
        "sweep": (_add_sweep, _run_sweep),
    }

    def add(parser: Any) -> None:
        analysis = _class_of(kind)
        subjects[analysis.subject][0](analysis, parser)

    def run(options: Options) -> None:
        analysis = _class_of(kind)
        subjects[analysis.subject][1](analysis, options)

    return Command(summary, (add,), run)


def _class_of(kind: str) -> "type[Analysis]":
    from vibrojax.studies.analysis import analysis_named

    analysis = analysis_named(kind)
    assert analysis is not None  # commands exist only for known kinds
    return type(analysis)


def _add_machines(analysis: "type[MachineAnalysis[Any]]", parser: Any) -> None:
    from vibrojax.settings.fields import meanings
    from vibrojax.settings.run_settings import RunSettings

    many = "; a list, beta=0.3,0.4,0.5, is as many machines, computed together; of several lists the first values "
    many += "belong to one machine, the second ones to the next"
    known = meanings(RunSettings)
    width = "; those with a tolerance as NAME=VALUE+-HALF_WIDTH, like delta=-0.002+-0.001 or gamma=0.64+-1% (± too)"
    about = f"parameters, and friction{many * analysis.lists}{width * analysis.tolerances}. Also {_START}"
    for name, item in _settings(analysis).items():
        if text := item.metadata.get("help"):
            default = "" if item.default in (None, dataclasses.MISSING) else f": {item.default:g}"
            about += f"; {name} ({text}{default})"
    for name in analysis.run_settings:
        about += f"; {name} ({known[name]})"
    if analysis.kind == "family":
        explained(*FAMILY_WORDS)(parser)
    point_arguments(about.replace("%", "%%"), analysis.scenes)(parser)
    output_options(analysis.file or f"SCENE-{analysis.kind}.nc")(parser)
    JSON(parser)


def _run_machines(analysis_class: "type[MachineAnalysis[Any]]", options: Options) -> None:
    place = Place(analysis_class.command or analysis_class.kind)
    is_pair = [bool(analysis_class.tolerances and _HALF_WIDTH.search(word)) for word in options.values]
    pairs: dict[str, object] = {}
    for word in (word for word, pair in zip(options.values, is_pair, strict=True) if pair):
        name, pair = _pair(place, word)
        if name in pairs:
            raise place.at(name).error("has a second value; give one")
        pairs[name] = pair
    words = [word for word, pair in zip(options.values, is_pair, strict=True) if not pair]
    values, parameters = named_values(place, words, analysis_class.words(), lists=analysis_class.lists)
    for name in pairs:
        if name in parameters or name in values:
            raise place.at(name).error("has a second value; give one")
    for name, item in _settings(analysis_class).items():
        if name in values and not {float, str} & {item.type, *get_args(item.type)}:
            values[name] = whole(values[name])
    analysis, machines = analysis_class.asked(options.scene, analysis_class.of_words(values), parameters | pairs)
    _answer(options, analysis, machines, analysis.file_name(machines))


def _add_file(analysis: "type[FileAnalysis[Any]]", parser: Any) -> None:
    argument("file", "FILE", analysis.about)(parser)
    if analysis.columns:
        argument("--columns", "NAME=COLUMN", analysis.columns, nargs="+", action="extend")(parser)
    output_options(f"NAME-{analysis.kind}.nc")(parser)
    JSON(parser)


def _run_file(analysis_class: "type[FileAnalysis[Any]]", options: Options) -> None:
    from vibrojax.io.log_columns import read_columns

    analysis = analysis_class()
    columns = read_columns(options.columns or []) if analysis.columns else None
    asked, default = analysis.asked(options.file, columns), f"{Path(options.file).stem}-{analysis.kind}.nc"
    if analysis.chunks:
        out = options.out or default
        options.advise("finished chunks are kept; to go on", str(options.command), options.file, "-o", out)
    _answer(options, analysis, asked, default)


def _answer(options: Options, analysis: Any, asked: Any, default: str) -> None:
    """Compute and report what a `CheckedAnalysis` has read, unless its file holds the result."""
    from vibrojax.studies.analysis import checked_result

    progress = not options.quiet

    def compute() -> "xarray.Dataset":
        if getattr(analysis, "chunks", False):
            out = Path(options.out or default)
            return checked_result(analysis, analysis.compute_beside(asked, out, not options.fresh, progress))
        return checked_result(analysis, analysis.compute(asked, progress))

    def facts(dataset: "xarray.Dataset") -> Mapping[str, object] | None:
        own: Mapping[str, object] | None = analysis.facts(dataset, asked)
        return own

    answer(options, default, analysis.identity(asked), compute, facts, numbered=analysis.numbered)


def _pair(place: Place, word: str) -> tuple[str, tuple[float, float]]:
    """Return the name, the nominal value and the half-width in NAME=VALUE+-HALF_WIDTH, which may end in %."""
    name, _, text = (part.strip() for part in word.partition("="))
    value, *widths = (part.strip() for part in _HALF_WIDTH.split(text, maxsplit=1))
    width = "".join(widths)
    try:
        nominal = float(value)
        return name, (nominal, abs(nominal) * float(width[:-1]) / 100 if width.endswith("%") else float(width))
    except ValueError:
        expected = "write NAME=VALUE+-HALF_WIDTH, like delta=0.005+-0.001 or gamma=0.64+-1%"
        raise place.error(f"{shown(word)} is not a tolerance; {expected}") from None


def _settings(analysis: "type[Analysis]") -> "dict[str, dataclasses.Field[Any]]":
    """Return the settings of an analysis, which are the fields of its dataclass, by name."""
    return {item.name: item for item in dataclasses.fields(analysis)} if dataclasses.is_dataclass(analysis) else {}


def _add_sweep(analysis: "type[Analysis]", parser: Any) -> None:
    about = "the dataset of a sweep (.nc), which is run again where it lacks what the analysis needs"
    argument("file", "FILE", _SWEEP + about)(parser)
    for name, item in _settings(analysis).items():
        metavar = item.metadata.get("metavar", name.upper())
        parser.add_argument(_option(name), metavar=metavar, help=item.metadata.get("help"))
    output_options(f"NAME-{analysis.kind}.nc")(parser)


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _run_sweep(analysis_class: "type[Analysis]", options: Options) -> None:
    from vibrojax.io.dataset import open_dataset
    from vibrojax.maps.rerun import holds_orbits
    from vibrojax.studies.analysis import analyse, checked_result
    from vibrojax.studies.sweep_analysis import SweepAnalysis

    kind = analysis_class.kind
    given = {
        _option(name): (field, text)
        for name, field in _settings(analysis_class).items()
        if (text := getattr(options, name)) is not None
    }
    settings = {field.name: _value(option, field, text) for option, (field, text) in given.items()}
    analysis = analysis_class(**settings)
    file, progress = str(options.file), not options.quiet
    is_dataset = file.endswith(".nc")
    source: Any = open_dataset(Path(file)) if is_dataset else file
    sweep, identity = None, {kind: True, "file": file, **{name: str(value) for name, value in settings.items()}}
    if isinstance(analysis, SweepAnalysis):
        sweep = analysis.sweep(source)
        identity = {**analysis.identity(sweep), **sweep.identity()}
    name = Path(file).stem if sweep is None or is_dataset else sweep.name
    out = result_at(options, f"{name}-{kind}.nc", identity)
    words = [kind, file, "-o", str(out), *(word for option, (_, text) in given.items() for word in (option, text))]
    options.advise("nothing was kept; to begin again", *words)
    # The identity of any other analysis states neither its data nor its code: it is computed again.
    dataset = stored_result(options, out, identity) if sweep is not None else None
    if dataset is not None:
        line = stored_line(dataset, out, stored_picture(options, dataset, out))
    else:
        lanes_of: Any = nullcontext(source)
        if sweep is not None and not (is_dataset and holds_orbits(source)):
            from vibrojax.maps.run import lanes_beside

            # Finished chunks are kept next to OUT until the result is written, so an interrupt loses none of them.
            options.advise("finished chunks are kept; to go on", *words)
            lanes_of = lanes_beside(sweep, out, resume=not options.fresh, progress=progress)
        with lanes_of as lanes:
            if isinstance(analysis, SweepAnalysis) and sweep is not None:
                dataset = checked_result(analysis, analysis.of_lanes(sweep, lanes, progress))
            else:
                dataset = analyse(lanes, analysis, progress=progress)
            drawn = write_result(options, dataset, out, identity)
        count = f": {dataset.sizes[analysis.counted]} {analysis.counted}s" if analysis.counted else ""
        line = f"{out}{count}{drawn}"
    if progress:
        print("\n".join([line, *(text for part in analysis.summary(dataset) for text in part.lines)]))


def _value(option: str, field: "dataclasses.Field[Any]", text: str) -> object:
    """Return the value of an option in the type of its field: a number, a string, or a tuple of strings."""
    kind = str(getattr(field.type, "__name__", field.type))
    if kind.startswith("tuple"):
        items = [item.strip() for item in text.split(",")]
        if not all(items) or (kind.count(",") == 1 and "..." not in kind and len(items) != 2):
            example = field.metadata.get("example", "A,B")
            raise InputError(f"{option}: {shown(text)} is not a pair of names; write two, like {example}")
        return tuple(items)
    try:
        return float(text) if kind.startswith("float") else int(text) if kind.startswith("int") else text
    except ValueError:
        raise InputError(f"{option}: {shown(text)} is not a number") from None


_ORBIT_VARIABLES = ("stable", "multiplier_abs", "regime")
"""Variables in the picture of orbits: of the multipliers, the largest is drawn."""


@command(
    argument("file", "FILE", _SWEEP + "a sweep's dataset (.nc), whose sweep is then run again"),
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
        line = stored_line(dataset, out, stored_picture(options, dataset, out, variables(dataset)))
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
    from vibrojax.studies.curve_spec import read_curves

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
        from vibrojax.studies.curve_run import continue_curves

        return continue_curves(spec, progress=not options.quiet)

    def facts(dataset: "xarray.Dataset") -> dict[str, object]:
        from vibrojax.studies.curve_analysis import curves_facts

        return curves_facts(dataset)

    answer(options, f"{file.stem}-{spec.by}.nc", spec.identity(), compute, facts)


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
    from vibrojax.studies.accuracy_run import run_accuracy, table
    from vibrojax.studies.choose import save_picture

    dataset = run_accuracy(quick=options.quick, progress=not options.quiet)
    write_dataset(dataset, dataset_path)
    with atomic_write(table_path) as part:
        part.write_text(table(dataset) + text_mark(), encoding="utf-8")
    dataset_written(options, dataset_path)
    save_picture(dataset, picture_path)
    if not options.quiet:
        print(f"{table_path}: {dataset.sizes['setting']} settings; dataset {dataset_path}, picture {picture_path}")
