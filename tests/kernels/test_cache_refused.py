"""The cache runs only what this user wrote: everything else is compiled again, and named once in the log."""

import logging
import os
import stat
import threading

import numpy as np
import pytest

from vibrojax import cli
from vibrojax.compile.kernels import Kernel, cache, native

X = np.linspace(0.0, 1.0, 5)
STRANGER = 12345
"""The number of another user."""


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
def told(caplog):
    caplog.set_level(logging.INFO, "vibrojax")
    return caplog


def use(factor=3.0):
    kernel = Kernel(lambda x: factor * x + 1, X)
    np.testing.assert_array_equal(kernel(X), factor * X + 1)


def kept():
    return sorted(path for path in cache.folder().iterdir() if cache.KEY.fullmatch(path.name))


def refusals(told):
    return [record.getMessage() for record in told.records if "cache refused" in record.getMessage()]


def as_stranger(monkeypatch, path):
    """Let a file or folder belong to another user, or seem to."""
    if os.geteuid() == 0:
        os.chown(path, STRANGER, -1)
        return
    fstat, inode = os.fstat, os.stat(path).st_ino

    def seems(descriptor):
        about = fstat(descriptor)
        changed = list(about)
        changed[stat.ST_UID] = STRANGER if about.st_ino == inode else about.st_uid
        return os.stat_result(changed)

    monkeypatch.setattr(os, "fstat", seems)


def test_modes(compilations):
    """New files and folders are private to the user, whatever the umask."""
    before = os.umask(0)
    try:
        use()
    finally:
        os.umask(before)
    [file] = kept()
    modes = [stat.S_IMODE(path.stat().st_mode) for path in (file, file.parent, file.parent.parent)]
    assert modes == [0o600, 0o700, 0o700]
    use()
    assert len(compilations) == 1


@pytest.mark.parametrize("mode", [0o770, 0o720, 0o702, 0o777, 0o1777])
def test_a_folder_that_others_write_to(compilations, told, mode):
    """The folder of the files itself: the sticky bit does not keep others from adding files."""
    use()
    cache.folder().chmod(mode)
    use()
    use(5.0)
    assert len(compilations) == 3 and len(kept()) == 1
    assert refusals(told) == [f"cache refused: {cache.folder()}: others can write to it; kernels are compiled again"]


@pytest.mark.parametrize("mode, refused", [(0o777, True), (0o773, True), (0o1777, False), (0o775, False)])
def test_the_folder_above(compilations, told, mode, refused):
    """In one like /tmp the folder of the files is safe; where all can replace it, it is refused."""
    use()
    cache.folder().parent.chmod(mode)
    use()
    assert len(compilations) == 1 + refused and len(refusals(told)) == refused
    assert all(f"{cache.folder().parent}: others can write to it" in line for line in refusals(told))


@pytest.mark.parametrize("mode", [0o620, 0o602, 0o666])
def test_a_file_that_others_write_to(compilations, told, mode):
    """It is replaced by one that only the user writes to."""
    use()
    [file] = kept()
    file.chmod(mode)
    use()
    assert len(compilations) == 2 and stat.S_IMODE(file.stat().st_mode) == 0o600
    assert refusals(told) == [f"cache refused: {file}: others can write to it; kernels are compiled again"]
    use()
    assert len(compilations) == 2


def test_a_folder_of_another_user(compilations, told, monkeypatch):
    """Root does not load it either."""
    use()
    as_stranger(monkeypatch, cache.folder())
    use()
    assert len(compilations) == 2
    assert refusals(told) == [f"cache refused: {cache.folder()}: belongs to another user; kernels are compiled again"]


def test_a_file_of_another_user(compilations, told, monkeypatch):
    use()
    [file] = kept()
    as_stranger(monkeypatch, file)
    use()
    assert len(compilations) == 2
    assert refusals(told) == [f"cache refused: {file}: belongs to another user; kernels are compiled again"]


def test_a_link_in_place_of_a_file(compilations, told, tmp_path):
    """It is not followed, though what it points to is whole and belongs to the user."""
    use()
    [file] = kept()
    elsewhere = tmp_path / "planted"
    file.rename(elsewhere)
    file.symlink_to(elsewhere)
    use()
    assert len(compilations) == 2 and len(refusals(told)) == 1 and str(file) in refusals(told)[0]
    assert elsewhere.exists() and not file.is_symlink()


def test_a_link_in_place_of_the_folder(compilations, told, tmp_path):
    use()
    elsewhere = tmp_path / "planted"
    cache.folder().rename(elsewhere)
    cache.folder().symlink_to(elsewhere)
    use()
    assert len(compilations) == 2
    [line] = refusals(told)
    assert line.startswith(f"cache refused: {cache.folder()}: ")


def test_what_is_no_file(compilations, told):
    """A pipe does not stop the sweep."""
    use()
    [file] = kept()
    file.unlink()
    os.mkfifo(file)
    use()
    assert len(compilations) == 2 and f"{file}: is not a regular file" in refusals(told)[0]


def test_swapped_contents(compilations, told):
    """Code of another kernel under this key ended the process (signal 11)."""
    use(3.0)
    use(4.0)
    first, second = kept()
    one, other = first.read_bytes(), second.read_bytes()
    first.write_bytes(other)
    second.write_bytes(one)
    use(3.0)
    use(4.0)
    assert len(compilations) == 4 and len(refusals(told)) == 1
    assert "is damaged, or does not belong under this name" in refusals(told)[0]
    assert {first.read_bytes(), second.read_bytes()} == {one, other} and first.read_bytes() == one


@pytest.mark.parametrize("length", [0, 10, cache.HEADER - 1, cache.HEADER, cache.HEADER + 100])
def test_truncated(compilations, told, length):
    use()
    [file] = kept()
    whole = file.read_bytes()
    file.write_bytes(whole[:length])
    use()
    assert len(compilations) == 2 and len(refusals(told)) == 1 and file.read_bytes() == whole


def test_pruning_leaves_what_is_not_its_own(compilations, monkeypatch):
    """The oldest file is deleted, and nothing of others, however old."""
    use()
    [old] = kept()
    folder = cache.folder()
    (folder / "thesis.txt").write_text("three years of work")
    (folder / ".hidden").write_text("")
    (folder / ("a" * 64)).write_text("a name like ours")
    (folder / ("b" * 64)).mkdir()
    (folder / ("c" * 64)).symlink_to(folder / "thesis.txt")
    (folder / ".vibrojax-folder").mkdir()
    half = folder / f"{cache.TEMPORARY}0123456789abcdef"
    half.write_bytes(b"half")
    foreign = {"thesis.txt", ".hidden", ".vibrojax-folder", "a" * 64, "b" * 64, "c" * 64}
    for path in folder.iterdir():
        os.utime(path, (1e9, 1e9), follow_symlinks=False)
    monkeypatch.setattr(cache, "KEPT_BYTES", 1.0)
    use(5.0)
    assert not half.exists() and not old.exists()
    assert foreign <= {path.name for path in folder.iterdir()}
    assert (folder / "thesis.txt").read_text() == "three years of work"


def test_many_threads(compilations):
    """Each gets its kernel, from the cache or compiled, and no file is left half-written."""
    for _ in range(2):
        threads = [threading.Thread(target=use, args=(float(factor % 3),)) for factor in range(12)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len(kept()) == len(list(cache.folder().iterdir())) == 3


def test_a_refused_cache_is_named_once(compilations, tmp_path, capsys):
    """On stderr, with --verbose alone."""
    cache.folder().mkdir(parents=True)
    cache.folder().chmod(0o777)
    sweep = tmp_path / "sweep.toml"
    sweep.write_text('scene = "rotary"\n[grid]\nbeta = [0.4]\n[run]\nsettle = 1.0\nobserve = 1.0\n')

    def stderr(*options):
        cache._refused.clear()
        from vibrojax.compile.kernels import kernels

        kernels.clear()
        assert cli.main(["sweep", str(sweep), "-o", str(tmp_path / "out.nc"), "--fresh", *options]) == 0
        return capsys.readouterr().err

    assert stderr("--verbose").count(f"vibrojax: cache refused: {cache.folder()}: others can write to it") == 1
    assert "cache refused" not in stderr()
    assert not list(cache.folder().iterdir())
