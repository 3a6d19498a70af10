"""What commands share that make a dataset from a sweep's orbits: arguments, what they read and where they write."""

import shlex
from argparse import ArgumentParser
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from vibrojax.cli._command import Options
from vibrojax.cli._complete import files, with_completer
from vibrojax.cli._output import Result, result_at

if TYPE_CHECKING:
    import xarray

    from vibrojax.sweep.input.definition import Sweep


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
    from vibrojax.analyses.orbits.rerun import sweep_with_orbits
    from vibrojax.io.dataset import open_dataset

    return open_dataset(Path(given)) if given.endswith(".nc") else sweep_with_orbits(given)


@contextmanager
def lanes_of(
    options: Options, source: "xarray.Dataset | Sweep", sweep: "Sweep", name: str, out: Path
) -> Iterator["xarray.Dataset"]:
    """The dataset of the sweep with orbits: `source`, where it is that; else computed, and its finished chunks are kept
    beside `out` until the command of this `name` has written it, so that an interrupt costs none of them."""
    import xarray

    from vibrojax.analyses.sweep.run import lanes_beside

    if isinstance(source, xarray.Dataset) and "orbit_reason" in source:
        yield source
        return
    options.how_to_resume = f"finished chunks are kept; to go on: {_command(options, name, out)}"
    with lanes_beside(sweep, out, resume=not options.fresh, progress=not options.quiet) as dataset:
        yield dataset


def result_of(options: Options, name: str, result: str, identity: Mapping[str, object]) -> Result:
    """Where the `result` of a sweep of this `name` goes; raises `InputError` where it cannot, or something else is
    there. An interrupt says how to begin again."""
    given = str(options.file)
    found = result_at(options, f"{Path(given).stem if given.endswith('.nc') else name}-{result}.nc", identity)
    again = _command(options, result, found.out)
    options.how_to_resume = f"nothing is kept of what was computed; to begin again: {again}"
    return found


def _command(options: Options, result: str, out: Path) -> str:
    axes = ["--axes", options.axes] if getattr(options, "axes", None) else []
    return shlex.join(["vibrojax", result, str(options.file), "-o", str(out), *axes])
