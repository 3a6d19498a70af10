"""Find the attractors that a sweep's starts lead to, and the share of starts of each."""

from argparse import ArgumentParser
from typing import TYPE_CHECKING

from vibrojax.cli._command import Options
from vibrojax.cli._json import flags
from vibrojax.cli._of_sweep import add_arguments, lanes_of, read_source, result_of
from vibrojax.cli._output import result_written

if TYPE_CHECKING:
    import xarray

_SHOWN = 12
"""Attractors that are told one by one."""


def arguments(parser: ArgumentParser) -> None:
    """Add the command's arguments to `parser`."""
    add_arguments(parser, "a sweep with starts", "attractors")


def run(options: Options) -> None:
    """Run the command."""
    from vibrojax.analyses.attractors.run import attractors_of, sweep_of

    source = read_source(str(options.file))
    sweep = sweep_of(source)
    result = result_of(options, sweep.name, "attractors", {"attractors": True, **sweep.identity()})
    with lanes_of(options, source, sweep, "attractors", result.out) as lanes:
        dataset = attractors_of(sweep, lanes)
        drawn = result_written(options, dataset, result)
    if not options.quiet:
        print(f"{result.out}: {dataset.sizes['attractor']} attractors{drawn}")
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
