"""Tests of the cache of kernels, which loads only files of this user, and of digests: equal traces have one."""

import json
import logging
import os
import stat
import subprocess
import sys
import threading
import time
from pathlib import Path

import identities
import numpy as np
import pytest

from vibrojax.compile import cache
from vibrojax.compile.native import Kernel

X = np.linspace(0.0, 1.0, 5)


@pytest.fixture
def file(monkeypatch, tmp_path):
    """Return the file of one kernel in a private cache."""
    monkeypatch.setenv(cache.CACHE_VARIABLE, str(tmp_path / "cache"))
    cache._refused.clear()
    use()
    [file] = cached_files()
    return file


@pytest.fixture
def refusals(caplog):
    """Return a function that lists the refusals in the log."""
    caplog.set_level(logging.INFO, "vibrojax")
    return lambda: [text for text in (record.getMessage() for record in caplog.records) if "cache refused" in text]


def use(factor=3.0):
    kernel = Kernel(lambda x: factor * x + 1, X)
    np.testing.assert_array_equal(kernel(X), factor * X + 1)


def cached_files():
    return sorted(path for path in cache.folder().iterdir() if cache.KEY.fullmatch(path.name))


def test_kernel_is_compiled_once(file):
    before = file.stat().st_ino
    use()
    assert cached_files() == [file] and file.stat().st_ino == before
    use(4.0)
    assert len(cached_files()) == 2


def test_without_folder(monkeypatch, tmp_path):
    """The cache is switched off, or a file is in place of the folder."""
    (tmp_path / "file").write_text("")
    for folder in ("off", str(tmp_path / "file")):
        monkeypatch.setenv(cache.CACHE_VARIABLE, folder)
        use()
        assert (cache.folder() is None) == (folder == "off")


@pytest.mark.parametrize("parents, mode, unsafe", [(0, 0o720, 1), (0, 0o1777, 1), (1, 0o777, 1), (1, 0o1777, 0)])
def test_folder_writable_by_others(file, refusals, parents, mode, unsafe):
    """The sticky bit does not keep others from adding files; in a parent like /tmp it keeps the folder safe."""
    folder = cache.folder().parent if parents else cache.folder()
    folder.chmod(mode)
    use()
    use(5.0)
    lines = [f"cache refused: {folder}: others can write to it; kernels are compiled again"]
    assert refusals() == lines * unsafe and len(cached_files()) == 2 - unsafe


def _make_link(file):
    file.rename(file.with_name("planted"))
    file.symlink_to(file.with_name("planted"))


def _make_pipe(file):
    file.unlink()
    os.mkfifo(file)


def _swap(file):
    """Put the code of another kernel under this key, which once ended the process (signal 11)."""
    use(4.0)
    [other] = [path for path in cached_files() if path != file]
    file.write_bytes(other.read_bytes())


DAMAGES = {
    "writable": (lambda file: file.chmod(0o602), "others can write to it"),
    "link": (_make_link, ""),
    "pipe": (_make_pipe, "is not a regular file"),
    "swapped": (_swap, "is damaged, or does not belong under this name"),
    "truncated": (lambda file: os.truncate(file, cache.HEADER + 100), "is damaged"),
    "flipped": (lambda x: x.write_bytes((c := x.read_bytes())[:200] + bytes([c[200] ^ 1]) + c[201:]), "is damaged"),
}


@pytest.mark.parametrize("kind", DAMAGES)
def test_file_that_cannot_be_trusted_is_replaced(kind, file, refusals):
    damage, reason = DAMAGES[kind]
    whole = file.read_bytes()
    damage(file)
    use()
    [line] = refusals()
    assert line.startswith(f"cache refused: {file}: ") and reason in line
    assert file.read_bytes() == whole and not file.is_symlink() and stat.S_IMODE(file.stat().st_mode) == 0o600


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file away")
def test_file_of_another_user_is_refused(file, refusals):
    os.chown(file, 12345, -1)
    use()
    assert "belongs to another user" in refusals()[0]


def test_pruning_deletes_only_its_own_files(file):
    """Files that nobody has used for months are deleted, but no foreign file, however old."""
    folder = cache.folder()
    (folder / "thesis.txt").write_text("three years of work")
    (folder / ("a" * 64)).write_text("a name like ours")
    (folder / ("c" * 64)).symlink_to(folder / "thesis.txt")
    half = folder / f"{cache.TEMPORARY}0123456789abcdef"
    half.write_bytes(b"half")
    for path in folder.iterdir():
        os.utime(path, (time.time() - 100 * 86400,) * 2, follow_symlinks=False)
    use(5.0)
    assert not half.exists() and not file.exists()
    assert {"thesis.txt", "a" * 64, "c" * 64} <= {path.name for path in folder.iterdir()}


def test_many_threads(file):
    """Each thread gets its kernel, from the cache or compiled, and no file is left half-written."""
    for _ in range(2):
        threads = [threading.Thread(target=use, args=(float(1 + factor % 3),)) for factor in range(12)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len(cached_files()) == len(list(cache.folder().iterdir())) == 3


# Digests, in processes without the checks of types, which wrap every function of the package
FOLDERS = [str(Path(__file__).parent), str(Path(__file__).parents[2])]


def printed(names, cache, seed="0"):
    """Return the results of functions of `identities`, in this order, in a process of their own."""
    code = f"import json, identities; print(json.dumps([getattr(identities, name)() for name in {names!r}]))"
    more = {"VIBROJAX_CACHE": str(cache), "PYTHONHASHSEED": seed, "PYTHONPATH": os.pathsep.join(FOLDERS)}
    command = [sys.executable, "-c", code]
    completed = subprocess.run(command, capture_output=True, text=True, env=os.environ | more)
    assert completed.returncode == 0, completed.stderr
    return json.loads(completed.stdout)


def test_digests(tmp_path):
    """Equal objects have one digest, whatever changes a trace changes it, and what is uncertain has none. A second
    process, in which sets and hashes have another order, finds every kernel of the first."""
    digests = ["of_equal", "of_different", "of_uncertain", "of_patched"]
    [kernels, found], equal, different, uncertain, (before, after) = printed(["traced", *digests], tmp_path, seed="1")
    assert all(first == second is not None for first, second in equal)
    assert None not in different and len(set(different)) == len(different)
    assert uncertain == dict.fromkeys(identities.UNCERTAIN)
    assert before is not None and after is None  # a method of the class is replaced in between
    assert kernels > 3 and found == 0
    assert printed(["traced"], tmp_path, seed="2") == [[kernels, kernels]]
