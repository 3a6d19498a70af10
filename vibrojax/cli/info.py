"""Show what a dataset holds: scene, grid, regimes, failures, accuracy, provenance; or the progress of a sweep."""

from argparse import ArgumentParser
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vibrojax.cli.completion import add_argument, files
from vibrojax.cli.output import Options, add_json, print_json
from vibrojax.io.formatting import size_text, time_text
from vibrojax.progress import timed

if TYPE_CHECKING:
    from vibrojax.analyses.analysis import SummaryPart
    from vibrojax.io.standing import Standing

_MAX_ITEMS = 8
"""Maximum number of claims or failures that are listed."""


def arguments(parser: ArgumentParser) -> None:
    about = "a dataset written by vibrojax, or the folder of chunks of an unfinished one"
    add_argument(parser, "file", completer=files(".nc"), metavar="OUT.nc", help=about)
    add_json(parser)


def run(options: Options) -> None:
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
    """Return the folder of chunks at `path`, or next to a `path` that does not exist; None if there is none."""
    from vibrojax.io.standing import CHUNKS

    if path.name.endswith(CHUNKS) and path.is_dir():
        return path
    if not path.name or path.exists():  # "." and "/" have no name
        return None
    folder = path.with_name(path.name + CHUNKS)
    return folder if folder.is_dir() else None


def standing_parts(state: "Standing") -> "list[SummaryPart]":
    """Return the progress of an unfinished sweep as parts of a summary."""
    from vibrojax.analyses.analysis import SummaryPart

    finished = len(state.finished)
    pace = "not known yet"
    if state.per_second is not None:
        seconds = (state.chunks - finished) / state.per_second
        pace = f"{state.per_second * state.size:.3g} lanes/s"
        pace += f", {time_text(seconds)} left at that" if seconds else ""
    claims = [
        f"{claim.name}: {claim.owner.text}, since {claim.since}{' (has ended)' if claim.stale else ''}"
        for claim in state.held
    ]
    failures = [f"chunk {failure.chunk}: {failure.why} ({failure.by})" for failure in state.failures]
    lines = {
        "title": [state.title],
        "finished": [f"{finished} of {state.chunks} chunks ({100 * finished / max(state.chunks, 1):.3g} %)"],
        "lanes": [f"{state.finished_lanes} of {state.lanes}"],
        "disk": [size_text(state.nbytes)],
        "pace": [pace],
        "at work": _first(claims) or ["a process of this machine" if state.whole_held else "none"],
        "failed": _first(failures) or ["none"],
    }
    return [SummaryPart(name, part) for name, part in lines.items()]


def standing_facts(state: "Standing") -> dict[str, Any]:
    """Return the progress of an unfinished sweep as JSON values with stable keys."""
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
    more = len(lines) - _MAX_ITEMS
    return lines if more <= 0 else [*lines[:_MAX_ITEMS], f"and {more} more"]
