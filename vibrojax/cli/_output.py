"""What a command writes: checked before any work, and drawn after it."""

import os
import shlex
import sys
import tempfile
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from vibrojax.errors import InputError, shown

PICTURES = (".png", ".pdf", ".svg")


def output(path: str | Path, endings: Sequence[str] = (".nc",)) -> Path:
    """`path` as one that can be written, with one of `endings`; raises `InputError` where it cannot."""
    path = Path(path)
    at = f"-o: {shown(str(path))}"
    if path.suffix not in endings:
        raise InputError(f"{at} does not end in {' or '.join(endings)}; give the name of such a file")
    if path.is_dir():
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


def written(options: Namespace, out: Path) -> None:
    """From here on an interrupt costs no more than the picture of the dataset at `out`."""
    options.how_to_resume = f"{out} is whole; for its picture: {shlex.join(['vibrojax', 'plot', str(out)])}"


def drawn(dataset: object, picture: Path) -> str:
    """Draw the fitting picture; returns how to tell of it, or nothing where there is none (which stderr then says)."""
    from vibrojax.plot import save_picture

    try:
        save_picture(dataset, picture)
    except InputError as nothing:  # the dataset is written, and that is what was asked for
        print(f"no picture: {nothing}", file=sys.stderr)
        return ""
    return f"; picture {picture}"
