"""The command of an analysis of a sweep: FILE, an option for each setting, OUT, and a printed summary.

The package's analyses `attractors` and `borders`, and the analyses of installed packages, use this module.
"""

import dataclasses
from argparse import ArgumentParser
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vibrojax.cli.completion import add_argument, files
from vibrojax.cli.output import Options, add_output, result_at, write_result
from vibrojax.errors import InputError, shown

if TYPE_CHECKING:
    from vibrojax.analyses.analysis import Analysis


class AnalysisCommand:
    """The command of one kind of analysis; the analysis is imported only when the command is used."""

    def __init__(self, kind: str, summary: str) -> None:
        self.kind = kind
        self.__doc__ = summary

    @property
    def analysis(self) -> "type[Analysis]":
        """The class of the analysis."""
        from vibrojax.analyses.registry import analysis_named

        analysis = analysis_named(self.kind)
        assert analysis is not None  # commands exist only for known kinds
        return type(analysis)

    @property
    def fields(self) -> "dict[str, dataclasses.Field[Any]]":
        """The settings of the analysis, which are the fields of its dataclass, keyed by command-line option."""
        if not dataclasses.is_dataclass(self.analysis):
            return {}
        return {f"--{field.name.replace('_', '-')}": field for field in dataclasses.fields(self.analysis)}

    def arguments(self, parser: ArgumentParser) -> None:
        """Add FILE, `-o`, `--fresh`, and an option for each setting."""
        about = "a sweep: a bundled name, like regime-map, or the path of a TOML file; or the dataset of a sweep "
        about += "(.nc), which is run again where it lacks what the analysis needs"
        add_argument(parser, "file", completer=files(".toml", ".nc"), metavar="FILE", help=about)
        for option, field in self.fields.items():
            metavar = field.metadata.get("metavar", field.name.upper())
            parser.add_argument(option, metavar=metavar, help=field.metadata.get("help"))
        add_output(parser, f"NAME-{self.kind}.nc")

    def run(self, options: Options) -> None:
        """Run the analysis, write and draw its dataset, and print its summary."""
        from vibrojax.analyses.orbits.analysis import SweepAnalysis
        from vibrojax.analyses.registry import analyse, checked_result
        from vibrojax.io.dataset import open_dataset

        texts = {option: getattr(options, field.name) for option, field in self.fields.items()}
        given = {option: field for option, field in self.fields.items() if texts[option] is not None}
        settings = {field.name: _value(option, field, texts[option]) for option, field in given.items()}
        analysis = self.analysis(**settings)
        kind, file, progress = analysis.kind, str(options.file), not options.quiet
        is_dataset = file.endswith(".nc")
        source: Any = open_dataset(Path(file)) if is_dataset else file
        sweep, identity = None, {kind: True, "file": file, **{name: str(value) for name, value in settings.items()}}
        if isinstance(analysis, SweepAnalysis):
            sweep = analysis.sweep(source)
            identity = {**analysis.identity(sweep), **sweep.identity()}
        name = Path(file).stem if sweep is None or is_dataset else sweep.name
        result = result_at(options, f"{name}-{kind}.nc", identity)
        words = [kind, file, "-o", str(result.out), *(word for item in texts.items() if item[1] for word in item)]
        options.advise("nothing was kept; to begin again", *words)
        if isinstance(analysis, SweepAnalysis) and sweep is not None:
            lanes_of: Any = nullcontext(source)
            if not (is_dataset and "orbit_reason" in source):
                from vibrojax.analyses.sweep.run import lanes_beside

                # Finished chunks are kept next to OUT until the result is written, so an interrupt loses none of them.
                options.advise("finished chunks are kept; to go on", *words)
                lanes_of = lanes_beside(sweep, result.out, resume=not options.fresh, progress=progress)
            with lanes_of as lanes:
                dataset = checked_result(analysis, analysis.of_lanes(sweep, lanes, progress))
                drawn = write_result(options, dataset, result)
        else:
            dataset = analyse(source, analysis, progress=progress)
            drawn = write_result(options, dataset, result)
        if progress:
            count = f": {dataset.sizes[analysis.counted]} {analysis.counted}s" if analysis.counted else ""
            print(f"{result.out}{count}{drawn}")
            for line in (line for part in analysis.summary(dataset) for line in part.lines):
                print(line)


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
