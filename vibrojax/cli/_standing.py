"""How far a sweep is, in words and as values: what `info` says of the folder of its chunks."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from vibrojax.errors import printable
from vibrojax.io.formatting import size_text, time_text

if TYPE_CHECKING:
    from vibrojax.io.standing import Standing

_SHOWN = 8
_LONGEST_LINE = 1000
"""Characters of a line that are shown: the folder may come from anywhere, like a dataset."""


def folder_of(path: Path) -> Path | None:
    """The folder of chunks that `path` is, or that lies beside it where it is not there; None where there is none."""
    from vibrojax.io.standing import CHUNKS

    if path.name.endswith(CHUNKS) and path.is_dir():
        return path
    if not path.name:  # "." and "/" have none
        return None
    beside = path.with_name(path.name + CHUNKS)
    return beside if beside.is_dir() and not path.exists() else None


def standing_lines(found: "Standing") -> list[str]:
    """The lines that tell how far a sweep is."""
    share = 100 * len(found.finished) / max(found.chunks, 1)
    lines = [
        ("title", [found.title]),
        ("finished", [f"{len(found.finished)} of {found.chunks} chunks ({share:.3g} %)"]),
        ("lanes", [f"{found.finished_lanes} of {found.lanes}"]),
        ("disk", [size_text(found.nbytes)]),
        ("pace", _pace(found)),
        ("at work", _held(found)),
        ("failed", _first([f"chunk {one.chunk}: {one.why} ({one.by})" for one in found.failures])),
    ]
    return [
        f"{'' if at else name:<10}{printable(text, _LONGEST_LINE)}".rstrip()
        for name, texts in lines
        for at, text in enumerate(texts or ["none"])
    ]


def standing_facts(found: "Standing") -> dict[str, Any]:
    """The same as values with stable keys."""
    return {
        "folder": str(found.folder),
        "title": found.title,
        "lanes": {"finished": found.finished_lanes, "all": found.lanes},
        "chunks": {"finished": len(found.finished), "all": found.chunks, "size": found.size},
        "bytes": found.nbytes,
        "chunks_per_second": found.per_second,
        "held": [
            {"what": one.name, "by": one.owner.text, "since": one.since, "stale": one.stale} for one in found.held
        ],
        "locked": found.whole_held,
        "failures": [vars(one) for one in found.failures],
    }


def _pace(found: "Standing") -> list[str]:
    if found.per_second is None:
        return ["not known yet"]
    left = (found.chunks - len(found.finished)) / found.per_second
    rest = f", {time_text(left)} left at that" if left else ""
    return [f"{found.per_second * found.size:.3g} lanes/s{rest}"]


def _held(found: "Standing") -> list[str]:
    lines = [
        f"{one.name}: {one.owner.text}, since {one.since}{' (has ended)' if one.stale else ''}" for one in found.held
    ]
    return _first(lines) or (["a process of this machine"] if found.whole_held else [])


def _first(lines: list[str]) -> list[str]:
    more = len(lines) - _SHOWN
    return lines if more <= 0 else [*lines[:_SHOWN], f"and {more} more"]
