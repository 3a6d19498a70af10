"""The command `design`, which takes a design file."""

from pathlib import Path
from typing import TYPE_CHECKING

from vibrojax.cli.command import JSON, Options, argument, command, flag, output_options
from vibrojax.cli.output import PICTURES, answer, output

if TYPE_CHECKING:
    import xarray


@command(
    argument(
        "file",
        "FILE",
        "a design: the path of a TOML file with scene, maximise, [vary] and, as needed, [subject], [tolerance], "
        "[parameters], starts, [run], [front]; or a bundled name: energy, rate-in-sandstone, power-at-120-kn",
    ),
    flag("--chart", "draw the designer's chart, an A4 page over mass ratio and frequency ratio: OUT.png and OUT.pdf"),
    output_options("NAME-design.nc, or NAME-chart.nc with --chart,"),
    JSON,
)
def design(options: Options) -> None:
    """Find the best drill under constraints that hold from every start and at samples of the tolerances."""
    from vibrojax.studies.design_run import find_design
    from vibrojax.studies.design_spec import read_design

    spec = read_design(options.file)

    def compute() -> "xarray.Dataset":
        dataset = find_design(spec, progress=not options.quiet)
        if options.chart:
            from vibrojax.studies.design_chart import charted

            dataset = charted(dataset, spec, progress=not options.quiet)
        return dataset

    identity = {**spec.identity(), **({"chart": True} if options.chart else {})}
    default = f"{spec.name}-{'chart' if options.chart else 'design'}.nc"
    if options.chart:
        output(Path(options.out or default).with_suffix(".pdf"), PICTURES)
    answer(options, default, identity, compute)
    if options.chart:
        from vibrojax.io.dataset import open_dataset
        from vibrojax.pictures.choose import save_picture

        out = Path(options.out or default)
        save_picture(open_dataset(out), out.with_suffix(".pdf"))
