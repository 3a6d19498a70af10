"""Output of commands: checking files before any work, writing and drawing datasets, and JSON."""

import json
import math
import os
import re
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vibrojax.cli.command import Options
from vibrojax.errors import InputError, escape_json, shown
from vibrojax.progress import timed

if TYPE_CHECKING:
    import xarray

PICTURES = (".png", ".pdf", ".svg")
ZARR = ".zarr"

_NAME_MAX_CHARACTERS = 200
"""Maximum length of a default name without ending; most file systems allow 255 bytes."""

_MAX_WORDS = 3
"""Maximum number of variables, values or datasets that a default name states."""


def output(path: str | Path, endings: Sequence[str] = (".nc",), *, drawn: bool = False, numbered: bool = False) -> Path:
    """Return `path`, checked to be a writable file; `drawn`: also check the picture next to it.

    `numbered`: whether another file at `path` stays, and the new one gets a number.

    **Raises:** `InputError` if the file cannot be written, its name does not end in one of `endings`, or it exists and
    this package has not written it.
    """
    from vibrojax.io.identity import check_ours

    path = Path(path)
    place = f"-o: {shown(str(path))}"
    if path.suffix not in endings:
        raise InputError(f"{place} does not end in {' or '.join(endings)}; give the name of such a file")
    if path.is_dir() and path.suffix != ZARR:
        raise InputError(f"{place} is a folder; give the name of a file")
    folder = path.parent
    if not numbered:
        check_ours(path)
    if not folder.is_dir():
        problem = "is not a folder" if folder.exists() else "does not exist"
        raise InputError(f"{place}: {shown(str(folder))} {problem}; give a file in a folder that exists")
    if path.exists() and not os.access(path, os.W_OK):
        raise InputError(f"{place} is write-protected; give another file")
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(f"{place}: folder {shown(str(folder))} cannot be written ({error.strerror})") from None
    if drawn:
        output(path.with_suffix(".png"), PICTURES)
    return path


def view_path(options: Options, file: Path, endings: Sequence[str], parts: Sequence[str]) -> Path:
    """Return the path of the picture or page of a dataset: `-o`, or the dataset's name, `parts` and the first ending.

    **Raises:** `InputError` if the name has none of the `endings`, or the file cannot be written.
    """
    name = "-".join([file.stem, *(re.sub(r"[^\w.+-]+", "_", part) for part in parts)])
    default = file.with_name(name[:_NAME_MAX_CHARACTERS] + endings[0])
    return output(options.out or default, endings, numbered=bool(parts) and not options.out)


def write_view(path: Path, write: Callable[[Path], object], *, numbered: bool) -> tuple[Path, str]:
    """Write a picture or page with the function `write`; return its path, and a note if it replaces another one.

    `numbered`: whether the view is numbered where it would replace another one.
    """
    before = path.read_bytes() if path.is_file() else None
    if not numbered or before is None:
        write(path)
        return path, "replaces another" if before is not None and before != path.read_bytes() else ""
    with tempfile.TemporaryDirectory(prefix=".vibrojax-", dir=path.parent) as folder:
        part = Path(folder) / path.name
        write(part)
        content = part.read_bytes()
        path = _numbered(path, lambda other: other.is_file() and other.read_bytes() == content)
        os.replace(part, path)
    return path, ""


def shortened(words: Sequence[str]) -> list[str]:
    """Return the parts of a name that state `words`: all of them, or the first ones and a count."""
    more = len(words) - _MAX_WORDS
    return [*words[:_MAX_WORDS], f"and-{more}-more"] if more > 0 else list(words)


def output_folder(folder: str, names: Sequence[str]) -> list[Path]:
    """Return the paths of the files `names` in a folder, which is created if it does not exist.

    **Raises:** `InputError` if one of the files cannot be written.
    """
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"-o: {shown(folder)} cannot be made a folder ({error.strerror})") from None
    return [output(Path(folder) / name, (Path(name).suffix,)) for name in names]


def result_at(options: Options, default: str, identity: Mapping[str, object], *, numbered: bool = False) -> Path:
    """Return the file of a result, which depends on `identity`: `default` without `-o`.

    With `numbered`, results without `-o` get a number where they would replace others.

    **Raises:** `InputError` if the file or its picture cannot be written, or the file holds another result.
    """
    from vibrojax.io.identity import check_replaceable, holds

    if numbered and options.out is None:
        return output(_numbered(Path(default), lambda path: holds(path, identity), options.fresh), drawn=True)
    out = output(options.out or default, drawn=True)
    if not options.fresh:
        check_replaceable(out, identity)
    return out


def _numbered(default: Path, is_result: Callable[[Path], bool], fresh: bool = False) -> Path:
    """Return the one of the files NAME, NAME-2, NAME-3, ... that holds a result, or the first that does not exist.

    `fresh`: return NAME if no file holds the result.
    """
    name = re.compile(re.escape(default.stem) + r"-([2-9]|[1-9]\d+)" + re.escape(default.suffix))
    numbers = {int(match[1]) for path in default.parent.iterdir() if (match := name.fullmatch(path.name))}

    def numbered(number: int) -> Path:
        return default.with_stem(f"{default.stem}-{number}")

    for path in (default, *map(numbered, sorted(numbers))):
        if path.exists() and is_result(path):
            return path
    if fresh or not default.exists():
        return default
    return numbered(next(number for number in count(2) if number not in numbers))


def stored_result(options: Options, out: Path, identity: Mapping[str, object]) -> "xarray.Dataset | None":
    """Return the finished result with this `identity` at `out`, or None if there is none, or with `--fresh`."""
    from vibrojax.io.identity import holds
    from vibrojax.maps.store import CHUNKS

    # Chunks beside a dataset belong to a run that was interrupted while it replaced the dataset.
    if options.fresh or out.with_name(out.name + CHUNKS).exists() or not holds(out, identity):
        return None
    from vibrojax.io.dataset import open_dataset

    with timed("read"):
        return open_dataset(out)


def stored_line(options: Options, dataset: "xarray.Dataset", out: Path, variables: Sequence[str] | None = None) -> str:
    """Return the output line of a result that `out` holds already; draw the picture next to `out` if it is missing."""
    picture = out.with_suffix(".png")
    drawn = f"; picture {picture}" if picture.exists() else draw(options, dataset, out, variables)
    return f"{out}: is there already ({dataset.attrs['source']}); it is not computed again without --fresh{drawn}"


def write_result(options: Options, dataset: "xarray.Dataset", out: Path, identity: Mapping[str, object]) -> str:
    """Write a result and draw it; return the end of an output line, which names the picture."""
    from vibrojax.io.dataset import write_dataset
    from vibrojax.io.identity import IDENTITY, identity_text

    with timed("write"):
        write_dataset(dataset.assign_attrs({IDENTITY: identity_text(identity)}), out)
    return draw(options, dataset, out)


def draw(options: Options, dataset: "xarray.Dataset", out: Path, variables: Sequence[str] | None = None) -> str:
    """Draw the picture of a dataset, or of its `variables`, next to its file `out`, which is complete.

    **Returns:** the end of an output line, which names the picture. If nothing can be drawn, the string is empty, and
    the reason is printed on stderr.
    """
    from vibrojax.studies.choose import save_picture

    dataset_written(options, out)
    picture = out.with_suffix(".png")
    try:
        with timed("draw"):
            part = save_picture(dataset, picture, variables)
    except InputError as error:  # the result, which is the dataset, has been written
        print(f"no picture: {error}", file=sys.stderr)
        return ""
    return f"; picture {picture}" + (f" ({part})" if part else "")


def dataset_written(options: Options, out: Path) -> None:
    """Change the advice after an interrupt: the dataset `out` is complete, and only its picture is missing."""
    options.advise(f"{out} is whole; for its picture", "plot", str(out))


def answer(
    options: Options,
    default: str,
    identity: Mapping[str, object],
    compute: Callable[[], "xarray.Dataset"],
    facts: Callable[["xarray.Dataset"], Mapping[str, object] | None] = lambda _: None,
    *,
    numbered: bool = False,
) -> None:
    """Compute a result, write and draw it, and print its summary as text, or with `--json` its `facts`.

    By default, the analysis's summary gives the facts. A result that its file holds already is only printed.
    `default`, `identity`, `numbered`: as for `result_at`.
    """
    out = result_at(options, default, identity, numbered=numbered)
    from vibrojax.studies.analysis import analysis_of

    dataset = stored_result(options, out, identity)
    if dataset is None:
        dataset = compute()
        if numbered and options.out is None:  # another process may have taken the number
            out = result_at(options, default, identity, numbered=True)
        drawn = write_result(options, dataset, out, identity)
        last = f"{out}{drawn}"
    else:
        last = drawn = stored_line(options, dataset, out)
    if options.quiet and not options.json:
        return
    parts = analysis_of(dataset).summary(dataset)
    if options.json:
        own = facts(dataset)
        own = {key: fact for part in parts for key, fact in part.facts.items()} if own is None else own
        print_json({**own, **file_facts(out, drawn)})
    else:
        print("\n".join([*(line for part in parts for line in part.lines), last]))


def file_facts(out: Path, drawn: str) -> dict[str, object]:
    """Return the files of a result as JSON values; `drawn` is the return value of `draw` or `stored_line`."""
    picture = out.with_suffix(".png")
    return {"dataset": str(out), "picture": str(picture) if drawn and picture.exists() else None}


def print_json(facts: Mapping[str, object]) -> None:
    """Print `facts` as one JSON object; a number that is not finite becomes null."""
    print(escape_json(json.dumps(_plain(facts), ensure_ascii=False, allow_nan=False, indent=2)))


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):  # NumPy and xarray
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, (bool, int, str)) else str(value)
