"""The commands of analyses of a sweep: FILE, an option for each setting, OUT, and a printed summary.

They are `orbits`, `curves`, `attractors`, `borders`, and the analyses of installed packages.
"""

import dataclasses
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vibrojax.cli.command import (
    JSON,
    Command,
    Options,
    argument,
    command,
    named_values,
    output_options,
    whole,
)
from vibrojax.cli.output import (
    answer,
    draw,
    output,
    result_at,
    stored_line,
    stored_picture,
    stored_result,
    write_result,
)
from vibrojax.errors import InputError, Place, counted, shown

if TYPE_CHECKING:
    import xarray

    from vibrojax.studies.analysis import Analysis

_SWEEP = "a sweep: a bundled name, like regime-map, or the path of a TOML file; or "

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


def analysis_command(kind: str, summary: str) -> Command:
    """Return the command of one kind of analysis; the analysis is imported only when the command is used."""

    def add_settings(parser: Any) -> None:
        for option, field in _settings(_analysis_class(kind)).items():
            metavar = field.metadata.get("metavar", field.name.upper())
            parser.add_argument(option, metavar=metavar, help=field.metadata.get("help"))

    about = "the dataset of a sweep (.nc), which is run again where it lacks what the analysis needs"
    file = argument("file", "FILE", _SWEEP + about)
    return Command(
        summary, (file, add_settings, output_options(f"NAME-{kind}.nc")), lambda options: _run(kind, options)
    )


def _analysis_class(kind: str) -> "type[Analysis]":
    from vibrojax.studies.analysis import analysis_named

    analysis = analysis_named(kind)
    assert analysis is not None  # commands exist only for known kinds
    return type(analysis)


def _settings(analysis: "type[Analysis]") -> "dict[str, dataclasses.Field[Any]]":
    """Return the settings of an analysis, which are the fields of its dataclass, keyed by command-line option."""
    if not dataclasses.is_dataclass(analysis):
        return {}
    return {f"--{field.name.replace('_', '-')}": field for field in dataclasses.fields(analysis)}


def _run(kind: str, options: Options) -> None:
    from vibrojax.io.dataset import open_dataset
    from vibrojax.maps.rerun import holds_orbits
    from vibrojax.studies.analysis import analyse, checked_result
    from vibrojax.studies.sweep_analysis import SweepAnalysis

    analysis_class = _analysis_class(kind)
    given = {
        option: (field, text)
        for option, field in _settings(analysis_class).items()
        if (text := getattr(options, field.name)) is not None
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
