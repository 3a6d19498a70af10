"""Compiled kernels are kept: nothing that becomes of the folder is more than a loss of time."""

import os
import time

import numpy as np
import pytest

from vibrojax.compile.kernels import Kernel, cache, native

X = np.linspace(0.0, 1.0, 5)


@pytest.fixture
def compilations(monkeypatch, tmp_path):
    """A cache of its own, and a list that grows with every compilation."""
    monkeypatch.setenv(cache.CACHE_VARIABLE, str(tmp_path / "cache"))
    made = []
    compiled = native._object_code
    monkeypatch.setattr(native, "_object_code", lambda text: made.append(text) or compiled(text))
    return made


def use(factor=3.0):
    kernel = Kernel(lambda x: factor * x + 1, X)
    np.testing.assert_array_equal(kernel(X), factor * X + 1)


def files():
    return sorted(cache.folder().iterdir())


def test_compiled_once(compilations):
    use()
    use()
    assert len(compilations) == 1 and len(files()) == 1
    use(4.0)
    assert len(compilations) == 2 and len(files()) == 2


@pytest.mark.parametrize("damage", [b"", b"short", None])
def test_damaged(compilations, damage):
    """Compiled anew, and kept anew."""
    use()
    [file] = files()
    content = file.read_bytes()
    flipped = content[:200] + bytes([content[200] ^ 1]) + content[201:]
    file.write_bytes(flipped if damage is None else damage)
    use()
    assert len(compilations) == 2 and files()[0].read_bytes() == content


def test_another_processor_shares_nothing(compilations, monkeypatch):
    use()
    other = native.processor()._replace(features="+nothing")
    key = cache.read
    asked = []
    monkeypatch.setattr(native, "processor", lambda: other)
    monkeypatch.setattr(cache, "read", lambda name: asked.append(name) or key(name))
    monkeypatch.setattr(native, "_object_code", lambda text: (_ for _ in ()).throw(RuntimeError("compiled again")))
    with pytest.raises(RuntimeError, match="compiled again"):
        use()
    assert asked[0] not in [file.name for file in files()]


def test_switched_off(compilations, monkeypatch):
    monkeypatch.setenv(cache.CACHE_VARIABLE, "off")
    use()
    use()
    assert cache.folder() is None and len(compilations) == 2


def test_a_folder_that_cannot_be_used(compilations, monkeypatch, tmp_path):
    """Here a file stands where the folder should be."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(cache.CACHE_VARIABLE, str(tmp_path / "file"))
    use()
    use()
    assert len(compilations) == 2


def test_what_is_old_is_dropped(compilations, monkeypatch):
    use()
    [old] = files()
    left_behind = old.with_name(f"{cache.TEMPORARY}half")
    left_behind.write_bytes(b"half")
    for file in (old, left_behind):
        os.utime(file, (time.time() - 100 * 86400,) * 2)
    use(5.0)
    assert old not in files() and left_behind not in files() and len(files()) == 1
    monkeypatch.setattr(cache, "KEPT_BYTES", 1.5 * files()[0].stat().st_size)
    os.utime(files()[0], (time.time() - 60,) * 2)
    before = files()
    use(6.0)
    assert len(files()) == 1 and files() != before
