"""What a command writes: checked before any work, and drawn after it."""

import os
import shlex
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from vibrojax.cli._command import Options
from vibrojax.errors import InputError, shown
from vibrojax.progress import timed

if TYPE_CHECKING:
    import xarray

PICTURES = (".png", ".pdf", ".svg")
ZARR = ".zarr"


def output(path: str | Path, endings: Sequence[str] = (".nc",)) -> Path:
    """`path` as one that can be written.

    **Raises:** `InputError` where it cannot be written, or does not end in one of `endings`.
    """
    path = Path(path)
    at = f"-o: {shown(str(path))}"
    if path.suffix not in endings:
        raise InputError(f"{at} does not end in {' or '.join(endings)}; give the name of such a file")
    if path.is_dir() and path.suffix != ZARR:
        raise InputError(f"{at} is a folder; give the name of a file")
    folder = path.parent
    if not folder.is_dir():
        problem = "is not a folder" if folder.exists() else "does not exist"
        raise InputError(f"{at}: {shown(str(folder))} {problem}; give a file in a folder that is there")
    if path.exists() and not os.access(path, os.W_OK):
        raise InputError(f"{at} is write-protected; give another file")
    try:
        with tempfile.TemporaryFile(dir=folder):
            return path
    except OSError as error:
        raise InputError(f"{at}: folder {shown(str(folder))} cannot be written ({error.strerror})") from None


def picture_beside(path: Path) -> Path:
    """The picture that lies beside the dataset at `path`, as one that can be written."""
    return output(path.with_suffix(".png"), PICTURES)


class Result(NamedTuple):
    """Where a result goes, and its `picture`; and what it depends on, see [vibrojax.io.finished][]."""

    out: Path
    picture: Path
    identity: Mapping[str, object]


def result_at(options: Options, default: str, identity: Mapping[str, object]) -> Result:
    """Where a result goes, by `default` to a file of that name; raises `InputError` where it cannot, or something else
    is there."""
    from vibrojax.io.finished import check_replaceable

    out = output(options.out or default)
    picture = picture_beside(out)
    if not options.fresh:
        check_replaceable(out, identity)
    return Result(out, picture, identity)


def result_written(options: Options, dataset: "xarray.Dataset", result: Result) -> str:
    """Write a result, and draw it; what to say of its picture."""
    from vibrojax.io.dataset import write_dataset
    from vibrojax.io.finished import IDENTITY, identity_text

    with timed("write"):
        write_dataset(dataset.assign_attrs({IDENTITY: identity_text(result.identity)}), result.out)
    dataset_written(options, result.out)
    return draw(dataset, result.picture)


def dataset_written(options: Options, out: Path) -> None:
    """From here on an interrupt costs no more than the picture of the dataset at `out`, and says so."""
    options.how_to_resume = f"{out} is whole; for its picture: {shlex.join(['vibrojax', 'plot', str(out)])}"


def draw(dataset: "xarray.Dataset", picture: Path) -> str:
    """Draw the picture that fits a dataset.

    **Returns:** what to say of it behind the dataset's name; nothing where there is none, for which stderr has why.
    """
    from vibrojax.analyses.pictures import save_picture

    try:
        with timed("draw"):
            part = save_picture(dataset, picture)
    except InputError as nothing:  # the dataset is written, and that is what was asked for
        print(f"no picture: {nothing}", file=sys.stderr)
        return ""
    return f"; picture {picture}" + (f" ({part})" if part else "")
