"""Find the attractors that a sweep's starts lead to, and the share of starts of each."""

import shlex
from argparse import ArgumentParser
from pathlib import Path
from typing import TYPE_CHECKING

from vibrojax.cli._command import Options
from vibrojax.cli._complete import files, with_completer
from vibrojax.cli._json import flags
from vibrojax.cli._output import dataset_written, draw, output, picture_beside
from vibrojax.timings import timed

if TYPE_CHECKING:
    import xarray

_SHOWN = 12
"""Attractors that are told one by one."""


def arguments(parser: ArgumentParser) -> None:
    """Add the command's arguments to `parser`."""
    file = parser.add_argument(
        "file",
        metavar="FILE",
        help="a sweep with starts: a bundled name, like regime-map, or the path of a TOML file; or a sweep's dataset "
        "(.nc), which is run again where it has no orbits",
    )
    with_completer(file, files(".toml", ".nc"))
    parser.add_argument("-o", dest="out", metavar="OUT.nc", help="where to write (NAME-attractors.nc in this folder)")
    parser.add_argument("--fresh", action="store_true", help="replace OUT, whatever it holds")


def run(options: Options) -> None:
    """Run the command."""
    from vibrojax.found_attractors import attractors, sweep_of
    from vibrojax.found_orbits import sweep_with_orbits
    from vibrojax.store.dataset import open_dataset, write_dataset
    from vibrojax.store.finished import IDENTITY, check_replaceable, identity_text

    given = str(options.file)
    source = open_dataset(Path(given)) if given.endswith(".nc") else sweep_with_orbits(given)
    sweep = sweep_of(source)
    out = output(options.out or f"{Path(given).stem if given.endswith('.nc') else sweep.name}-attractors.nc")
    picture = picture_beside(out)
    identity = {"attractors": True, **sweep.identity()}
    if not options.fresh:
        check_replaceable(out, identity)
    command = shlex.join(["vibrojax", "attractors", given, "-o", str(out)])
    options.how_to_resume = f"nothing is kept of what was computed; to begin again: {command}"
    dataset = attractors(source, progress=not options.quiet).assign_attrs({IDENTITY: identity_text(identity)})
    with timed("write"):
        write_dataset(dataset, out)
    dataset_written(options, out)
    drawn = draw(dataset, picture)
    if not options.quiet:
        print(f"{out}: {dataset.sizes['attractor']} attractors{drawn}")
        print("\n".join(attractor_lines(dataset)))


def attractor_lines(dataset: "xarray.Dataset") -> list[str]:
    """At how many points how many attractors coexist; of each its share over the grid, its points and its regimes."""
    import numpy as np

    if "lane_attractor" not in dataset:
        return []
    share = dataset["share"].values.reshape(dataset["unassigned"].size, dataset.sizes["attractor"])
    there, counts = np.unique((share > 0).sum(axis=1), return_counts=True)
    points = ", ".join(f"{number} at {count}" for number, count in zip(there.tolist(), counts.tolist(), strict=True))
    lines = [f"at a point: {points} (attractors at points)"]
    lanes = dataset["lane_attractor"].size
    unassigned = int(dataset["unassigned"].sum())
    lines.append(f"{unassigned} of {lanes} lanes unassigned ({100 * unassigned / max(lanes, 1):.1f} %)")
    meanings = flags(dataset["regime"])
    regime = dataset["regime"].values.reshape(share.shape)
    for number in range(min(share.shape[1], _SHOWN)):
        here = share[:, number] > 0
        kinds, sizes = np.unique(regime[here, number], return_counts=True)
        names = ", ".join(meanings[int(kinds[k])] for k in np.argsort(-sizes, kind="stable"))
        lines.append(
            f"{number:>4}{100 * share[:, number].mean():>7.1f} % of starts{int(here.sum()):>7} points  {names}"
        )
    if share.shape[1] > _SHOWN:
        lines.append(f"and {share.shape[1] - _SHOWN} more of smaller shares")
    return lines
