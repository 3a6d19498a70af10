"""Test claims by several processes in a folder: one process holds each, and claims of dead processes are taken over."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from threading import Barrier, Thread

import pytest

from vibrojax.io import claims as module
from vibrojax.io.claims import STALE, Claims, this_process

ROOT = Path(__file__).parents[1]
HOLD_CLAIM = """
import sys, time
from pathlib import Path
from vibrojax.io.claims import Claims
print(Claims(Path(sys.argv[1])).take("chunk"), flush=True)
time.sleep(60)
"""


@pytest.fixture
def another(tmp_path):
    """Return another process, which holds the claim "chunk"."""
    with subprocess.Popen([sys.executable, "-c", HOLD_CLAIM, tmp_path], stdout=subprocess.PIPE, cwd=ROOT) as process:
        assert process.stdout.readline() == b"True\n"
        yield process
        process.kill()


def claim_of(folder, **changes) -> Path:
    """Write a claim as if by a process on another machine, and return its path."""
    owner = vars(this_process()) | {"host": "far", "process": 7, "place": "elsewhere", "since": "2026-01-01T00:00:00Z"}
    path = folder / "chunk.claim"
    path.write_text(json.dumps(owner | changes))
    return path


def set_age(path, seconds):
    then = time.time() - seconds
    os.utime(path, (then, then))


def test_only_one_process_holds_a_claim(tmp_path):
    mine, other = Claims(tmp_path), Claims(tmp_path)
    assert mine.take("chunk") and not other.take("chunk") and not mine.take("chunk") and other.take("dataset")
    assert [(claim.name, claim.owner, claim.stale) for claim in mine.held()] == [
        ("chunk", this_process(), False),
        ("dataset", this_process(), False),
    ]
    mine.release("chunk")
    assert other.take("chunk")
    mine.close()
    other.close()
    assert list(tmp_path.iterdir()) == []


def test_at_most_one_of_many_threads_takes_a_claim(tmp_path):
    many, takers = 16, []
    together = Barrier(many)

    def take():
        claims = Claims(tmp_path)
        together.wait()
        if claims.take("chunk"):
            takers.append(claims)

    for _ in range(5):
        set_age(claim_of(tmp_path), 2 * STALE)  # stale for all threads
        takers.clear()
        threads = [Thread(target=take) for _ in range(many)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(takers) <= 1
        assert takers or Claims(tmp_path).take(
            "chunk"
        )  # if each saw another attempt, nobody holds it and the next attempt succeeds
        (tmp_path / "chunk.claim").unlink()


def test_claim_of_killed_process_is_taken_over_at_once(tmp_path, another):
    claims = Claims(tmp_path)
    assert not claims.take("chunk") and not claims.held()[0].stale
    another.kill()
    another.wait()
    assert claims.held()[0].stale and claims.held()[0].owner.process == another.pid
    assert claims.take("chunk") and claims.held()[0].owner == this_process()


def test_reused_process_number_is_another_process(tmp_path):
    us = this_process()
    claim_of(tmp_path, process=us.process, place=us.place, start="1")
    assert Claims(tmp_path).take("chunk")


@pytest.mark.parametrize("age, stale", [(0.0, False), (STALE - 20.0, False), (STALE + 20.0, True)])
def test_claim_from_another_machine_is_stale_by_age(tmp_path, age, stale):
    set_age(claim_of(tmp_path), age)
    claims = Claims(tmp_path)
    assert claims.held()[0].stale == stale and claims.held()[0].owner.text == "far, process 7"
    assert claims.take("chunk") == stale


def test_working_process_touches_its_claims(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "BEAT", 0.05)
    claims = Claims(tmp_path)
    assert claims.take("chunk")
    path = tmp_path / "chunk.claim"
    set_age(path, 1000.0)
    end = time.monotonic() + 100.0
    while time.time() - path.stat().st_mtime > 500.0:
        assert time.monotonic() < end
        time.sleep(0.02)
    claims.close()


def test_claim_taken_over_meanwhile_is_not_removed(tmp_path):
    """Another process may take a stale claim between the check and the removal."""
    claims, stale = Claims(tmp_path), claim_of(tmp_path)
    content = stale.read_bytes()  # as recent as a fresh claim
    assert not claims._remove_stale(stale) and stale.read_bytes() == content


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"host": 1}'])
def test_unreadable_claim_is_stale_by_age(tmp_path, content):
    path = tmp_path / "chunk.claim"
    path.write_bytes(content)
    assert not Claims(tmp_path).take("chunk")
    set_age(path, 2 * STALE)
    assert Claims(tmp_path).take("chunk")


def test_missing_folder_has_no_claims(tmp_path):
    claims = Claims(tmp_path / "gone")
    assert not claims.take("chunk") and claims.held() == []
    claims.release("chunk")


def test_file_system_without_links(tmp_path, monkeypatch):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", refuse)
    assert Claims(tmp_path).take("chunk") and not Claims(tmp_path).take("chunk")
