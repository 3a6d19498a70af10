"""Commands of studies: those that follow from the class of an analysis, and the commands of the others."""

import re
from argparse import RawDescriptionHelpFormatter
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vibrojax.cli.arguments import (
    KEPT,
    MANY,
    SWEEP,
    Command,
    Options,
    argument,
    command,
    flag,
    named_values,
    result_options,
    words,
)
from vibrojax.cli.output import draw, output, result
from vibrojax.errors import InputError, Place, counted, shown
from vibrojax.studies import HOMES, glossary

if TYPE_CHECKING:
    from dataclasses import Field

    import xarray

START = "start (a name, or [x1,x1',x2,x2'])"
LISTS = (
    "; a list such as beta=0.3,0.4,0.5 defines several machines, computed together; with several lists, each machine "
    "takes the values at the same position"
)
TOLERANCES = (
    "; a tolerance is written NAME=VALUE+-HALF_WIDTH, such as delta=-0.002+-0.001 or gamma=0.64+-1% (or with ±)"
)


def study_command(kind: str, summary: str = "") -> Command:
    """Return the command of a kind of analysis.

    Its class is imported when the command runs or shows its help: an import takes longer than `vibrojax --help`, which
    shows the first line of its docstring. `summary` stands for that line where its source is not in this package.
    """
    if kind in HOMES:
        module, _, name = HOMES[kind].partition(":")
        source = Path(__file__).parents[1].joinpath("studies", f"{module}.py").read_text(encoding="utf-8")
        match = re.search(rf'^class {name}\b[^:]*:\n    """(.+?)\.?("""|\n)', source, re.MULTILINE)
        summary = match[1] if match else ""

    def add(parser: Any) -> None:
        _add_arguments(parser, _class_of(kind))

    return Command(summary, (add,), lambda options: _run(_class_of(kind), options))


def _class_of(kind: str) -> Any:
    """Return the class of an analysis; the attributes that its command needs depend on its subject."""
    from vibrojax.studies.analysis import analysis_named

    return type(analysis_named(kind))


def _add_arguments(parser: Any, about: Any) -> None:
    """Add the arguments of the command of an analysis to its parser."""
    from vibrojax.settings.fields import settings_of
    from vibrojax.settings.run_settings import RunSettings

    parser.description = str(about.__doc__ or parser.description).splitlines()[0].rstrip(".")
    settings, default = settings_of(about), f"NAME-{about.kind}.nc"
    if about.subject == "machines":
        default = f"SCENE-{about.kind}.nc"
        if about.terms:
            parser.formatter_class = RawDescriptionHelpFormatter
            parser.epilog = f"words used in the output:\n{glossary(*about.terms)}"
        argument("scene", "SCENE", about.scenes)(parser)
        run = settings_of(RunSettings)
        text = f"parameters, and friction{LISTS * about.lists}{TOLERANCES * about.tolerances}. Also {START}"
        for name, item in (settings | {name: run[name] for name in about.run_settings}).items():
            if meaning := item.metadata.get("help"):
                usual = f"; default: {item.default:g}" if isinstance(item.default, (int, float)) else ""
                text += f"; {name} ({meaning}{usual})"
        words(text.replace("%", "%%"))(parser)
    elif about.subject == "file":
        argument("file", "FILE", about.about)(parser)
        if about.columns:
            argument("--columns", "NAME=COLUMN", about.columns, **MANY)(parser)
    else:
        text = "the dataset of a sweep (.nc); the sweep is run again if the dataset lacks what the analysis needs"
        argument("file", "FILE", SWEEP + text)(parser)
        for name, item in settings.items():
            metavar = item.metadata.get("metavar") or name.upper()
            argument(_option(name), metavar, item.metadata.get("help", ""))(parser)
    for add_argument in result_options(getattr(about, "file", "") or default):
        add_argument(parser)


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _run(about: Any, options: Options) -> None:
    """Check the input of an analysis; compute and print its result, unless the file of the result holds it."""
    kind = about.kind
    if about.subject == "sweep":
        _run_sweep(about, options)
        return
    from vibrojax.studies.analysis import checked_result

    if about.subject == "machines":
        place = Place(about.command or kind)
        if "=" in options.scene:
            raise place.error(f"the scene is missing; write vibrojax {about.command or kind} SCENE {options.scene}")
        values, parameters = named_values(place, options.values, about.words(), about.lists, about.tolerances)
        analysis, request = about.asked(options.scene, about.of_words(values), parameters)
        default = analysis.file_name(request)
    else:
        from vibrojax.io.log_columns import read_columns

        analysis, stem = about(), Path(options.file).stem
        request = analysis.asked(options.file, read_columns(options.columns or []) if about.columns else None)
        default = f"{stem}.nc" if stem.endswith(kind) else f"{stem}-{kind}.nc"
        if about.chunks:
            options.advise(KEPT, str(options.command), options.file, "-o", options.out or default)

    def computed(out: Path, _: ExitStack) -> "xarray.Dataset":
        return checked_result(analysis, analysis.compute_beside(request, out, not options.fresh, not options.quiet))

    # What the command line alone describes gets a number; the name of a file stands for one result.
    ds = result(options, default, analysis.identity(request), computed, numbered=analysis.subject == "machines")
    ds.print(options, facts=analysis.facts(ds.dataset, request) if options.json else None)


def _run_sweep(about: Any, options: Options) -> None:
    from vibrojax.io.dataset import open_dataset
    from vibrojax.maps.rerun import holds_orbits
    from vibrojax.maps.run import lanes_beside
    from vibrojax.settings.fields import settings_of
    from vibrojax.studies.analysis import analyse, checked_result
    from vibrojax.studies.subjects import SweepAnalysis

    kind, file, progress, known = about.kind, str(options.file), not options.quiet, settings_of(about)
    given = {name: text for name in known if (text := getattr(options, name)) is not None}
    settings = {name: _setting(known[name], text) for name, text in given.items()}
    analysis = about(**settings).checked(Place(kind))
    is_dataset = file.endswith(".nc")
    source: Any = open_dataset(Path(file)) if is_dataset else file
    sweep = analysis.sweep(source) if isinstance(analysis, SweepAnalysis) else None
    name = Path(file).stem if sweep is None or is_dataset else sweep.name

    def computed(out: Path, until_written: ExitStack) -> "xarray.Dataset":
        again = [kind, file, "-o", str(out), *(word for name, text in given.items() for word in (_option(name), text))]
        if sweep is None:
            options.advise("nothing was kept; to begin again", *again)
            return analyse(source, analysis, progress=progress)
        lanes = source
        if not (is_dataset and holds_orbits(source)):
            # Finished chunks are kept next to OUT until the result is written, so an interrupt loses none of them.
            options.advise(KEPT, *again)
            lanes = until_written.enter_context(lanes_beside(sweep, out, not options.fresh, progress))
        return checked_result(analysis, analysis.of_lanes(sweep, lanes, progress))

    def count(dataset: "xarray.Dataset") -> str:
        return f": {dataset.sizes[analysis.counted]} {analysis.counted}s" if analysis.counted else ""

    identity: dict[str, object] = {kind: True, "file": file, **{name: str(value) for name, value in settings.items()}}
    if sweep is not None:
        identity = {**analysis.identity(sweep), **sweep.identity()}
    # The identity of any other analysis states neither its data nor its code: it is computed again.
    result(options, f"{name}-{kind}.nc", identity, computed, reused=sweep is not None, counted=count).print(options)


def _setting(field: "Field[Any]", text: str) -> object:
    """Return the value of an option in the type of its field: a number, true or false, a string, or several strings."""
    option, kind = _option(field.name), str(getattr(field.type, "__name__", field.type))
    if kind.startswith("tuple"):
        items = [item.strip() for item in text.split(",")]
        if not all(items) or (kind.count(",") == 1 and "..." not in kind and len(items) != 2):
            raise InputError(f"{option}: {shown(text)} is not a pair of names; write two, like A,B")
        return tuple(items)
    if kind.startswith("bool"):
        if text not in ("true", "false"):
            raise InputError(f"{option}: {shown(text)} is neither true nor false")
        return text == "true"
    try:
        return float(text) if kind.startswith("float") else int(text) if kind.startswith("int") else text
    except ValueError:
        raise InputError(f"{option}: {shown(text)} is not a number") from None


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

    def computed(out: Path, _: ExitStack) -> "xarray.Dataset":
        options.advise(KEPT, "orbits", file, "-o", str(out))
        return run_to_file(sweep, out, resume=not options.fresh, progress=not options.quiet)

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
        lambda *_: continue_curves(spec, progress=not options.quiet),
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
