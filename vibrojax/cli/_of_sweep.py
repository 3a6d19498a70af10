"""What commands share that make a dataset from a sweep's orbits: their arguments, and how they read and write."""

import shlex
from argparse import ArgumentParser
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from vibrojax.cli._command import Options
from vibrojax.cli._complete import files, with_completer
from vibrojax.cli._output import dataset_written, draw, output, picture_beside
from vibrojax.timings import timed

if TYPE_CHECKING:
    import xarray

    from vibrojax.input.definition import Sweep


def add_arguments(parser: ArgumentParser, sweep: str, result: str) -> None:
    """Add FILE, `sweep` or its dataset, and where to write NAME-`result`.nc, to `parser`."""
    file = parser.add_argument(
        "file",
        metavar="FILE",
        help=f"{sweep}: a bundled name, like regime-map, or the path of a TOML file; or a sweep's dataset (.nc), which "
        "is run again where it has no orbits",
    )
    with_completer(file, files(".toml", ".nc"))
    parser.add_argument("-o", dest="out", metavar="OUT.nc", help=f"where to write (NAME-{result}.nc in this folder)")
    parser.add_argument("--fresh", action="store_true", help="replace OUT, whatever it holds")


def read_source(given: str) -> "xarray.Dataset | Sweep":
    """The dataset, or the sweep with orbits, that FILE names; raises `InputError` where it is neither."""
    from vibrojax.found_orbits import sweep_with_orbits
    from vibrojax.store.dataset import open_dataset

    return open_dataset(Path(given)) if given.endswith(".nc") else sweep_with_orbits(given)


class Result(NamedTuple):
    """The command that makes a result, where it goes, and its `picture`; and what it depends on, see
    [vibrojax.store.finished][]."""

    name: str
    out: Path
    picture: Path
    identity: Mapping[str, object]


@contextmanager
def lanes_of(
    options: Options, source: "xarray.Dataset | Sweep", sweep: "Sweep", result: "Result"
) -> Iterator["xarray.Dataset"]:
    """The dataset of the sweep with orbits: `source`, where it is that; else computed, and its finished chunks are kept
    beside the result until that is written, so that an interrupt costs none of them."""
    import xarray

    from vibrojax.sweep import lanes_beside

    if isinstance(source, xarray.Dataset) and "orbit_reason" in source:
        yield source
        return
    options.how_to_resume = f"finished chunks are kept; to go on: {_command(options, result.name, result.out)}"
    with lanes_beside(sweep, result.out, resume=not options.fresh, progress=not options.quiet) as dataset:
        yield dataset


def result_of(options: Options, name: str, result: str, identity: Mapping[str, object]) -> Result:
    """Where the `result` of a sweep of this `name` goes; raises `InputError` where it cannot, or something else is
    there. An interrupt says how to begin again."""
    from vibrojax.store.finished import check_replaceable

    given = str(options.file)
    out = output(options.out or f"{Path(given).stem if given.endswith('.nc') else name}-{result}.nc")
    picture = picture_beside(out)
    if not options.fresh:
        check_replaceable(out, identity)
    options.how_to_resume = f"nothing is kept of what was computed; to begin again: {_command(options, result, out)}"
    return Result(result, out, picture, identity)


def _command(options: Options, result: str, out: Path) -> str:
    axes = ["--axes", options.axes] if getattr(options, "axes", None) else []
    return shlex.join(["vibrojax", result, str(options.file), "-o", str(out), *axes])


def written(options: Options, dataset: "xarray.Dataset", result: Result) -> str:
    """Write a result, and draw it; what to say of its picture."""
    from vibrojax.store.dataset import write_dataset
    from vibrojax.store.finished import IDENTITY, identity_text

    with timed("write"):
        write_dataset(dataset.assign_attrs({IDENTITY: identity_text(result.identity)}), result.out)
    dataset_written(options, result.out)
    return draw(dataset, result.picture)
