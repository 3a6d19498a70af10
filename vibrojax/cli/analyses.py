"""Commands that follow from the class of an analysis: its settings are arguments, its result is written and drawn."""

import re
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import Field
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from vibrojax.cli.command import (
    JSON,
    SWEEP,
    Command,
    Options,
    argument,
    explained,
    named_values,
    output_options,
    point_arguments,
    whole,
)
from vibrojax.cli.output import answer, result_at, stored_line, stored_result, write_result
from vibrojax.errors import InputError, Place, shown

if TYPE_CHECKING:
    import xarray

    from vibrojax.studies.analysis import Analysis
    from vibrojax.studies.subjects import CheckedAnalysis, FileAnalysis, MachineAnalysis

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
    from vibrojax.settings.fields import settings_of
    from vibrojax.settings.run_settings import RunSettings

    many = "; a list, beta=0.3,0.4,0.5, is as many machines, computed together; of several lists the first values "
    many += "belong to one machine, the second ones to the next"
    width = "; those with a tolerance as NAME=VALUE+-HALF_WIDTH, like delta=-0.002+-0.001 or gamma=0.64+-1% (± too)"
    about = f"parameters, and friction{many * analysis.lists}{width * analysis.tolerances}. Also {_START}"
    run = settings_of(RunSettings)
    for name, item in (settings_of(analysis) | {name: run[name] for name in analysis.run_settings}).items():
        if text := item.metadata.get("help"):
            default = item.default if isinstance(item.default, str) else ""
            if isinstance(item.default, (int, float)):
                default = f"{item.default:g}"
            about += f"; {name} ({': '.join(filter(None, (text, default)))})"
    if analysis.terms:
        explained(*analysis.terms)(parser)
    point_arguments(about.replace("%", "%%"), analysis.scenes)(parser)
    output_options(analysis.file or f"SCENE-{analysis.kind}.nc")(parser)
    JSON(parser)


def _run_machines(analysis_class: "type[MachineAnalysis[Any]]", options: Options) -> None:
    from vibrojax.settings.fields import settings_of

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
    for name, item in settings_of(analysis_class).items():
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
    asked, stem = analysis.asked(options.file, columns), Path(options.file).stem
    default = f"{stem}.nc" if stem.endswith(analysis.kind) else f"{stem}-{analysis.kind}.nc"
    if analysis.chunks:
        out = options.out or default
        options.advise("finished chunks are kept; to go on", str(options.command), options.file, "-o", out)
    _answer(options, analysis, asked, default)


def _answer(options: Options, analysis: "CheckedAnalysis[Any]", asked: Any, default: str) -> None:
    """Compute and report what an analysis has checked, unless its file holds the result."""
    from vibrojax.studies.analysis import checked_result

    def compute() -> "xarray.Dataset":
        out = Path(options.out or default)
        return checked_result(analysis, analysis.compute_beside(asked, out, not options.fresh, not options.quiet))

    answer(
        options,
        default,
        analysis.identity(asked),
        compute,
        lambda dataset: analysis.facts(dataset, asked),
        numbered=analysis.numbered,
    )


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


def _add_sweep(analysis: "type[Analysis]", parser: Any) -> None:
    from vibrojax.settings.fields import settings_of

    about = "the dataset of a sweep (.nc), which is run again where it lacks what the analysis needs"
    argument("file", "FILE", SWEEP + about)(parser)
    for name, item in settings_of(analysis).items():
        metavar = item.metadata.get("metavar", name.upper())
        parser.add_argument(_option(name), metavar=metavar, help=item.metadata.get("help"))
    output_options(f"NAME-{analysis.kind}.nc")(parser)


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _run_sweep(analysis_class: "type[Analysis]", options: Options) -> None:
    from vibrojax.io.dataset import open_dataset
    from vibrojax.maps.rerun import holds_orbits
    from vibrojax.settings.fields import settings_of
    from vibrojax.studies.analysis import analyse, checked_result
    from vibrojax.studies.sweep_analysis import SweepAnalysis

    kind = analysis_class.kind
    given = {
        _option(name): (field, text)
        for name, field in settings_of(analysis_class).items()
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
        line = stored_line(options, dataset, out)
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


def _value(option: str, field: "Field[Any]", text: str) -> object:
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
