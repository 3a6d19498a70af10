"""The command of an analysis of a sweep: FILE, its settings as options, OUT, and a summary.

The package's `attractors` and `borders` and the analyses that installed packages offer all run through here.
"""

import dataclasses
import shlex
from argparse import ArgumentParser
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vibrojax.cli.completion import files, with_completer
from vibrojax.cli.output import Options, add_output, result_at, write_result
from vibrojax.errors import InputError, shown

if TYPE_CHECKING:
    from vibrojax.analyses.analysis import Analysis

_TYPES = {"int": int, "float": float}


class AnalysisCommand:
    """The command of one kind of analysis, which is imported only when the command is used."""

    def __init__(self, kind: str, summary: str) -> None:
        self.kind = kind
        self.__doc__ = summary

    @property
    def analysis(self) -> "type[Analysis]":
        """The class of the analysis."""
        from vibrojax.analyses.registry import analysis_named

        analysis = analysis_named(self.kind)
        assert analysis is not None  # a command exists only for a kind that is known
        return type(analysis)

    @property
    def fields(self) -> "tuple[dataclasses.Field[Any], ...]":
        """The settings of the analysis: the fields of its dataclass."""
        return dataclasses.fields(self.analysis) if dataclasses.is_dataclass(self.analysis) else ()

    def arguments(self, parser: ArgumentParser) -> None:
        """Add FILE, where to write, and an option for each field."""
        file = parser.add_argument(
            "file",
            metavar="FILE",
            help="a sweep: a bundled name, like regime-map, or the path of a TOML file; or the dataset of a sweep "
            "(.nc), which is run again where it lacks what the analysis needs",
        )
        with_completer(file, files(".toml", ".nc"))
        for field in self.fields:
            metavar = field.metadata.get("metavar", field.name.upper())
            parser.add_argument(f"--{field.name.replace('_', '-')}", metavar=metavar, help=field.metadata.get("help"))
        add_output(parser, f"NAME-{self.kind}.nc")

    def run(self, options: Options) -> None:
        """Run the analysis, write and draw its dataset, and print its summary."""
        from vibrojax.analyses.orbits.analysis import SweepAnalysis
        from vibrojax.analyses.registry import analyse
        from vibrojax.io.dataset import open_dataset

        given = {field.name: getattr(options, field.name) for field in self.fields}
        settings = {f.name: _value(f, given[f.name]) for f in self.fields if given[f.name] is not None}
        analysis = self.analysis(**settings)
        words = [word for name, text in given.items() if text for word in (f"--{name.replace('_', '-')}", text)]
        kind, file = analysis.kind, str(options.file)
        source: Any = open_dataset(Path(file)) if file.endswith(".nc") else file
        sweep, identity = None, {kind: True, "file": file, **{name: str(x) for name, x in settings.items()}}
        if isinstance(analysis, SweepAnalysis):
            sweep = analysis.sweep(source)
            identity = {**analysis.identity(sweep), **sweep.identity()}
        name = Path(file).stem if sweep is None or file.endswith(".nc") else sweep.name
        result = result_at(options, f"{name}-{kind}.nc", identity)
        again = shlex.join(["vibrojax", kind, file, "-o", str(result.out), *words])
        options.how_to_resume = f"nothing was kept; to begin again: {again}"
        keeping: Any = nullcontext()
        if isinstance(analysis, SweepAnalysis) and sweep is not None:
            if file.endswith(".nc") and "orbit_reason" in source:
                keeping = nullcontext(source)
            else:
                from vibrojax.analyses.sweep.run import lanes_beside

                # Finished chunks stay beside OUT until the result is written, so that an interrupt costs none of them.
                options.how_to_resume = f"finished chunks are kept; to go on: {again}"
                keeping = lanes_beside(sweep, result.out, resume=not options.fresh, progress=not options.quiet)
        with keeping as lanes:
            if isinstance(analysis, SweepAnalysis) and sweep is not None:
                dataset = analysis.of_lanes(sweep, lanes, not options.quiet)
            else:
                dataset = analyse(source, analysis, progress=not options.quiet)
            drawn = write_result(options, dataset, result)
        if not options.quiet:
            print(f"{result.out}{drawn}")
            for part in analysis.summary(dataset):
                print("\n".join(part.lines))


def _value(field: "dataclasses.Field[Any]", text: str) -> object:
    """Return the value of an option in the type of its field: a number, a text, or a tuple of them."""
    kind = str(getattr(field.type, "__name__", field.type))
    place = f"--{field.name.replace('_', '-')}"
    if kind.startswith("tuple"):
        items = [item.strip() for item in text.split(",")]
        if not all(items) or (kind.count(",") == 1 and "..." not in kind and len(items) != 2):
            example = field.metadata.get("example", "A,B")
            raise InputError(f"{place}: {shown(text)} is not a pair of names; write two, like {example}")
        return tuple(items)
    convert = next((convert for name, convert in _TYPES.items() if kind.startswith(name)), str)
    try:
        return convert(text)
    except ValueError:
        raise InputError(f"{place}: {shown(text)} is not a number") from None
