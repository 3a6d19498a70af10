"""Results of commands: files that are checked before any work, datasets with their pictures, and JSON."""

import json
import math
import os
import re
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from vibrojax.cli.arguments import Options
from vibrojax.errors import InputError, escape_json, shown
from vibrojax.progress import timed

if TYPE_CHECKING:
    import xarray

PICTURES = (".png", ".pdf", ".svg")
ZARR = ".zarr"

NAME_MAX_CHARACTERS = 200
"""Maximum length of a default name without ending; most file systems allow 255 bytes."""

NAME_MAX_WORDS = 3
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


# Pictures and pages.


def view_file(options: Options, file: Path, endings: Sequence[str], parts: Sequence[str]) -> tuple[Path, bool]:
    """Return the path of a picture or page of a dataset, and whether it gets a number where it would replace another.

    The path is that of `-o`, or else the dataset's with `parts` in its name and the first of the `endings`.

    **Raises:** `InputError` if the name has none of the `endings`, or the file cannot be written.
    """
    name = "-".join([file.stem, *(re.sub(r"[^\w.+-]+", "_", part) for part in parts)])
    default = file.with_name(name[:NAME_MAX_CHARACTERS] + endings[0])
    is_numbered = bool(parts) and not options.out
    return output(options.out or default, endings, numbered=is_numbered), is_numbered


def write_view(file: Path, is_numbered: bool, draw: Callable[[Path], object]) -> tuple[Path, bool]:
    """Write a view of `view_file` with the function `draw`; return its path, and whether it replaces another one."""
    before = file.read_bytes() if file.is_file() else None
    if before is None or not is_numbered:
        draw(file)
        return file, before is not None and before != file.read_bytes()
    with tempfile.TemporaryDirectory(prefix=".vibrojax-", dir=file.parent) as folder:
        part = Path(folder) / file.name
        draw(part)
        content = part.read_bytes()
        path = _numbered(file, lambda other: other.is_file() and other.read_bytes() == content)
        os.replace(part, path)
    return path, False


def shortened(words: Sequence[str]) -> list[str]:
    """Return the parts of a name that state `words`: all of them, or the first ones and a count."""
    more = len(words) - NAME_MAX_WORDS
    return [*words[:NAME_MAX_WORDS], f"and-{more}-more"] if more > 0 else list(words)


# Results.


class Result(NamedTuple):
    """The dataset of a command, its file, and the last line of the output, which names file and picture."""

    dataset: "xarray.Dataset"
    out: Path
    line: str

    def print(
        self, options: Options, lines: Sequence[str] | None = None, facts: Mapping[str, object] | None = None
    ) -> None:
        """Print the summary, as text or with `--json` as one object; `lines`, `facts`: by default the analysis's.

        With `--quiet`, the text does not end with the names of the files.
        """
        from vibrojax.studies.analysis import analysis_of

        parts = analysis_of(self.dataset).summary(self.dataset) if lines is None or facts is None else []
        if options.json:
            picture = self.out.with_suffix(".png")
            files = {"dataset": str(self.out), "picture": str(picture) if f"picture {picture}" in self.line else None}
            print_json({**({k: x for p in parts for k, x in p.facts.items()} if facts is None else facts), **files})
        else:
            own = [line for part in parts for line in part.lines] if lines is None else lines
            for line in [*own, *([] if options.quiet else [self.line])]:
                print(line)


def result(
    options: Options,
    default: str,
    identity: Mapping[str, object],
    computed: Callable[[Path, ExitStack], "xarray.Dataset"],
    *,
    endings: Sequence[str] = (".nc",),
    numbered: bool = False,
    reused: bool = True,
    written: bool = False,
    counted: Callable[["xarray.Dataset"], str] = lambda _: "",
    variables: Sequence[str] = (),
) -> Result:
    """Return the result with this `identity`: the one that its file holds, or else a new one, written and drawn.

    **Arguments:**

    - `default`: name of the file without `-o`; `endings`: the accepted ones. `numbered`: whether results without `-o`
      get a number where they would replace others.
    - `computed`: function of the path of the file that returns the dataset. Contexts that it enters into the stack end
      when the dataset is written. `written`: whether it has been written already.
    - `reused`: False if the identity does not say everything on which the result depends.
    - `counted`: function of the dataset that says in the last line how much there is of what. `variables`: those that
      the picture shows, as far as the dataset has them; empty: those that fit it.

    **Raises:** `InputError` if the file or its picture cannot be written, or the file holds another result.
    """
    from vibrojax.io.dataset import open_dataset
    from vibrojax.io.identity import IDENTITY, check_replaceable, holds, identity_text
    from vibrojax.io.writers import write_dataset
    from vibrojax.maps.store import CHUNKS

    def file() -> Path:
        if numbered and options.out is None:
            return output(_numbered(Path(default), lambda path: holds(path, identity), options.fresh), drawn=True)
        return output(options.out or default, endings, drawn=True)

    out = file()
    if not options.fresh:
        check_replaceable(out, identity)
        # Chunks beside a dataset belong to a run that was interrupted while it replaced the dataset.
        if reused and out.exists() and not out.with_name(out.name + CHUNKS).exists():
            with timed("read"):
                dataset = open_dataset(out)
            picture = out.with_suffix(".png")
            drawn = f"; picture {picture}" if picture.exists() else draw(options, dataset, out, variables)
            known = f"is there already ({dataset.attrs['source']}); it is not computed again without --fresh"
            return Result(dataset, out, f"{out}: {known}{drawn}")
    with ExitStack() as until_written:
        dataset = computed(out, until_written)
        if not written:
            out = file() if numbered else out  # another process may have taken the number
            with timed("write"):
                write_dataset(dataset.assign_attrs({IDENTITY: identity_text(identity)}), out)
    return Result(dataset, out, f"{out}{counted(dataset)}{draw(options, dataset, out, variables)}")


def draw(options: Options, dataset: "xarray.Dataset", out: Path, variables: Sequence[str] = ()) -> str:
    """Draw the picture of a dataset, or of its `variables`, next to its file `out`, which is complete.

    **Returns:** the end of an output line, which names the picture. If nothing can be drawn, the string is empty, and
    the reason is printed on stderr.
    """
    from vibrojax.studies.choose import save_picture

    options.advise(f"{out} is whole; for its picture", "plot", str(out))
    picture = out.with_suffix(".png")
    try:
        with timed("draw"):
            part = save_picture(dataset, picture, [name for name in variables if name in dataset] or None)
    except InputError as error:  # the result, which is the dataset, has been written
        print(f"no picture: {error}", file=sys.stderr)
        return ""
    return f"; picture {picture}" + (f" ({part})" if part else "")


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
