"""Claims and the lock of a shared folder: which process works on which part, on one machine or on many.

A claim is a file that only one process can create. It names its owner, who touches it regularly. Another process takes
over a stale claim: its owner is known to have ended (on this machine), or has not touched it for long (elsewhere,
where processes cannot be seen).
"""

import json
import os
import socket
import threading
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from filelock import FileLock, Timeout

from vibrojax.errors import InputError

BEAT = 15.0
"""Seconds between two touches of a claim by its owner."""

STALE = 150.0
"""Age [s] at which an untouched claim is stale: file systems of clusters may show a touch a minute late."""

GONE = "gone"
"""Start time of a process that has ended, see `process_start`."""

_LOCK_PATIENCE = 0.2
"""Seconds in which a process that is just ending may release the lock and remove its file."""

_SUFFIX = ".claim"


@dataclass(frozen=True)
class Owner:
    """A process: name of the machine, process number, and start time, which distinguishes reused numbers.

    `place` identifies the boot and the container in which the number is valid.
    """

    host: str
    process: int
    start: str
    place: str

    @property
    def text(self) -> str:
        return f"{self.host}, process {self.process}"

    def has_ended(self) -> bool:
        """Return whether the process is known to have ended."""
        return self.place == _place() and process_start(self.process) not in ("", self.start)


@dataclass(frozen=True)
class Held:
    """An existing claim: its name, its owner, the time of its creation (ISO 8601), and whether it is stale."""

    name: str
    owner: Owner
    since: str
    stale: bool


class Claims:
    """The claims in a folder; those of this process are touched until they are released."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._mine: set[Path] = set()
        self._lock = threading.Lock()
        self._closed = threading.Event()

    def take(self, name: str) -> bool:
        """Claim `name`; return False if another process holds it, or the folder no longer exists."""
        path = self._path(name)
        content = _read(path)
        if content is not None and not (self._is_stale(path, content) and self._set_aside(path, content)):
            return False
        text = json.dumps(vars(this_process()) | {"since": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"})
        part = self._temporary(path.name)
        try:
            # A link to a whole file: a claim is never seen half-written, and on network file systems, too, only one
            # process succeeds.
            part.write_text(text)
            try:
                os.link(part, path)
            except PermissionError:  # a file system without links
                with open(path, "x") as file:
                    file.write(text)
        except (FileExistsError, FileNotFoundError):  # the latter if the sweep is finished and the folder removed
            return False
        finally:
            with suppress(OSError):
                part.unlink(missing_ok=True)
        with self._lock:
            if not self._mine and not self._closed.is_set():
                threading.Thread(target=self._beat, daemon=True).start()
            self._mine.add(path)
        return True

    def release(self, name: str) -> None:
        """Release a claim of this process."""
        path = self._path(name)
        with self._lock:
            self._mine.discard(path)
        path.unlink(missing_ok=True)

    def release_of(self, process: int) -> None:
        """Release the claims of a process of this machine that has ended."""
        for path, content in self._all():
            owner, _ = _parse(content)
            if owner is not None and owner.process == process and owner.has_ended():
                path.unlink(missing_ok=True)

    def held(self) -> list[Held]:
        """Return all existing claims, sorted by name."""
        held = []
        for path, content in self._all():
            owner, since = _parse(content)
            stale = self._is_stale(path, content)
            held.append(Held(path.name.removesuffix(_SUFFIX), owner or Owner("unknown", 0, "", ""), since, stale))
        return held

    def close(self) -> None:
        """Release all claims of this process."""
        self._closed.set()
        with self._lock:
            mine, self._mine = self._mine, set()
        for path in mine:
            with suppress(OSError):
                path.unlink(missing_ok=True)

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}{_SUFFIX}"

    def _temporary(self, name: str) -> Path:
        return self.folder / f"{name}.{os.getpid()}.{threading.get_ident()}.tmp"

    def _all(self) -> Iterator[tuple[Path, bytes]]:
        for path in sorted(self.folder.glob(f"*{_SUFFIX}")):
            content = _read(path)
            if content is not None:
                yield path, content

    def _is_stale(self, path: Path, content: bytes) -> bool:
        owner, _ = _parse(content)
        if owner is not None and owner.place == _place() and os.name == "posix":
            return owner.has_ended()
        probe = self._temporary("clock")
        try:  # the clock of the file system decides, which may differ from this machine's
            probe.touch()
            return probe.stat().st_mtime - path.stat().st_mtime > STALE
        except OSError:
            return False
        finally:
            probe.unlink(missing_ok=True)

    def _set_aside(self, path: Path, content: bytes) -> bool:
        """Remove a stale claim unless it has been replaced meanwhile; return whether it was removed."""
        aside = self._temporary(path.name)
        try:
            os.rename(path, aside)
        except OSError:  # another process was quicker
            return False
        try:
            if aside.read_bytes() == content:
                return True
            with suppress(FileExistsError):
                os.link(aside, path)
            return False
        finally:
            aside.unlink(missing_ok=True)

    def _beat(self) -> None:
        while not self._closed.wait(BEAT):
            with self._lock:
                mine = list(self._mine)
            for path in mine:
                with suppress(OSError):
                    os.utime(path)


class Lock:
    """An exclusive lock on the file at `path`, held until it is released; acquiring waits up to `patience` seconds.

    It is the system's lock on the open file. The system releases it when the process ends, even if it is killed, so
    that the remaining file blocks nobody. On a file system without locks there is no protection.

    **Raises:** `InputError` if another process holds the lock, or the file cannot be written.
    """

    def __init__(self, path: Path, patience: float = _LOCK_PATIENCE) -> None:
        self.path = path
        # Any thread may release it: a sweep runs in a thread of its own.
        self._lock = FileLock(path, timeout=patience, thread_local=False)
        try:
            self._lock.acquire()  # creates the folder again if another process has just finished and removed it
        except Timeout:
            line = f"{path.parent}: another process is at work there; wait for it, or give another output"
            raise InputError(line) from None
        except OSError as error:
            if error.filename is not None:  # the file could not even be opened
                raise InputError(f"{path}: cannot be written ({error.strerror}); give another output") from None

    def release(self, remove: bool = False) -> None:
        """Release the lock; with `remove`, delete its file first, while no other process can hold it."""
        if remove:
            with suppress(PermissionError):  # Windows keeps an open file, and removes it on release
                self.path.unlink(missing_ok=True)
        self._lock.release()


def is_locked(path: Path) -> bool:
    """Return whether a process holds the lock at `path`, without changing anything."""
    if not path.exists():
        return False
    try:
        with FileLock(path, timeout=0, thread_local=False):
            return False
    except (Timeout, OSError):
        return True


def this_process() -> Owner:
    """Return this process as an owner of claims."""
    return Owner(socket.gethostname(), os.getpid(), process_start(os.getpid()), _place())


def process_start(process: int) -> str:
    """Return the start time of a process of this machine; "gone" if it has ended, "" if the system does not say."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        return GONE if fields[0] in "ZX" else fields[19]
    except OSError:  # no such process, another user's, or a system without /proc
        pass
    if os.name == "posix":  # elsewhere this call ends the process
        try:
            os.kill(process, 0)
        except (ProcessLookupError, OverflowError):
            return GONE
        except OSError:  # another user's
            pass
    return ""


def _read(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except OSError:
        return None


def _parse(content: bytes) -> tuple[Owner | None, str]:
    """Return the owner of a claim, None if the content is malformed, and the time of its creation."""
    try:
        values = json.loads(content)
        owner = Owner(str(values["host"]), int(str(values["process"])), str(values["start"]), str(values["place"]))
        return owner, str(values.get("since", ""))
    except (ValueError, KeyError, TypeError, RecursionError):
        return None, ""


def _place() -> str:
    """Return an identifier of the boot of this machine, and of the container that this process runs in."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {os.readlink('/proc/self/ns/pid')}"
    except OSError:
        return socket.gethostname()
