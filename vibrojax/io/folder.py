"""The files in a folder of chunks, by their names: which chunk each belongs to, and which of them are to go."""

import re

from vibrojax.io.manifest import MANIFEST

LOCK = "lock"

_SHARD = re.compile(r"chunk-(\d{8,})\.shard")
_BESIDE = re.compile(r"chunk-\d{8,}\.failed|[\w-]+\.claim")
_UNFINISHED = re.compile(r"(\.\d+)*\.tmp")


def chunk_name(index: int) -> str:
    """How the files of a chunk begin."""
    return f"chunk-{index:08d}"


def shard_name(index: int) -> str:
    """The file that holds a finished chunk."""
    return f"{chunk_name(index)}.shard"


def failure_name(index: int) -> str:
    """The file that says why a chunk could not be computed."""
    return f"{chunk_name(index)}.failed"


def shard_index(name: str) -> int | None:
    """The chunk that a file holds; None where it holds none."""
    match = _SHARD.fullmatch(name)
    return int(match[1]) if match else None


def is_to_go(name: str, shards: bool) -> bool:
    """Whether a file goes when work begins anew: what a process that was killed has left of one, and what was said of
    chunks; where all goes, finished chunks (`shards`) too. Never what is not ours."""
    ours = _UNFINISHED.sub("", name)
    unfinished = ours != name
    if ours in (MANIFEST, "clock"):
        return unfinished
    return (bool(_SHARD.fullmatch(ours)) and (unfinished or shards)) or bool(_BESIDE.fullmatch(ours))
