"""Commands of studies: those that follow from the class of an analysis, and the commands of the others."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vibrojax.cli.arguments import (
    MANY,
    SWEEP,
    AddArguments,
    Command,
    Options,
    argument,
    command,
    explained,
    flag,
    named_values,
    result_options,
    words,
)
from vibrojax.cli.declared import DeclaredSetting, declared, summary_of
from vibrojax.cli.output import draw, output, result
from vibrojax.errors import InputError, Place, counted, shown
from vibrojax.studies import HOMES

if TYPE_CHECKING:
    from dataclasses import Field

    import xarray

    from vibrojax.studies.analysis import Analysis
    from vibrojax.studies.subjects import CheckedAnalysis, FileAnalysis, MachineAnalysis

START = "start (a name, or [x1,x1',x2,x2'])"
LISTS = (
    "; a list such as beta=0.3,0.4,0.5 defines several machines, computed together; with several lists, each machine "
    "takes the values at the same position"
)
TOLERANCES = (
    "; a tolerance is written NAME=VALUE+-HALF_WIDTH, such as delta=-0.002+-0.001 or gamma=0.64+-1% (or with ±)"
)


def study_command(kind: str, summary: str = "") -> Command:
    """Return the command of a kind of analysis, which is imported when the command runs.

    `summary`: by default, the first line of the docstring of the class.
    """

    def add(parser: Any) -> None:
        if kind not in HOMES:
            parser.description = str(_class_of(kind).__doc__ or summary).splitlines()[0].rstrip(".")
        for add_argument in _arguments(kind, _about(kind)):
            add_argument(parser)

    return Command(summary or summary_of(*_home(kind)), (add,), lambda options: _run(kind, options))


def _home(kind: str) -> tuple[str, str]:
    """Return module and class of an analysis of this package."""
    module, _, name = HOMES[kind].partition(":")
    return f"vibrojax.studies.{module}", name


def _about(kind: str) -> Mapping[str, Any]:
    """Return attributes and settings of an analysis by name: as its source declares them, or of the imported class."""
    if kind in HOMES:
        module, name = _home(kind)
        attributes: Mapping[str, Any] = declared(module)[name]
        return attributes
    from vibrojax.settings.fields import settings_of

    analysis = _class_of(kind)
    settings = {
        name: DeclaredSetting(item.metadata.get("help", ""), item.default, item.metadata.get("metavar"))
        for name, item in settings_of(analysis).items()
    }
    return settings | {name: getattr(analysis, name) for name in dir(analysis) if name not in settings}


def _class_of(kind: str) -> "type[Analysis]":
    from vibrojax.studies.analysis import analysis_named

    analysis = analysis_named(kind)
    assert analysis is not None  # commands exist only for known kinds
    return type(analysis)


def _arguments(kind: str, about: Mapping[str, Any]) -> Iterator[AddArguments]:
    """Yield the arguments of the command of an analysis with the attributes `about`."""
    settings = {name: value for name, value in about.items() if isinstance(value, DeclaredSetting)}
    if about["subject"] == "machines":
        if about["terms"]:
            yield explained(*about["terms"])
        yield argument("scene", "SCENE", about["scenes"])
        run = declared("vibrojax.settings.run_settings")["RunSettings"]
        text = f"parameters, and friction{LISTS * about['lists']}{TOLERANCES * about['tolerances']}. Also {START}"
        for name, setting in (settings | {name: run[name] for name in about["run_settings"]}).items():
            if setting.help:
                default = f"; default: {setting.default:g}" if isinstance(setting.default, (int, float)) else ""
                text += f"; {name} ({setting.help}{default})"
        yield words(text.replace("%", "%%"))
    elif about["subject"] == "file":
        yield argument("file", "FILE", about["about"])
        if about["columns"]:
            yield argument("--columns", "NAME=COLUMN", about["columns"], **MANY)
    else:
        text = "the dataset of a sweep (.nc); the sweep is run again if the dataset lacks what the analysis needs"
        yield argument("file", "FILE", SWEEP + text)
        yield from (argument(_option(n), each.metavar or n.upper(), each.help) for n, each in settings.items())
    yield from result_options(about.get("file") or f"{'SCENE' if about['subject'] == 'machines' else 'NAME'}-{kind}.nc")


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _run(kind: str, options: Options) -> None:
    analysis: Any = _class_of(kind)
    {"machines": _run_machines, "file": _run_file, "sweep": _run_sweep}[analysis.subject](analysis, options)


def _run_machines(analysis_class: "type[MachineAnalysis[Any]]", options: Options) -> None:
    about = analysis_class
    place = Place(about.command or about.kind)
    values, parameters = named_values(place, options.values, about.words(), about.lists, about.tolerances)
    analysis, machines = about.asked(options.scene, about.of_words(values), parameters)
    _answer(options, analysis, machines, analysis.file_name(machines))


def _run_file(analysis_class: "type[FileAnalysis[Any]]", options: Options) -> None:
    from vibrojax.io.log_columns import read_columns

    analysis = analysis_class()
    columns = read_columns(options.columns or []) if analysis.columns else None
    request, stem = analysis.asked(options.file, columns), Path(options.file).stem
    default = f"{stem}.nc" if stem.endswith(analysis.kind) else f"{stem}-{analysis.kind}.nc"
    if analysis.chunks:
        _advise_to_go_on(options, str(options.command), options.file, "-o", options.out or default)
    _answer(options, analysis, request, default)


def _answer(options: Options, analysis: "CheckedAnalysis[Any]", request: Any, default: str) -> None:
    """Compute and print what an analysis has checked, unless its file holds the result."""
    from vibrojax.studies.analysis import checked_result

    def computed(out: Path) -> "nullcontext[xarray.Dataset]":
        dataset = analysis.compute_beside(request, out, not options.fresh, not options.quiet)
        return nullcontext(checked_result(analysis, dataset))

    # What the command line alone describes gets a number; the name of a file stands for one result.
    ds = result(options, default, analysis.identity(request), computed, numbered=analysis.subject == "machines")
    ds.print(options, facts=analysis.facts(ds.dataset, request) if options.json else None)


def _run_sweep(analysis_class: "type[Analysis]", options: Options) -> None:
    from vibrojax.io.dataset import open_dataset
    from vibrojax.maps.rerun import holds_orbits
    from vibrojax.maps.run import lanes_beside
    from vibrojax.settings.fields import settings_of
    from vibrojax.studies.analysis import analyse, checked_result
    from vibrojax.studies.subjects import SweepAnalysis

    kind, file, progress = analysis_class.kind, str(options.file), not options.quiet
    given = {name: text for name in settings_of(analysis_class) if (text := getattr(options, name)) is not None}
    settings = {name: _setting(settings_of(analysis_class)[name], text) for name, text in given.items()}
    analysis = analysis_class(**settings).checked(Place(kind))
    is_dataset = file.endswith(".nc")
    source: Any = open_dataset(Path(file)) if is_dataset else file
    sweep = analysis.sweep(source) if isinstance(analysis, SweepAnalysis) else None
    name = Path(file).stem if sweep is None or is_dataset else sweep.name

    @contextmanager
    def computed(out: Path) -> "Iterator[xarray.Dataset]":
        again = [kind, file, "-o", str(out), *(word for name, text in given.items() for word in (_option(name), text))]
        if not isinstance(analysis, SweepAnalysis) or sweep is None:
            options.advise("nothing was kept; to begin again", *again)
            yield analyse(source, analysis, progress=progress)
            return
        lanes: Any = nullcontext(source)
        if not (is_dataset and holds_orbits(source)):
            # Finished chunks are kept next to OUT until the result is written, so an interrupt loses none of them.
            _advise_to_go_on(options, *again)
            lanes = lanes_beside(sweep, out, resume=not options.fresh, progress=progress)
        with lanes as dataset:
            yield checked_result(analysis, analysis.of_lanes(sweep, dataset, progress))

    def count(dataset: "xarray.Dataset") -> str:
        return f": {dataset.sizes[analysis.counted]} {analysis.counted}s" if analysis.counted else ""

    identity: dict[str, object] = {kind: True, "file": file, **{name: str(value) for name, value in settings.items()}}
    if isinstance(analysis, SweepAnalysis) and sweep is not None:
        identity = {**analysis.identity(sweep), **sweep.identity()}
    # The identity of any other analysis states neither its data nor its code: it is computed again.
    result(options, f"{name}-{kind}.nc", identity, computed, reused=sweep is not None, counted=count).print(options)


def _setting(field: "Field[Any]", text: str) -> object:
    """Return the value of an option in the type of its field: a number, true or false, a string, or several strings."""
    option, kind = _option(field.name), str(getattr(field.type, "__name__", field.type))
    if kind.startswith("tuple"):
        items = [item.strip() for item in text.split(",")]
        if not all(items) or (kind.count(",") == 1 and "..." not in kind and len(items) != 2):
            example = field.metadata.get("example", "A,B")
            raise InputError(f"{option}: {shown(text)} is not a pair of names; write two, like {example}")
        return tuple(items)
    if kind.startswith("bool"):
        if text not in ("true", "false"):
            raise InputError(f"{option}: {shown(text)} is neither true nor false")
        return text == "true"
    try:
        return float(text) if kind.startswith("float") else int(text) if kind.startswith("int") else text
    except ValueError:
        raise InputError(f"{option}: {shown(text)} is not a number") from None


def _advise_to_go_on(options: Options, *again: str) -> None:
    options.advise("finished chunks are kept; to go on", *again)


@command(
    argument("file", "FILE", SWEEP + "a sweep's dataset (.nc); its sweep is then run again"),
    *result_options("NAME-orbits.nc"),
)
def orbits(options: Options) -> None:
    """Find the periodic orbits of a sweep's lanes, with their multipliers and stability."""
    from vibrojax.io.dataset import open_dataset
    from vibrojax.maps.rerun import sweep_with_orbits
    from vibrojax.maps.run import run_to_file
    from vibrojax.studies.sweep import lane_parts

    file = str(options.file)
    is_dataset = file.endswith(".nc")
    sweep = sweep_with_orbits(open_dataset(Path(file)) if is_dataset else file)

    def computed(out: Path) -> "nullcontext[xarray.Dataset]":
        _advise_to_go_on(options, "orbits", file, "-o", str(out))
        return nullcontext(run_to_file(sweep, out, resume=not options.fresh, progress=not options.quiet))

    ds = result(
        options,
        f"{Path(file).stem if is_dataset else sweep.name}-orbits.nc",
        sweep.identity(),
        computed,
        written=True,
        counted=lambda _: f": {counted(sweep.lanes, 'lane')}",
        variables=("stable", "multiplier_abs", "regime"),  # of the multipliers, the largest is drawn
    )
    part = lane_parts(ds.dataset)["orbits"]
    ds.print(options, part.lines, part.facts)


_CURVE_SYNTAX = "by=NAME from=A to=B [special=I]"


@command(
    argument("file", "FAMILY.nc", "a family written by vibrojax follow"),
    words(
        f"{_CURVE_SYNTAX}: the second parameter, its bounds, and the number of one special point of the family, "
        "counted from 0 (default: all that can be continued)"
    ),
    argument(
        "--at", "NAME=VALUE", "also locate the points at which curves pass this value of one of the two parameters"
    ),
    *result_options("FAMILY-NAME.nc, FAMILY-NAME-2.nc, ..."),
)
def curves(options: Options) -> None:
    """Continue the special points of a family in a second parameter, as curves, and find where curves meet."""
    from vibrojax.io.dataset import open_dataset
    from vibrojax.studies.curve_analysis import curves_facts
    from vibrojax.studies.curves import continue_curves, read_curves

    place, file = Place("curves"), Path(str(options.file))
    settings, others = named_values(place, options.values, ("by", "from", "to", "special"))
    if others:
        raise place.at(next(iter(others))).error(f"is not a setting; write vibrojax curves FAMILY.nc {_CURVE_SYNTAX}")
    missing = [name for name in ("by", "from", "to") if name not in settings]
    if missing:
        raise place.error(f"{' and '.join(missing)} missing; write vibrojax curves FAMILY.nc {_CURVE_SYNTAX}")
    at = None if options.at is None else named_values(place.at("--at"), [options.at])[1]
    ends = settings["from"], settings["to"]
    spec = read_curves(open_dataset(file), settings["by"], ends, settings.get("special"), at)
    ds = result(
        options,
        f"{file.stem}-{spec.by}.nc",
        spec.identity(),
        lambda _: nullcontext(continue_curves(spec, progress=not options.quiet)),
        numbered=True,
    )
    ds.print(options, facts=curves_facts(ds.dataset) if options.json else None)


@command(
    argument("-o", "DIR", "output folder (default: accuracy)", dest="out", default="accuracy"),
    flag("--quick", "run only a few settings of two scenes, to test the installation"),
)
def accuracy(options: Options) -> None:
    """Measure speed against error on this machine: write a dataset, a table and a picture.

    An interrupted run keeps nothing, since timings of different runs must not be mixed in one table.
    """
    folder = Path(options.out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"-o: {shown(options.out)} cannot be made a folder ({error.strerror})") from None
    out, table_path = output(folder / "accuracy.nc", drawn=True), output(folder / "accuracy.md", (".md",))
    options.advise("nothing is kept; to start again", "accuracy", "-o", options.out, *["--quick"] * options.quick)
    from vibrojax.io.atomic import atomic_write
    from vibrojax.io.identity import text_mark
    from vibrojax.io.writers import write_dataset
    from vibrojax.studies.accuracy import run_accuracy, table

    dataset = run_accuracy(quick=options.quick, progress=not options.quiet)
    write_dataset(dataset, out)
    with atomic_write(table_path) as part:
        part.write_text(table(dataset) + text_mark(), encoding="utf-8")
    drawn = draw(options, dataset, out)
    if not options.quiet:
        print(f"{table_path}: {dataset.sizes['setting']} settings; dataset {out}{drawn.replace(';', ',', 1)}")
