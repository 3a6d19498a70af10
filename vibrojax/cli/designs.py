"""The command `design`, which takes a design file."""

from typing import TYPE_CHECKING

from vibrojax.cli.command import JSON, Options, argument, command, files, output_options
from vibrojax.cli.output import answer

if TYPE_CHECKING:
    import xarray


@command(
    argument(
        "file",
        "FILE",
        "a design: the path of a TOML file with scene, maximise, [vary] and, as needed, [subject], [tolerance], "
        "[parameters], starts, [run], [front]; or a bundled name: energy, rate-in-sandstone, power-at-120-kn",
        files(".toml"),
    ),
    output_options("NAME-design.nc"),
    JSON,
)
def design(options: Options) -> None:
    """Find the best drill under constraints that hold from every start and within the tolerances."""
    from vibrojax.analyses.design.run import find_design
    from vibrojax.analyses.design.spec import read_design

    spec = read_design(options.file)

    def compute() -> "xarray.Dataset":
        return find_design(spec, progress=not options.quiet)

    def facts(dataset: "xarray.Dataset") -> dict[str, object]:
        from vibrojax.analyses.design.analysis import Designs

        return dict(Designs().summary(dataset)[0].facts)

    answer(options, f"{spec.name}-design.nc", spec.identity(), compute, facts)
