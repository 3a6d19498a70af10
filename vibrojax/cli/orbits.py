"""Find the periodic orbits of a sweep's lanes: multipliers and stability."""

import shlex
from argparse import ArgumentParser
from pathlib import Path

from vibrojax.cli.completion import files, with_completer
from vibrojax.cli.output import Options, add_output, dataset_written, draw, output, picture_beside


def arguments(parser: ArgumentParser) -> None:
    """Add the command's arguments to `parser`."""
    file = parser.add_argument(
        "file",
        metavar="FILE",
        help="a sweep: a bundled name, like regime-map, or the path of a TOML file; or a sweep's dataset (.nc), whose "
        "sweep is then run again",
    )
    with_completer(file, files(".toml", ".nc"))
    add_output(parser, "NAME-orbits.nc")


def run(options: Options) -> None:
    """Run the command."""
    from vibrojax.analyses.orbits.rerun import sweep_with_orbits
    from vibrojax.analyses.sweep.run import run_to_file
    from vibrojax.analyses.sweep.summary import orbit_lines
    from vibrojax.io.dataset import open_dataset

    file = str(options.file)
    is_dataset = file.endswith(".nc")
    sweep = sweep_with_orbits(open_dataset(Path(file)) if is_dataset else file)
    out = output(options.out or f"{Path(file).stem if is_dataset else sweep.name}-orbits.nc")
    picture = picture_beside(out)
    command = shlex.join(["vibrojax", "orbits", file, "-o", str(out)])
    options.how_to_resume = f"finished chunks are kept; to go on: {command}"
    dataset = run_to_file(sweep, out, resume=not options.fresh, progress=not options.quiet)
    dataset_written(options, out)
    drawn = draw(dataset, picture)
    if not options.quiet:
        print(f"{out}: {sweep.lanes} lanes{drawn}")
        print("\n".join(orbit_lines(dataset)))
