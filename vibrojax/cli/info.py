"""Tell what a dataset holds: scene, grid, regimes, failures, accuracy, provenance; or how far a sweep is."""

from argparse import ArgumentParser
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vibrojax.cli.completion import files, with_completer
from vibrojax.cli.output import JSON_HELP, Options, print_json
from vibrojax.io.formatting import size_text, time_text
from vibrojax.progress import timed

if TYPE_CHECKING:
    from vibrojax.analyses.analysis import SummaryPart
    from vibrojax.io.standing import Standing

_SHOWN = 8
"""Chunks, claims or failures that are listed."""


def arguments(parser: ArgumentParser) -> None:
    """Add the command's arguments to `parser`."""
    file = parser.add_argument(
        "file", metavar="OUT.nc", help="a dataset written by vibrojax, or the folder of chunks of an unfinished one"
    )
    with_completer(file, files(".nc"))
    parser.add_argument("--json", action="store_true", help=JSON_HELP)


def run(options: Options) -> None:
    """Run the command."""
    from vibrojax.analyses.summary import summarise, summary_facts, summary_lines
    from vibrojax.io.dataset import open_dataset

    folder = chunk_folder(Path(options.file))
    if folder is not None:
        from vibrojax.io.standing import standing

        state = standing(folder)
        print_json(standing_facts(state)) if options.json else print("\n".join(summary_lines(standing_parts(state))))
        return
    with timed("read"):
        dataset = open_dataset(Path(options.file))
    if options.json:
        print_json(summary_facts(dataset, options.file))
    else:
        print("\n".join(summary_lines(summarise(dataset))))


def chunk_folder(path: Path) -> Path | None:
    """Return the folder of chunks that `path` is, or that lies beside a missing `path`; None if there is none."""
    from vibrojax.io.standing import CHUNKS

    if path.name.endswith(CHUNKS) and path.is_dir():
        return path
    if not path.name:  # "." and "/" have none
        return None
    beside = path.with_name(path.name + CHUNKS)
    return beside if beside.is_dir() and not path.exists() else None


def standing_parts(state: "Standing") -> "list[SummaryPart]":
    """Return the progress of an unfinished sweep in words."""
    from vibrojax.analyses.analysis import SummaryPart

    share = 100 * len(state.finished) / max(state.chunks, 1)
    pace = "not known yet"
    if state.per_second is not None:
        left = (state.chunks - len(state.finished)) / state.per_second
        pace = f"{state.per_second * state.size:.3g} lanes/s"
        pace += f", {time_text(left)} left at that" if left else ""
    held = [
        f"{claim.name}: {claim.owner.text}, since {claim.since}{' (has ended)' if claim.stale else ''}"
        for claim in state.held
    ]
    failures = [f"chunk {failure.chunk}: {failure.why} ({failure.by})" for failure in state.failures]
    at_work = _first(held) or ["a process of this machine" if state.whole_held else "none"]
    return [
        SummaryPart("title", [state.title]),
        SummaryPart("finished", [f"{len(state.finished)} of {state.chunks} chunks ({share:.3g} %)"]),
        SummaryPart("lanes", [f"{state.finished_lanes} of {state.lanes}"]),
        SummaryPart("disk", [size_text(state.nbytes)]),
        SummaryPart("pace", [pace]),
        SummaryPart("at work", at_work),
        SummaryPart("failed", _first(failures) or ["none"]),
    ]


def standing_facts(state: "Standing") -> dict[str, Any]:
    """Return the progress of an unfinished sweep with stable keys."""
    return {
        "folder": str(state.folder),
        "title": state.title,
        "lanes": {"finished": state.finished_lanes, "all": state.lanes},
        "chunks": {"finished": len(state.finished), "all": state.chunks, "size": state.size},
        "bytes": state.nbytes,
        "chunks_per_second": state.per_second,
        "held": [{"what": c.name, "by": c.owner.text, "since": c.since, "stale": c.stale} for c in state.held],
        "locked": state.whole_held,
        "failures": [vars(failure) for failure in state.failures],
    }


def _first(lines: list[str]) -> list[str]:
    more = len(lines) - _SHOWN
    return lines if more <= 0 else [*lines[:_SHOWN], f"and {more} more"]
