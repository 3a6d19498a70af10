"""Compare each table and figure of the source that the model can reproduce with its result: a page and a table.

An interrupted run keeps nothing.
"""

from argparse import ArgumentParser

from vibrojax.cli.output import Options, output_folder


def arguments(parser: ArgumentParser) -> None:
    parser.add_argument("-o", dest="out", metavar="DIR", default="reproduction", help="the folder (reproduction)")
    parser.add_argument("--quick", action="store_true", help="only what half a minute answers, to see that it works")


def run(options: Options) -> None:
    page, table = output_folder(options.out, ("index.html", "table.md"))
    options.advise("nothing is kept; to start again", "reproduce", "-o", options.out, *["--quick"] * options.quick)
    from vibrojax.reproduce import run_reproduction, write_reproduction

    reproduction = run_reproduction(quick=options.quick, progress=not options.quiet)
    write_reproduction(reproduction, page.parent)
    if not options.quiet:
        score = ", ".join(f"{count} {verdict}" for verdict, count in reversed(reproduction.score.items()))
        print(f"{page}: {len(reproduction.results)} results: {score}; table {table}")
