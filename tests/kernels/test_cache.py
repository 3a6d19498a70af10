"""Tests of the cache of kernels: it loads only files of this user; damage or refusal costs only a compilation."""

import functools
import logging
import os
import stat
import threading
import time

import numpy as np
import pytest

from vibrojax import cli
from vibrojax.compile import cache, native
from vibrojax.compile.native import Kernel, kernels

X = np.linspace(0.0, 1.0, 5)
STRANGER = 12345
"""The id of another user."""


@pytest.fixture
def compilations(monkeypatch, tmp_path):
    """Give a private cache, and return a list that grows with every compilation."""
    monkeypatch.setenv(cache.CACHE_VARIABLE, str(tmp_path / "cache"))
    monkeypatch.setattr(cache, "_refused", set())
    texts = []
    compiled = native._object_code
    monkeypatch.setattr(native, "_object_code", lambda text: texts.append(text) or compiled(text))
    return texts


@pytest.fixture
def file(compilations):
    """Return the cached file of one kernel."""
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


def refusal_lines(path, reason):
    return [f"cache refused: {path}: {reason}; kernels are compiled again"]


def test_kernel_is_compiled_once(compilations):
    use()
    use()
    assert len(compilations) == 1 and len(cached_files()) == 1
    use(4.0)
    assert len(compilations) == 2 and len(cached_files()) == 2


def test_other_processor_shares_nothing(file, monkeypatch):
    other = native.processor()._replace(features="+nothing")
    read, keys = cache.read, []
    monkeypatch.setattr(native, "processor", lambda: other)
    monkeypatch.setattr(cache, "read", lambda key: keys.append(key) or read(key))
    monkeypatch.setattr(native, "_object_code", lambda text: (_ for _ in ()).throw(RuntimeError("compiled again")))
    with pytest.raises(RuntimeError, match="compiled again"):
        use()
    assert keys[0] != file.name


@pytest.mark.parametrize("folder", ["off", "file"])
def test_without_folder(compilations, monkeypatch, tmp_path, folder):
    """The cache is switched off, or a file is in place of the folder."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(cache.CACHE_VARIABLE, folder if folder == "off" else str(tmp_path / folder))
    use()
    use()
    assert (cache.folder() is None) == (folder == "off") and len(compilations) == 2


def test_permissions(compilations):
    """New files and folders are private to the user, whatever the umask."""
    before = os.umask(0)
    try:
        use()
    finally:
        os.umask(before)
    [file] = cached_files()
    modes = [stat.S_IMODE(path.stat().st_mode) for path in (file, file.parent, file.parent.parent)]
    assert modes == [0o600, 0o700, 0o700]
    use()
    assert len(compilations) == 1


@pytest.mark.parametrize("mode", [0o770, 0o720, 0o702, 0o777, 0o1777])
def test_folder_writable_by_others(file, compilations, refusals, mode):
    """The folder of the files is refused: the sticky bit does not keep others from adding files."""
    cache.folder().chmod(mode)
    use()
    use(5.0)
    assert len(compilations) == 3 and cached_files() == [file]
    assert refusals() == refusal_lines(cache.folder(), "others can write to it")


@pytest.mark.parametrize("mode, unsafe", [(0o777, True), (0o773, True), (0o1777, False), (0o775, False)])
def test_parent_folder(file, compilations, refusals, mode, unsafe):
    """In a parent like /tmp the folder of the files is safe; a parent in which all can replace it is refused."""
    cache.folder().parent.chmod(mode)
    use()
    assert len(compilations) == 1 + unsafe
    assert refusals() == refusal_lines(cache.folder().parent, "others can write to it") * unsafe


@pytest.mark.parametrize("mode", [0o620, 0o602, 0o666])
def test_file_writable_by_others(file, compilations, refusals, mode):
    """It is replaced by one that only the user can write."""
    file.chmod(mode)
    use()
    assert len(compilations) == 2 and stat.S_IMODE(file.stat().st_mode) == 0o600
    assert refusals() == refusal_lines(file, "others can write to it")
    use()
    assert len(compilations) == 2


@pytest.mark.parametrize("part", ["folder", "file"])
def test_path_of_another_user(file, compilations, refusals, monkeypatch, part):
    """A path that belongs, or seems to belong, to another user is refused, also for root."""
    path = file if part == "file" else file.parent
    if os.geteuid() == 0:
        os.chown(path, STRANGER, -1)
    else:
        fstat, inode = os.fstat, os.stat(path).st_ino

        def fake_fstat(descriptor):
            status = fstat(descriptor)
            changed = list(status)
            changed[stat.ST_UID] = STRANGER if status.st_ino == inode else status.st_uid
            return os.stat_result(changed)

        monkeypatch.setattr(os, "fstat", fake_fstat)
    use()
    assert len(compilations) == 2 and refusals() == refusal_lines(path, "belongs to another user")


@pytest.mark.parametrize("part", ["folder", "file"])
def test_link(file, compilations, refusals, tmp_path, part):
    """A link is not followed, even if its target is undamaged and belongs to the user."""
    path, target = file if part == "file" else file.parent, tmp_path / "planted"
    path.rename(target)
    path.symlink_to(target)
    use()
    [line] = refusals()
    assert len(compilations) == 2 and line.startswith(f"cache refused: {path}: ")
    assert target.exists() and path.is_symlink() == (part == "folder")


def test_pipe_in_place_of_file(file, compilations, refusals):
    file.unlink()
    os.mkfifo(file)
    use()
    assert len(compilations) == 2 and refusals() == refusal_lines(file, "is not a regular file")


def test_swapped_files_are_detected(compilations, refusals):
    """Code of another kernel under this key once ended the process (signal 11)."""
    use(3.0)
    use(4.0)
    first, second = cached_files()
    first_code, second_code = first.read_bytes(), second.read_bytes()
    first.write_bytes(second_code)
    second.write_bytes(first_code)
    use(3.0)
    use(4.0)
    assert len(compilations) == 4 and len(refusals()) == 1
    assert "is damaged, or does not belong under this name" in refusals()[0]
    assert (first.read_bytes(), second.read_bytes()) == (first_code, second_code)


@pytest.mark.parametrize("length", [None, 0, 10, cache.HEADER - 1, cache.HEADER, cache.HEADER + 100])
def test_damaged_file(file, compilations, refusals, length):
    """A file that is truncated, or has a flipped bit, is compiled and stored again."""
    whole = file.read_bytes()
    flipped = whole[:200] + bytes([whole[200] ^ 1]) + whole[201:]
    file.write_bytes(flipped if length is None else whole[:length])
    use()
    assert len(compilations) == 2 and len(refusals()) == 1 and file.read_bytes() == whole


def test_old_files_are_deleted(file, monkeypatch):
    half = file.with_name(f"{cache.TEMPORARY}half")
    half.write_bytes(b"half")
    for path in (file, half):
        os.utime(path, (time.time() - 100 * 86400,) * 2)
    use(5.0)
    [newer] = cache.folder().iterdir()
    assert newer not in (file, half)
    monkeypatch.setattr(cache, "KEPT_BYTES", 1.5 * newer.stat().st_size)
    os.utime(newer, (time.time() - 60,) * 2)
    use(6.0)
    assert len(cached_files()) == 1 and cached_files() != [newer]


def test_pruning_deletes_only_its_own_files(file, monkeypatch):
    """The oldest file is deleted, but no foreign file, however old."""
    folder = cache.folder()
    (folder / "thesis.txt").write_text("three years of work")
    (folder / ".hidden").write_text("")
    (folder / ("a" * 64)).write_text("a name like ours")
    (folder / ("b" * 64)).mkdir()
    (folder / ("c" * 64)).symlink_to(folder / "thesis.txt")
    (folder / ".vibrojax-folder").mkdir()
    half = folder / f"{cache.TEMPORARY}0123456789abcdef"
    half.write_bytes(b"half")
    for path in folder.iterdir():
        os.utime(path, (1e9, 1e9), follow_symlinks=False)
    monkeypatch.setattr(cache, "KEPT_BYTES", 1.0)
    use(5.0)
    assert not half.exists() and not file.exists()
    foreign = {"thesis.txt", ".hidden", ".vibrojax-folder", "a" * 64, "b" * 64, "c" * 64}
    assert foreign <= {path.name for path in folder.iterdir()}
    assert (folder / "thesis.txt").read_text() == "three years of work"


def test_many_threads(compilations):
    """Each thread gets its kernel, from the cache or compiled, and no file is left half-written."""
    for _ in range(2):
        threads = [threading.Thread(target=use, args=(float(factor % 3),)) for factor in range(12)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len(cached_files()) == len(list(cache.folder().iterdir())) == 3


def test_refused_cache_is_reported_once(compilations, monkeypatch, tmp_path, capsys):
    """The report is on stderr, and only with --verbose."""
    monkeypatch.setattr(native, "_object_code", functools.cache(native._object_code))
    cache.folder().mkdir(parents=True)
    cache.folder().chmod(0o777)
    sweep = tmp_path / "sweep.toml"
    sweep.write_text('scene = "rotary"\n[grid]\nbeta = [0.4]\n[run]\nsettle = 1.0\nobserve = 1.0\n')

    def stderr(*options):
        cache._refused.clear()
        kernels.clear()
        assert cli.main(["sweep", str(sweep), "-o", str(tmp_path / "out.nc"), "--fresh", *options]) == 0
        return capsys.readouterr().err

    assert stderr("--verbose").count(f"vibrojax: cache refused: {cache.folder()}: others can write to it") == 1
    assert "cache refused" not in stderr()
    assert not list(cache.folder().iterdir())
