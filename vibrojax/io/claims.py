"""Claims: which process is at which part of a work that several share in a folder, on one machine or many.

A claim is a file that only one process can make. It says who made it, and its owner touches it now and then. It is
stale, and another takes it over, where its owner is known to have ended (on this machine), or has long not touched it
(on another, whose processes cannot be seen).
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

BEAT = 15.0
"""Seconds between two touches of a claim by its owner."""

STALE = 150.0
"""Seconds after which a claim that nobody touches is stale: file systems of clusters may show a touch a minute late."""

_ENDING = ".claim"


@dataclass(frozen=True)
class Owner:
    """A process: the machine's name, its number there, and which of all that had this number (`start`, "" unknown);
    `place`: where numbers of processes are the same, so that a container is not taken for its host."""

    host: str
    process: int
    start: str
    place: str

    @property
    def text(self) -> str:
        """It in words."""
        return f"{self.host}, process {self.process}"

    def has_ended(self) -> bool:
        """Whether the process is known to have ended."""
        return self.place == _place() and _start_of(self.process) != self.start


@dataclass(frozen=True)
class Held:
    """A claim as it is found: on what, by whom, since when (ISO 8601), and whether it is stale."""

    name: str
    owner: Owner
    since: str
    stale: bool


class Claims:
    """The claims in a folder; those of this process are touched until they are let go."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._mine: set[Path] = set()
        self._lock = threading.Lock()
        self._over = threading.Event()

    def take(self, name: str) -> bool:
        """Claim `name`; False where another process holds it, or the folder is gone."""
        path = self._path(name)
        found = self._read(path)
        if found is not None and not (self._is_stale(path, found) and self._set_aside(path, found)):
            return False
        content = json.dumps(vars(this_process()) | {"since": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"})
        whole = path.with_name(f"{path.name}.{os.getpid()}.{threading.get_ident()}.tmp")
        try:
            # Linked, not opened: so it is never seen half-written, and on network file systems too only one succeeds.
            whole.write_text(content)
            try:
                os.link(whole, path)
            except PermissionError:  # a file system without links
                with open(path, "x") as file:
                    file.write(content)
        except (FileExistsError, FileNotFoundError):  # or all is done, and the folder removed
            return False
        finally:
            with suppress(OSError):
                whole.unlink(missing_ok=True)
        with self._lock:
            if not self._mine and not self._over.is_set():
                threading.Thread(target=self._beat, daemon=True).start()
            self._mine.add(path)
        return True

    def release(self, name: str) -> None:
        """Let go of what this process holds."""
        path = self._path(name)
        with self._lock:
            self._mine.discard(path)
        path.unlink(missing_ok=True)

    def release_of(self, process: int) -> None:
        """Let go of what a process of this machine held that has ended."""
        for path, content in self._all():
            owner = _owner(content)
            if owner is not None and owner.process == process and owner.has_ended():
                path.unlink(missing_ok=True)

    def held(self) -> list[Held]:
        """All claims there are, by name."""
        found = []
        for path, content in self._all():
            owner = _owner(content) or Owner("unknown", 0, "", "")
            since = str(_json(content).get("since", ""))
            found.append(Held(path.name.removesuffix(_ENDING), owner, since, self._is_stale(path, content)))
        return found

    def clear_stale(self) -> None:
        """Remove the claims that are stale."""
        for path, content in self._all():
            if self._is_stale(path, content):
                self._set_aside(path, content)

    def close(self) -> None:
        """Let go of all that this process holds."""
        self._over.set()
        with self._lock:
            mine, self._mine = self._mine, set()
        for path in mine:
            with suppress(OSError):
                path.unlink(missing_ok=True)

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}{_ENDING}"

    def _all(self) -> Iterator[tuple[Path, bytes]]:
        for path in sorted(self.folder.glob(f"*{_ENDING}")):
            content = self._read(path)
            if content is not None:
                yield path, content

    def _read(self, path: Path) -> bytes | None:
        try:
            return path.read_bytes()
        except OSError:
            return None

    def _is_stale(self, path: Path, content: bytes) -> bool:
        owner = _owner(content)
        if owner is not None and owner.place == _place() and os.name == "posix":
            return owner.has_ended()
        try:
            return self._now() - path.stat().st_mtime > STALE
        except OSError:
            return False

    def _now(self) -> float:
        """The time by the clock of the file system, which may not be this machine's."""
        probe = self.folder / f"clock.{os.getpid()}.{threading.get_ident()}.tmp"
        try:
            probe.touch()
            return probe.stat().st_mtime
        finally:
            probe.unlink(missing_ok=True)

    def _set_aside(self, path: Path, content: bytes) -> bool:
        """Remove a claim that was found stale, unless it is another one meanwhile; whether it was removed."""
        aside = path.with_name(f"{path.name}.{os.getpid()}.{threading.get_ident()}.tmp")
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
        while not self._over.wait(BEAT):
            with self._lock:
                mine = list(self._mine)
            for path in mine:
                with suppress(OSError):
                    os.utime(path)


def this_process() -> Owner:
    """Who this is."""
    return Owner(socket.gethostname(), os.getpid(), _start_of(os.getpid()), _place())


def _owner(content: bytes) -> Owner | None:
    found = _json(content)
    try:
        return Owner(str(found["host"]), int(str(found["process"])), str(found["start"]), str(found["place"]))
    except (KeyError, ValueError):
        return None


def _json(content: bytes) -> dict[str, object]:
    try:
        found = json.loads(content)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _place() -> str:
    """Where process numbers mean the same: the boot of a machine, and the container in it."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {os.readlink('/proc/self/ns/pid')}"
    except OSError:
        return socket.gethostname()


def _start_of(process: int) -> str:
    """When a process of this machine began, so that another one of its number is told from it; "gone" where there is
    none; "" where the system does not say when."""
    try:
        stat = Path(f"/proc/{process}/stat").read_text()
    except FileNotFoundError:
        if Path("/proc/self/stat").exists():
            return "gone"
    except OSError:
        return "gone"
    else:
        state, *_, start = stat.rpartition(")")[2].split()[:20]
        return "gone" if state in "ZX" else start
    if os.name != "posix":  # to ask is to end it
        return ""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return "gone"
    except OSError:  # another user's
        return ""
    return ""
