"""The command `design`, which takes a design file."""

from typing import TYPE_CHECKING

from vibrojax.cli.command import JSON, Options, argument, command, output_options
from vibrojax.cli.output import answer

if TYPE_CHECKING:
    import xarray


@command(
    argument(
        "file",
        "FILE",
        "a design: the path of a TOML file with scene, maximise, [vary] and, as needed, robust, [subject], "
        "[tolerance], [parameters], starts, [run], [front]; or a bundled name: energy, rate-in-sandstone, "
        "power-at-120-kn",
    ),
    output_options("NAME-design.nc"),
    JSON,
)
def design(options: Options) -> None:
    """Find the best drill under constraints that hold from every start and at samples of the tolerances."""
    from vibrojax.studies.design_run import find_design
    from vibrojax.studies.design_spec import read_design

    spec = read_design(options.file)

    def compute() -> "xarray.Dataset":
        return find_design(spec, progress=not options.quiet)

    answer(options, f"{spec.name}-design.nc", spec.identity(), compute)
