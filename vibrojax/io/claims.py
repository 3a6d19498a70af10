"""Claims and the lock of a shared folder, which record what part each process works on, on one machine or many.

A claim is a file that only one process can create. It names its owner, the process that created it. The owner updates
the file's modification time regularly. Another process takes over a stale claim. On this machine, a claim is stale if
its owner has ended. On other machines, whose processes are not visible, it is stale if its modification time is too
old.
"""

import json
import os
import socket
import threading
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from filelock import FileLock, Timeout

from vibrojax.errors import InputError
from vibrojax.io.files import new_file

BEAT = 15.0
"""Interval [s] at which an owner updates the modification times of its claims."""

STALE = 150.0
"""Time [s] without an update after which a claim is stale: cluster file systems may show updates a minute late."""

GONE = "gone"
"""Start time that `process_start` returns for a process that has ended."""

_LOCK_PATIENCE = 0.2
"""Time [s] to wait for the lock, so that a process that is just ending can release it and remove its file."""

_TAKEOVER_PATIENCE = 5.0
"""Time [s] to wait while another process takes over a stale claim, which takes milliseconds."""

_SUFFIX = ".claim"


@dataclass(frozen=True)
class Owner:
    """A process: host name, process ID, and start time, which distinguishes reused process IDs.

    `place` identifies the boot and the container in which the process ID is valid.
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


class Held(NamedTuple):
    """An existing claim: its name, its owner, its creation time (ISO 8601), and whether it is stale."""

    name: str
    owner: Owner
    since: str
    stale: bool


class Claims:
    """The claims in a folder; claims of this process are updated regularly until they are released."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._mine: set[Path] = set()
        self._lock = threading.Lock()
        self._closed = threading.Event()

    def take(self, name: str) -> bool:
        """Claim `name`; return False if another process holds the claim, or the folder no longer exists."""
        path = self._path(name)
        content = _read(path)
        try:
            if content is not None and not (self._held(path, content).stale and self._remove_stale(path)):
                return False
        except (Timeout, OSError):  # another process is at it, or the folder is gone
            return False
        text = json.dumps(vars(this_process()) | {"since": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"})
        part = self._temporary(path.name)
        try:
            # Hard-link a complete file: no process ever sees a half-written claim, and even on network file systems
            # only one process succeeds.
            with new_file(part) as file:
                file.write(text.encode())
            try:
                os.link(part, path)
            except PermissionError:  # a file system without links
                with open(path, "x") as file:
                    file.write(text)
        except (FileExistsError, FileNotFoundError):  # not found: the sweep is finished and the folder removed
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
        path = self._path(name)
        with self._lock:
            self._mine.discard(path)
        path.unlink(missing_ok=True)

    def release_of(self, process: int) -> None:
        """Release the claims of an ended process of this machine."""
        for held in self.held():
            if held.owner.process == process and held.owner.has_ended():
                self._path(held.name).unlink(missing_ok=True)

    def held(self) -> list[Held]:
        contents = {path: _read(path) for path in sorted(self.folder.glob(f"*{_SUFFIX}"))}
        return [self._held(path, content) for path, content in contents.items() if content is not None]

    def close(self) -> None:
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

    def _held(self, path: Path, content: bytes) -> Held:
        """Return the claim at `path`; the owner is unknown if the content is malformed."""
        name = path.name.removesuffix(_SUFFIX)
        try:
            values = json.loads(content)
            owner = Owner(str(values["host"]), int(str(values["process"])), str(values["start"]), str(values["place"]))
            since = str(values.get("since", ""))
        except (ValueError, KeyError, TypeError, RecursionError):
            owner, since = Owner("unknown", 0, "", ""), ""
        if owner.place == _place() and os.name == "posix":
            return Held(name, owner, since, owner.has_ended())
        probe = self._temporary("clock")
        try:  # use the clock of the file system, which may differ from this machine's
            probe.touch()
            return Held(name, owner, since, probe.stat().st_mtime - path.stat().st_mtime > STALE)
        except OSError:
            return Held(name, owner, since, False)
        finally:
            probe.unlink(missing_ok=True)

    def _remove_stale(self, path: Path) -> bool:
        """Remove a stale claim; return False if another process holds the claim by now.

        Only one process at a time compares and removes, so that no process removes a claim that has just been renewed.
        """
        # The suffix is that of temporary files, which are removed with the chunks.
        with FileLock(self.folder / f"{path.name}.0.0.tmp", timeout=_TAKEOVER_PATIENCE, thread_local=False):
            content = _read(path)
            stale = content is not None and self._held(path, content).stale
            if stale:
                path.unlink(missing_ok=True)
            return stale or content is None

    def _beat(self) -> None:
        while not self._closed.wait(BEAT):
            with self._lock:
                mine = list(self._mine)
            for path in mine:
                with suppress(OSError):
                    os.utime(path)


def lock(path: Path, patience: float = _LOCK_PATIENCE) -> FileLock:
    """Return an exclusive lock on the file at `path`, after waiting for it up to `patience` seconds.

    The operating system locks the open file, and releases the lock when the process ends, even if it is killed. A file
    that remains therefore blocks no other process. On a file system without locks there is no protection.

    **Raises:** `InputError` if another process holds the lock, or the file is not writable.
    """
    held = FileLock(path, timeout=patience, thread_local=False)  # any thread may release it: a sweep runs in its own
    try:
        held.acquire()  # creates the folder again if another process has just finished and removed it
    except Timeout:
        line = f"{path.parent}: another process is at work there; wait for it, or give another output"
        raise InputError(line) from None
    except OSError as error:
        if error.filename is not None:  # the file could not even be opened
            raise InputError(f"{path}: cannot be written ({error.strerror}); give another output") from None
    return held


def is_locked(path: Path) -> bool:
    """Return whether any process holds the lock at `path`; the check has no side effects."""
    try:
        if path.exists():
            FileLock(path, timeout=0, thread_local=False).acquire().lock.release()
    except (Timeout, OSError):
        return True
    return False


def this_process() -> Owner:
    """Return the `Owner` that describes this process."""
    return Owner(socket.gethostname(), os.getpid(), process_start(os.getpid()), _place())


def process_start(process: int) -> str:
    """Return the start time of a process of this machine: "gone" if it has ended, "" if unknown."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        return GONE if fields[0] in "ZX" else fields[19]
    except OSError:  # no such process, another user's, or a system without /proc
        pass
    if os.name == "posix":  # on other systems this call ends the process
        try:
            os.kill(process, 0)
        except (ProcessLookupError, OverflowError):
            return GONE
        except OSError:  # a process of another user
            pass
    return ""


def _read(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except OSError:
        return None


def _place() -> str:
    """Return an identifier of this machine's boot, and of the container in which this process runs."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {os.readlink('/proc/self/ns/pid')}"
    except OSError:
        return socket.gethostname()
