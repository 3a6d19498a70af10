"""Measure speed against error on this machine: write a dataset, a table and a picture.

An interrupted run keeps nothing, since timings of different runs must not be mixed in one table.
"""

from argparse import ArgumentParser

from vibrojax.cli.output import Options, dataset_written, output_folder


def arguments(parser: ArgumentParser) -> None:
    parser.add_argument("-o", dest="out", metavar="DIR", default="accuracy", help="the folder to write to (accuracy)")
    parser.add_argument("--quick", action="store_true", help="few settings of two scenes, to see that it works")


def run(options: Options) -> None:
    dataset_path, table_path, picture_path = output_folder(options.out, ("accuracy.nc", "accuracy.md", "accuracy.png"))
    options.advise("nothing is kept; to start again", "accuracy", "-o", options.out, *["--quick"] * options.quick)
    from vibrojax.analyses.accuracy import run_accuracy, table
    from vibrojax.analyses.pictures import save_picture
    from vibrojax.io.dataset import write_dataset

    dataset = run_accuracy(quick=options.quick, progress=not options.quiet)
    write_dataset(dataset, dataset_path)
    table_path.write_text(table(dataset), encoding="utf-8")
    dataset_written(options, dataset_path)
    save_picture(dataset, picture_path)
    if not options.quiet:
        print(f"{table_path}: {dataset.sizes['setting']} settings; dataset {dataset_path}, picture {picture_path}")
