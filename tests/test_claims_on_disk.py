"""Claims of several processes in a folder: one has each, and what a dead one held is taken over."""

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
HOLDS = """
import sys, time
from pathlib import Path
from vibrojax.io.claims import Claims
print(Claims(Path(sys.argv[1])).take("chunk"), flush=True)
time.sleep(60)
"""


@pytest.fixture
def another(tmp_path):
    """Another process, which holds the claim "chunk"."""
    with subprocess.Popen([sys.executable, "-c", HOLDS, tmp_path], stdout=subprocess.PIPE, cwd=ROOT) as process:
        assert process.stdout.readline() == b"True\n"
        yield process
        process.kill()


def claim_of(folder, **changes) -> Path:
    """A claim as a process on another machine has made it."""
    owner = vars(this_process()) | {"host": "far", "process": 7, "place": "elsewhere", "since": "2026-01-01T00:00:00Z"}
    path = folder / "chunk.claim"
    path.write_text(json.dumps(owner | changes))
    return path


def aged(path, seconds):
    then = time.time() - seconds
    os.utime(path, (then, then))


def test_one_has_it(tmp_path):
    mine, other = Claims(tmp_path), Claims(tmp_path)
    assert mine.take("chunk") and not other.take("chunk") and not mine.take("chunk") and other.take("dataset")
    assert [(one.name, one.owner, one.stale) for one in mine.held()] == [
        ("chunk", this_process(), False),
        ("dataset", this_process(), False),
    ]
    mine.release("chunk")
    assert other.take("chunk")
    mine.close()
    other.close()
    assert list(tmp_path.iterdir()) == []


def test_of_many_at_once_one_gets_it(tmp_path):
    many, got = 16, []
    together = Barrier(many)

    def take():
        claims = Claims(tmp_path)
        together.wait()
        if claims.take("chunk"):
            got.append(claims)

    for _ in range(5):
        aged(claim_of(tmp_path), 2 * STALE)  # which they all find stale
        got.clear()
        threads = [Thread(target=take) for _ in range(many)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(got) <= 1
        assert got or Claims(tmp_path).take(
            "chunk"
        )  # where each saw another at it, nobody has it, and the next gets it
        (tmp_path / "chunk.claim").unlink()


def test_what_a_killed_process_held_is_taken_over_at_once(tmp_path, another):
    claims = Claims(tmp_path)
    assert not claims.take("chunk") and not claims.held()[0].stale
    another.kill()
    another.wait()
    assert claims.held()[0].stale and claims.held()[0].owner.process == another.pid
    assert claims.take("chunk") and claims.held()[0].owner == this_process()


def test_another_process_of_the_same_number_is_not_it(tmp_path):
    us = this_process()
    claim_of(tmp_path, process=us.process, place=us.place, start="1")
    assert Claims(tmp_path).take("chunk")


@pytest.mark.parametrize("age, stale", [(0.0, False), (STALE - 20.0, False), (STALE + 20.0, True)])
def test_of_another_machine_the_last_touch_tells(tmp_path, age, stale):
    aged(claim_of(tmp_path), age)
    claims = Claims(tmp_path)
    assert claims.held()[0].stale == stale and claims.held()[0].owner.text == "far, process 7"
    assert claims.take("chunk") == stale


def test_who_works_touches_his_claims(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "BEAT", 0.05)
    claims = Claims(tmp_path)
    assert claims.take("chunk")
    path = tmp_path / "chunk.claim"
    aged(path, 1000.0)
    end = time.monotonic() + 100.0
    while time.time() - path.stat().st_mtime > 500.0:
        assert time.monotonic() < end
        time.sleep(0.02)
    claims.close()


def test_one_that_is_taken_over_by_another_meanwhile_stays(tmp_path):
    """Between the look at a stale claim and its removal another process may have taken it."""
    claims, stale = Claims(tmp_path), claim_of(tmp_path)
    now = stale.read_bytes()  # as old as a fresh one
    assert not claims._remove_stale(stale) and stale.read_bytes() == now


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"host": 1}'])
def test_a_claim_that_says_nothing_goes_by_its_age(tmp_path, content):
    path = tmp_path / "chunk.claim"
    path.write_bytes(content)
    assert not Claims(tmp_path).take("chunk")
    aged(path, 2 * STALE)
    assert Claims(tmp_path).take("chunk")


def test_a_folder_that_is_gone_has_nothing_to_take(tmp_path):
    claims = Claims(tmp_path / "gone")
    assert not claims.take("chunk") and claims.held() == []
    claims.release("chunk")


def test_a_file_system_without_links(tmp_path, monkeypatch):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", refuse)
    assert Claims(tmp_path).take("chunk") and not Claims(tmp_path).take("chunk")
