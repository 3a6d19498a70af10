"""Find the periodic orbits of a sweep's lanes, with their multipliers and stability."""

from argparse import ArgumentParser
from pathlib import Path

from vibrojax.cli.completion import add_argument, files
from vibrojax.cli.output import Options, add_output, draw, output, picture_beside


def arguments(parser: ArgumentParser) -> None:
    about = "a sweep: a bundled name, like regime-map, or the path of a TOML file; or a sweep's dataset (.nc), whose "
    about += "sweep is then run again"
    add_argument(parser, "file", completer=files(".toml", ".nc"), metavar="FILE", help=about)
    add_output(parser, "NAME-orbits.nc")


def run(options: Options) -> None:
    from vibrojax.analyses.orbits.analysis import sweep_with_orbits
    from vibrojax.analyses.sweep.run import run_to_file
    from vibrojax.analyses.sweep.summary import orbit_lines
    from vibrojax.io.dataset import open_dataset

    file = str(options.file)
    is_dataset = file.endswith(".nc")
    sweep = sweep_with_orbits(open_dataset(Path(file)) if is_dataset else file)
    out = output(options.out or f"{Path(file).stem if is_dataset else sweep.name}-orbits.nc")
    picture = picture_beside(out)
    options.advise("finished chunks are kept; to go on", "orbits", file, "-o", str(out))
    dataset = run_to_file(sweep, out, resume=not options.fresh, progress=not options.quiet)
    drawn = draw(options, dataset, out, picture)
    if not options.quiet:
        print(f"{out}: {sweep.lanes} lanes{drawn}")
        print("\n".join(orbit_lines(dataset)))
