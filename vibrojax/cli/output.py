"""Options and output of commands: checking files before any work, writing and drawing datasets, and JSON."""

import json
import math
import os
import shlex
import sys
import tempfile
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

from vibrojax.errors import InputError, escape_json, shown
from vibrojax.progress import timed

if TYPE_CHECKING:
    import xarray

PICTURES = (".png", ".pdf", ".svg")
ZARR = ".zarr"


class Options(Namespace):
    """The arguments of a command by name, and the advice printed after an interrupt."""

    command: str | None = None
    version: bool = False
    quiet: bool = False
    verbose: bool = False
    how_to_resume: str = ""
    """Advice printed after an interrupt; a command changes it as it proceeds."""

    def advise(self, state: str, *words: str) -> None:
        """Set the advice: the `state` of the work, and the command `vibrojax WORDS` that continues it."""
        self.how_to_resume = f"{state}: {shlex.join(['vibrojax', *words])}"


@runtime_checkable
class Command(Protocol):
    """The interface of a command's module; the first line of the module's docstring is its summary in `--help`."""

    __doc__: str | None

    def arguments(self, parser: ArgumentParser) -> None:
        """Add the command's arguments to `parser`."""

    def run(self, options: Options) -> None:
        """Run the command.

        **Raises:** `InputError` for bad input, `OSError` if the result cannot be written to the disk.
        """


class ResultFiles(NamedTuple):
    """The files of a result, `out` and `picture`, and everything it depends on (see [vibrojax.io.manifest][])."""

    out: Path
    picture: Path
    identity: Mapping[str, object]


def output(path: str | Path, endings: Sequence[str] = (".nc",)) -> Path:
    """Return `path`, checked to be a writable file.

    **Raises:** `InputError` if the file cannot be written, or its name does not end in one of `endings`.
    """
    path = Path(path)
    place = f"-o: {shown(str(path))}"
    if path.suffix not in endings:
        raise InputError(f"{place} does not end in {' or '.join(endings)}; give the name of such a file")
    if path.is_dir() and path.suffix != ZARR:
        raise InputError(f"{place} is a folder; give the name of a file")
    folder = path.parent
    if not folder.is_dir():
        problem = "is not a folder" if folder.exists() else "does not exist"
        raise InputError(f"{place}: {shown(str(folder))} {problem}; give a file in a folder that exists")
    if path.exists() and not os.access(path, os.W_OK):
        raise InputError(f"{place} is write-protected; give another file")
    try:
        with tempfile.TemporaryFile(dir=folder):
            return path
    except OSError as error:
        raise InputError(f"{place}: folder {shown(str(folder))} cannot be written ({error.strerror})") from None


def output_folder(folder: str, names: Sequence[str]) -> list[Path]:
    """Return the paths of the files `names` in a folder, which is created if it does not exist.

    **Raises:** `InputError` if one of the files cannot be written.
    """
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"-o: {shown(folder)} cannot be made a folder ({error.strerror})") from None
    return [output(Path(folder) / name, (Path(name).suffix,)) for name in names]


def picture_beside(path: Path) -> Path:
    """Return the path of the picture next to the dataset at `path`, checked as in `output`."""
    return output(path.with_suffix(".png"), PICTURES)


def add_output(parser: ArgumentParser, default: str) -> None:
    """Add `-o` and `--fresh` to a parser; `default` is the default file name, in the current folder."""
    parser.add_argument("-o", dest="out", metavar="OUT.nc", help=f"where to write ({default} in this folder)")
    parser.add_argument("--fresh", action="store_true", help="replace OUT, whatever it holds")


def add_json(parser: ArgumentParser) -> None:
    """Add `--json` to a parser."""
    about = "print one JSON object on stdout, and nothing else there; a number that is not finite is null"
    parser.add_argument("--json", action="store_true", help=about)


def result_at(options: Options, default: str, identity: Mapping[str, object]) -> ResultFiles:
    """Return the files of a result; `default` is its file name without `-o`.

    **Raises:** `InputError` if they cannot be written, or `out` holds another result.
    """
    from vibrojax.io.manifest import check_replaceable

    out = output(options.out or default)
    picture = picture_beside(out)
    if not options.fresh:
        check_replaceable(out, identity)
    return ResultFiles(out, picture, identity)


def write_result(options: Options, dataset: "xarray.Dataset", result: ResultFiles) -> str:
    """Write a result and draw it; return the end of an output line, which names the picture."""
    from vibrojax.io.dataset import write_dataset
    from vibrojax.io.manifest import IDENTITY, identity_text

    with timed("write"):
        write_dataset(dataset.assign_attrs({IDENTITY: identity_text(result.identity)}), result.out)
    return draw(options, dataset, result.out, result.picture)


def dataset_written(options: Options, out: Path) -> None:
    """Change the advice after an interrupt: the dataset `out` is complete, and only its picture is missing."""
    options.advise(f"{out} is whole; for its picture", "plot", str(out))


def draw(options: Options, dataset: "xarray.Dataset", out: Path, picture: Path) -> str:
    """Draw the picture of a dataset that has been written to `out`.

    **Returns:** the end of an output line, which names the picture. If nothing can be drawn, the string is empty, and
    the reason is printed on stderr.
    """
    from vibrojax.analyses.pictures import save_picture

    dataset_written(options, out)
    try:
        with timed("draw"):
            part = save_picture(dataset, picture)
    except InputError as error:  # the result, which is the dataset, has been written
        print(f"no picture: {error}", file=sys.stderr)
        return ""
    return f"; picture {picture}" + (f" ({part})" if part else "")


def print_json(facts: Mapping[str, object]) -> None:
    """Print `facts` as one JSON object; a number that is not finite becomes null."""
    print(escape_json(json.dumps(_plain(facts), ensure_ascii=False, allow_nan=False, indent=2)))


def file_facts(result: ResultFiles, drawn: str) -> dict[str, object]:
    """Return the files of a result as JSON values; `drawn` is the return value of `write_result`."""
    return {"dataset": str(result.out), "picture": str(result.picture) if drawn else None}


def _plain(value: Any) -> Any:
    """Return `value` converted to JSON types."""
    if isinstance(value, Mapping):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):  # NumPy and xarray
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, (bool, int, str)) else str(value)
