"""Draw the borders of the stable single impact in a sweep's plane: curves named by what happens there."""

from argparse import ArgumentParser
from typing import TYPE_CHECKING

from vibrojax.cli._command import Options
from vibrojax.cli._json import flags
from vibrojax.cli._of_sweep import add_arguments, lanes_of, read_source, result_of
from vibrojax.cli._output import result_written
from vibrojax.errors import InputError

if TYPE_CHECKING:
    import xarray


def arguments(parser: ArgumentParser) -> None:
    """Add the command's arguments to `parser`."""
    add_arguments(parser, "a sweep over a grid", "borders")
    parser.add_argument(
        "--axes",
        metavar="X,Y",
        help="the two axes of the plane (gamma and beta, else the two with most values)",
    )


def run(options: Options) -> None:
    """Run the command."""
    from vibrojax.analyses.borders.run import borders_of, checked
    from vibrojax.analyses.orbits.rerun import sweep_with_orbits

    axes = _axes(options.axes)
    source = read_source(str(options.file))
    sweep = sweep_with_orbits(source)
    names = checked(sweep, axes)
    result = result_of(options, sweep.name, "borders", {"borders": list(names), **sweep.identity()})
    with lanes_of(options, source, sweep, "borders", result.out) as lanes:
        dataset = borders_of(sweep, lanes, names)
        drawn = result_written(options, dataset, result)
    if not options.quiet:
        print(f"{result.out}: {dataset.sizes['curve']} curves{drawn}")
        print("\n".join(border_lines(dataset)))


def _axes(text: str | None) -> tuple[str, str] | None:
    if text is None:
        return None
    names = [name.strip() for name in text.split(",")]
    if len(names) != 2 or not all(names):
        raise InputError(f'--axes: "{text}" is no pair of axes; write two names, like gamma,beta')
    return names[0], names[1]


def border_lines(dataset: "xarray.Dataset") -> list[str]:
    """The share of each plane in which there is a stable single impact, and what ends it, by start."""
    if "region_area" not in dataset:
        return []
    beyond = [str(name) for name in dataset.coords if dataset[name].dims == ("region",) and name != "region_start"]
    lines = []
    for k in range(dataset.sizes["region"]):
        at = {name.removeprefix("region_"): float(dataset[name][k]) for name in beyond}
        start = str(dataset["region_start"].values[k]) if "region_start" in dataset.coords else ""
        words = [f"{name} = {value:g}" for name, value in at.items()]
        words += [f"start {start}" if start not in ("", "any") else "any start"]
        mine = [
            c
            for c in range(dataset.sizes["curve"])
            if all(float(dataset[name][c]) == value for name, value in at.items())
            and (not start or str(dataset["start"].values[c]) == start)
        ]
        ends = ", ".join(_counted(dataset, mine))
        lines.append(f"{', '.join(words)}: {100 * float(dataset['region_area'][k]):.1f} % of the plane; ends by {ends}")
    return lines


def _counted(dataset: "xarray.Dataset", curves: list[int]) -> list[str]:
    """How many vertices the curves of each kind have, the most first."""
    sizes: dict[str, int] = {}
    meanings = flags(dataset["kind"])
    for c in curves:
        kind = meanings[int(dataset["kind"][c])]
        sizes[kind] = sizes.get(kind, 0) + int((dataset["curve"].values == c).sum())
    return [f"{kind} ({size})" for kind, size in sorted(sizes.items(), key=lambda one: -one[1])] or ["nothing"]
