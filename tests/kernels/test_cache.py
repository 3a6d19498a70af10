"""The cache of kernels: it loads only what this user wrote; damage or refusal costs a compilation and nothing else."""

import functools
import logging
import os
import stat
import threading
import time

import numpy as np
import pytest

from vibrojax import cli
from vibrojax.compile.kernels import Kernel, cache, kernels, native

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
def file(compilations):
    """The cached file of one kernel."""
    use()
    [file] = kept()
    return file


@pytest.fixture
def refusals(caplog):
    """Return a function that lists the refusals in the log."""
    caplog.set_level(logging.INFO, "vibrojax")
    return lambda: [text for text in (record.getMessage() for record in caplog.records) if "cache refused" in text]


def use(factor=3.0):
    kernel = Kernel(lambda x: factor * x + 1, X)
    np.testing.assert_array_equal(kernel(X), factor * X + 1)


def kept():
    return sorted(path for path in cache.folder().iterdir() if cache.KEY.fullmatch(path.name))


def refused(path, reason):
    return [f"cache refused: {path}: {reason}; kernels are compiled again"]


def test_compiled_once(compilations):
    use()
    use()
    assert len(compilations) == 1 and len(kept()) == 1
    use(4.0)
    assert len(compilations) == 2 and len(kept()) == 2


def test_another_processor_shares_nothing(file, monkeypatch):
    other = native.processor()._replace(features="+nothing")
    read, keys = cache.read, []
    monkeypatch.setattr(native, "processor", lambda: other)
    monkeypatch.setattr(cache, "read", lambda key: keys.append(key) or read(key))
    monkeypatch.setattr(native, "_object_code", lambda text: (_ for _ in ()).throw(RuntimeError("compiled again")))
    with pytest.raises(RuntimeError, match="compiled again"):
        use()
    assert keys[0] != file.name


@pytest.mark.parametrize("folder", ["off", "file"])
def test_without_a_folder(compilations, monkeypatch, tmp_path, folder):
    """Switched off, or where a file stands in place of the folder."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(cache.CACHE_VARIABLE, folder if folder == "off" else str(tmp_path / folder))
    use()
    use()
    assert (cache.folder() is None) == (folder == "off") and len(compilations) == 2


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
def test_a_folder_that_others_write_to(file, compilations, refusals, mode):
    """The folder of the files itself: the sticky bit does not keep others from adding files."""
    cache.folder().chmod(mode)
    use()
    use(5.0)
    assert len(compilations) == 3 and kept() == [file]
    assert refusals() == refused(cache.folder(), "others can write to it")


@pytest.mark.parametrize("mode, unsafe", [(0o777, True), (0o773, True), (0o1777, False), (0o775, False)])
def test_the_folder_above(file, compilations, refusals, mode, unsafe):
    """In one like /tmp the folder of the files is safe; where all can replace it, it is refused."""
    cache.folder().parent.chmod(mode)
    use()
    assert len(compilations) == 1 + unsafe
    assert refusals() == refused(cache.folder().parent, "others can write to it") * unsafe


@pytest.mark.parametrize("mode", [0o620, 0o602, 0o666])
def test_a_file_that_others_write_to(file, compilations, refusals, mode):
    """It is replaced by one that only the user writes to."""
    file.chmod(mode)
    use()
    assert len(compilations) == 2 and stat.S_IMODE(file.stat().st_mode) == 0o600
    assert refusals() == refused(file, "others can write to it")
    use()
    assert len(compilations) == 2


@pytest.mark.parametrize("of", ["folder", "file"])
def test_another_user(file, compilations, refusals, monkeypatch, of):
    """What belongs, or seems to belong, to another user is refused, also by root."""
    path = file if of == "file" else file.parent
    if os.geteuid() == 0:
        os.chown(path, STRANGER, -1)
    else:
        fstat, inode = os.fstat, os.stat(path).st_ino

        def seems(descriptor):
            about = fstat(descriptor)
            changed = list(about)
            changed[stat.ST_UID] = STRANGER if about.st_ino == inode else about.st_uid
            return os.stat_result(changed)

        monkeypatch.setattr(os, "fstat", seems)
    use()
    assert len(compilations) == 2 and refusals() == refused(path, "belongs to another user")


@pytest.mark.parametrize("of", ["folder", "file"])
def test_a_link(file, compilations, refusals, tmp_path, of):
    """It is not followed, though what it points to is whole and belongs to the user."""
    path, elsewhere = file if of == "file" else file.parent, tmp_path / "planted"
    path.rename(elsewhere)
    path.symlink_to(elsewhere)
    use()
    [line] = refusals()
    assert len(compilations) == 2 and line.startswith(f"cache refused: {path}: ")
    assert elsewhere.exists() and path.is_symlink() == (of == "folder")


def test_what_is_no_file(file, compilations, refusals):
    """A pipe does not stop the sweep."""
    file.unlink()
    os.mkfifo(file)
    use()
    assert len(compilations) == 2 and refusals() == refused(file, "is not a regular file")


def test_swapped_contents(compilations, refusals):
    """Code of another kernel under this key ended the process (signal 11)."""
    use(3.0)
    use(4.0)
    first, second = kept()
    one, other = first.read_bytes(), second.read_bytes()
    first.write_bytes(other)
    second.write_bytes(one)
    use(3.0)
    use(4.0)
    assert len(compilations) == 4 and len(refusals()) == 1
    assert "is damaged, or does not belong under this name" in refusals()[0]
    assert (first.read_bytes(), second.read_bytes()) == (one, other)


@pytest.mark.parametrize("length", [None, 0, 10, cache.HEADER - 1, cache.HEADER, cache.HEADER + 100])
def test_damaged(file, compilations, refusals, length):
    """Truncated, or with a flipped bit: compiled anew, and kept anew."""
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
    assert len(kept()) == 1 and kept() != [newer]


def test_pruning_leaves_what_is_not_its_own(file, monkeypatch):
    """The oldest file is deleted, and nothing of others, however old."""
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
    """Each gets its kernel, from the cache or compiled, and no file is left half-written."""
    for _ in range(2):
        threads = [threading.Thread(target=use, args=(float(factor % 3),)) for factor in range(12)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len(kept()) == len(list(cache.folder().iterdir())) == 3


def test_a_refused_cache_is_named_once(compilations, monkeypatch, tmp_path, capsys):
    """On stderr, with --verbose alone."""
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
