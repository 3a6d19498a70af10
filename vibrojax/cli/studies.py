"""Commands of studies: those that follow from the class of an analysis, and the commands of the others.

The arguments of a command follow from what the source of a study declares, without importing it: a study imports
xarray, SciPy or jax, which takes longer than everything else that `--help` does.
"""

import ast
import re
from argparse import RawDescriptionHelpFormatter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from vibrojax.cli.arguments import (
    KEPT,
    MANY,
    SWEEP,
    AddArguments,
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

    from vibrojax.studies.analysis import Analysis

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
        about = declared(module)[name] if kind in HOMES else _of_class(kind)
        if kind not in HOMES:
            parser.description = str(_class_of(kind).__doc__ or summary).splitlines()[0].rstrip(".")
        if about["subject"] == "machines" and about["terms"]:
            parser.formatter_class = RawDescriptionHelpFormatter
            parser.epilog = f"words used in the output:\n{glossary(*about['terms'])}"
        for add_argument in _arguments(kind, about):
            add_argument(parser)

    module, _, name = f"vibrojax.studies.{HOMES.get(kind, '')}".partition(":")
    return Command(summary or summary_of(module, name), (add,), lambda options: _run(kind, options))


def _of_class(kind: str) -> Mapping[str, Any]:
    """Return attributes and settings of an analysis of another package by name, as `declared` does of this one's."""
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
    """Check the input of an analysis; compute and print its result, unless the file of the result holds it."""
    about: Any = _class_of(kind)
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
            options.advise(KEPT, *again)
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

    def computed(out: Path) -> "nullcontext[xarray.Dataset]":
        options.advise(KEPT, "orbits", file, "-o", str(out))
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


# Declarations in the source of studies.


PACKAGE = Path(__file__).parents[1]


class DeclaredSetting(NamedTuple):
    """A setting: its meaning, its default (None if the source computes it), and the name of its value in `--help`."""

    help: str = ""
    default: Any = None
    metavar: str | None = None


def summary_of(module: str, name: str) -> str:
    """Return the first line of the docstring of a class, without its full stop; parsing the module takes longer."""
    match = re.search(rf'^class {name}\b[^:]*:\n    """(.+?)\.?("""|\n)', _source(module), re.MULTILINE)
    return match[1] if match else ""


@cache
def declared(module: str) -> "Declared":
    """Return the declarations of a module of this package."""
    return Declared(ast.parse(_source(module)).body)


def _source(module: str) -> str:
    path = PACKAGE.joinpath(*module.split(".")[1:])
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    return path.read_text(encoding="utf-8")


class Declared(dict[str, Any]):
    """The constants and classes of a module, each evaluated when it is looked up.

    A class is a dict of its attributes, with those of its bases. What calls a function is unknown: its name is missing.
    """

    def __init__(self, body: Sequence[ast.stmt]) -> None:
        self._definitions = dict(_definitions(body))

    def __missing__(self, name: str) -> Any:
        self[name] = self._evaluated(name, self._definitions[name])
        return self[name]

    def _evaluated(self, name: str, node: ast.AST) -> Any:
        match node:
            case ast.ImportFrom(module=str(home)) if home.startswith("vibrojax."):
                return declared(home)[name]
            case ast.ClassDef():
                return self._attributes(node)
            case ast.Call(func=ast.Name(id="setting"), args=[default, meaning]):
                return DeclaredSetting(self._evaluated("", meaning), self._default(default))
            case ast.Call(func=ast.Name(id="field"), keywords=keywords):
                values = {str(keyword.arg): keyword.value for keyword in keywords}
                about = self._evaluated("", values["metadata"])
                return DeclaredSetting(about.get("help", ""), self._default(values["default"]), about.get("metavar"))
            case ast.expr():
                return eval(compile(ast.Expression(node), "<source>", "eval"), {}, self)
        raise KeyError(name)

    def _default(self, node: ast.expr) -> Any:
        with suppress(Exception):
            return self._evaluated("", node)
        return None

    def _attributes(self, node: ast.ClassDef) -> dict[str, Any]:
        attributes: dict[str, Any] = {}
        for base in node.bases:
            with suppress(KeyError):  # a class of another package
                attributes |= self[ast.unparse(base.value if isinstance(base, ast.Subscript) else base)]
        for name, value in _definitions(node.body):
            with suppress(Exception):  # pictures and the like, which need functions
                attributes[name] = self._evaluated(name, value)
        return attributes


def _definitions(body: Sequence[ast.stmt]) -> Iterator[tuple[str, ast.AST]]:
    """Yield each name that statements define, with its value, class or import."""
    for node in body:
        match node:
            case ast.ImportFrom():
                yield from ((alias.name, node) for alias in node.names)
            case ast.ClassDef():
                yield node.name, node
            case ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value):
                yield name, value
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                yield name, value
            case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Tuple(elts=values)):
                yield from zip(map(ast.unparse, names), values, strict=True)
