"""The page from a server on this machine, which computes what is clicked or dragged: `vibrojax explore OUT.nc --live`.

It answers two things, under a path that begins with a token that only its address tells:

    GET  /TOKEN/          the page
    POST /TOKEN/motion    JSON {"client": text, "number": whole} with {"parameters": {name: value}, "start": name or
                          vector} or {"lane": whole}: that motion as a block of one cell (see
                          [vibrojax.explorer.cells][])

Of a client (a page that is open), a greater number makes smaller ones obsolete. What is refused is said in one line,
{"error": line}: 400 (wrong values or no such request), 403 (no token, another host or origin), 404, 405, 408, 409
(superseded), 411, 413, 415, 431, 500, 503 with Retry-After.

What could be done from other pages of the browser, it refuses: it listens on the loopback alone, its token is new each
time and compared in constant time, the Host must be its own (or else a name that is made to lead here would do), and an
Origin, if the browser says one, its own.
"""

import base64
import hmac
import json
import re
import secrets
import socket
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from hashlib import sha256
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Any, Protocol

import xarray as xr

from vibrojax.errors import InputError
from vibrojax.explorer._motions import motions_around, motions_of
from vibrojax.explorer._turns import Busy, Check, Closed, Superseded, Turns
from vibrojax.explorer.of_dataset import _sweep, cells_of, document_of, explored
from vibrojax.explorer.write import SIZE, blocks_of, page_text
from vibrojax.timings import LOG

HOST = "127.0.0.1"

MOST_BYTES = 16_384
"""Of a request's body."""

CONNECTIONS = 32
"""That are open at once; a browser opens six."""

SILENCE, PATIENCE = 5.0, 30.0
"""Seconds that a request may keep silent, and may take to come and be answered all together."""

RETRY = 1
"""Seconds after which who was sent away may come again."""

BLOCK = "application/octet-stream"


class Refused(Exception):
    """What a request is answered with instead: a status, and why, in one line."""

    def __init__(self, status: HTTPStatus, why: str) -> None:
        super().__init__(why)
        self.status = status


class Answers(Protocol):
    """What computes: see [vibrojax.explorer._motions.Motions][]."""

    def answer(self, asked: dict[str, Any], check: Check) -> bytes:
        """The block for a request; raises `InputError`, or what `check()` raises."""

    def warm(self) -> None:
        """Compile what answers need."""


class Live:
    """A server of one page, in threads of its own until it is closed; `url` is where the page is.

    **Raises:** `OSError` where this machine gives no port.
    """

    def __init__(self, html: str, answers: Answers) -> None:
        self.html, self.policy = html.encode(), content_policy(html)
        self.answers = answers
        self.token = secrets.token_urlsafe(32)
        self._server = _Server(self)
        self.turns = Turns()
        self.port = int(self._server.server_address[1])
        self.url = f"http://{HOST}:{self.port}/{self.token}/"
        self._threads = [
            threading.Thread(target=self._server.serve_forever, args=(0.1,), name="page", daemon=True),
            threading.Thread(target=self._warm, name="warm", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def __enter__(self) -> "Live":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def wait(self) -> None:
        """Wait until it is closed, or this thread is interrupted."""
        while self._threads[0].is_alive():
            self._threads[0].join(0.5)

    def close(self, seconds: float = 10.0) -> None:
        """Close the port, and wait so long [s] for the threads to end."""
        self.turns.close(seconds)
        self._server.shutdown()
        self._server.server_close()
        for thread in self._threads:
            thread.join(seconds)

    def _warm(self) -> None:
        """The first click should find all compiled; what fails then will fail again where it can be told."""
        try:
            self.turns.ask("", 0, lambda check: self.answers.warm())
        except Exception as error:
            LOG.info("not warm: %s", error)


def serve(ds: xr.Dataset, over: xr.Dataset | None = None, progress: bool = False) -> Live:
    """The live page of a dataset, served until it is closed.

    **Arguments:** `ds`, `over`, `progress`: as `write_page` takes them.

    **Raises:** `InputError` where there is nothing of the dataset to show or to simulate, `OSError` where this machine
    gives no port.
    """
    ds, over = explored(ds, over, progress)
    document = document_of(ds, over)
    sweep, _ = _sweep(ds)
    motions = motions_of(sweep) if sweep is not None else motions_around(ds)
    blocks = [] if sweep is not None else blocks_of(cells_of(ds, progress))
    if blocks:
        document["cells"] = {"size": SIZE, "blocks": len(blocks)}
    return Live(page_text(document | {"live": motions.offered()}, blocks), motions)


def content_policy(html: str) -> str:
    """What the page may do: run the scripts that stand in it, and ask this server; load nothing else."""
    scripts = re.findall(r"<script type=\"?module\"?>(.*?)</script>", html, flags=re.DOTALL)
    hashes = (base64.b64encode(sha256(script.encode()).digest()).decode() for script in scripts)
    allowed = " ".join(f"'sha256-{one}'" for one in dict.fromkeys(hashes)) or "'none'"
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


class _Server(ThreadingHTTPServer):
    """Each connection in a thread; not too many, and none for too long."""

    daemon_threads = False  # so that closing waits for them
    allow_reuse_address = False
    request_queue_size = 64

    def __init__(self, live: Live) -> None:
        self.live = live
        self._open: dict[socket.socket, float] = {}
        self._lock = threading.Lock()
        super().__init__((HOST, 0), _Handler)
        self.names = {f"{host}:{self.server_address[1]}" for host in (HOST, "localhost")}

    def verify_request(self, request: Any, client_address: Any) -> bool:
        """Whether there is room for a connection; who finds none is told."""
        with self._lock:
            room = len(self._open) < CONNECTIONS
            if room:
                self._open[request] = time.monotonic()
        if not room:
            request.settimeout(SILENCE / 100)
            with suppress(OSError):
                request.sendall(
                    f"HTTP/1.1 503 Service Unavailable\r\nRetry-After: {RETRY}\r\n"
                    "Content-Length: 0\r\nConnection: close\r\n\r\n".encode()
                )
        return room

    def shutdown_request(self, request: Any) -> None:
        """A connection is over."""
        with self._lock:
            self._open.pop(request, None)
        super().shutdown_request(request)

    def service_actions(self) -> None:
        """Now and then: let go of who takes too long."""
        with self._lock:
            late = [one for one, since in self._open.items() if time.monotonic() - since > PATIENCE]
        self._hang_up(late)

    def server_close(self) -> None:
        """Close the port and all connections, and wait for their threads."""
        with self._lock:
            every = list(self._open)
        self._hang_up(every)
        super().server_close()

    def _hang_up(self, connections: list[socket.socket]) -> None:
        for one in connections:
            with suppress(OSError):  # it may have gone already
                one.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A connection that broke off is nobody's concern; no traceback."""
        LOG.info("a connection ended: %s", sys.exc_info()[1])


class _Handler(BaseHTTPRequestHandler):
    """One request; the connection ends with its answer."""

    server: _Server
    timeout = SILENCE
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "vibrojax", ""
    unread = False

    def do_GET(self) -> None:
        """The page, or why not."""
        self._answered(lambda: ("text/html; charset=utf-8", self._page()))

    do_HEAD = do_GET

    def do_POST(self) -> None:
        """A motion, or why not."""
        self._answered(lambda: (BLOCK, self._motion()))

    def version_string(self) -> str:
        """What answers say of the server."""
        return self.server_version

    def finish(self) -> None:
        """The end of a connection: one that is closed on what has not been read may lose its answer on the way."""
        super().finish()
        if not self.unread:
            return
        with suppress(OSError):
            self.connection.shutdown(socket.SHUT_WR)
            self.connection.settimeout(SILENCE / 10)
            end = time.monotonic() + SILENCE
            while time.monotonic() < end and self.connection.recv(65536):
                pass

    def _answered(self, answer: Callable[[], tuple[str, bytes]]) -> None:
        self.unread = "Content-Length" in self.headers or "Transfer-Encoding" in self.headers
        try:
            self._admitted()
            kind, body = answer()
        except Refused as refused:
            self._say(refused.status, str(refused))
        except InputError as error:
            self._say(HTTPStatus.BAD_REQUEST, str(error))
        except Superseded:
            self._say(HTTPStatus.CONFLICT, "superseded: something newer was asked for")
        except (Busy, Closed):
            self._say(HTTPStatus.SERVICE_UNAVAILABLE, "too much is asked for at once; try again")
        except TimeoutError:
            self._say(HTTPStatus.REQUEST_TIMEOUT, "the request did not come to its end")
        except ConnectionError:
            raise
        except Exception as error:
            LOG.error("explore: %s: %s", type(error).__name__, error)
            self._say(HTTPStatus.INTERNAL_SERVER_ERROR, "this could not be computed; the server's log may say why")
        else:
            self._send(HTTPStatus.OK, kind, body)

    def _admitted(self) -> None:
        """Whether whoever asks may; raises `Refused`."""
        hosts, origins = self.headers.get_all("Host", []), self.headers.get_all("Origin", [])
        if len(hosts) != 1 or hosts[0].lower() not in self.server.names:
            raise Refused(HTTPStatus.FORBIDDEN, "another host than this server's")
        if any(one not in {f"http://{name}" for name in self.server.names} for one in origins):
            raise Refused(HTTPStatus.FORBIDDEN, "another origin than this server's")
        if self.headers.get("Sec-Fetch-Site", "none") not in ("none", "same-origin"):
            raise Refused(HTTPStatus.FORBIDDEN, "another origin than this server's")
        given, _, self.rest = self.path.removeprefix("/").partition("/")
        if not hmac.compare_digest(given.encode(), self.server.live.token.encode()):
            raise Refused(HTTPStatus.FORBIDDEN, "no token, or a wrong one: open the address that was printed")

    def _page(self) -> bytes:
        if self.rest == "motion":
            raise Refused(HTTPStatus.METHOD_NOT_ALLOWED, "POST is for motions")
        if self.rest:
            raise Refused(HTTPStatus.NOT_FOUND, "there is nothing here")
        return self.server.live.html

    def _motion(self) -> bytes:
        if self.rest == "":
            raise Refused(HTTPStatus.METHOD_NOT_ALLOWED, "GET is for the page")
        if self.rest != "motion":
            raise Refused(HTTPStatus.NOT_FOUND, "there is nothing here")
        asked = self._asked()
        client, number = asked.pop("client", None), asked.pop("number", None)
        if not isinstance(client, str) or not 0 < len(client) <= 64:
            raise Refused(HTTPStatus.BAD_REQUEST, "client: 1 to 64 characters are needed")
        if type(number) is not int or not 0 <= number < 2**53:
            raise Refused(HTTPStatus.BAD_REQUEST, "number: a whole number from 0 is needed")
        live = self.server.live
        return live.turns.ask(client, number, lambda check: live.answers.answer(asked, check))

    def _asked(self) -> dict[str, Any]:
        """The request's body."""
        if self.headers.get_content_type() != "application/json":
            raise Refused(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "application/json is needed")
        lengths = self.headers.get_all("Content-Length", [])
        if not lengths or "Transfer-Encoding" in self.headers:
            raise Refused(HTTPStatus.LENGTH_REQUIRED, "a Content-Length is needed")
        if len(lengths) > 1 or not re.fullmatch(r"[0-9]{1,18}", lengths[0]):
            raise Refused(HTTPStatus.BAD_REQUEST, "Content-Length: one whole number is needed")
        length = int(lengths[0])
        if length > MOST_BYTES:
            raise Refused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"{MOST_BYTES} bytes at most")
        body = self.rfile.read(length)
        self.unread = False
        if len(body) < length:
            raise Refused(HTTPStatus.BAD_REQUEST, "the body is shorter than its Content-Length")
        try:
            asked = json.loads(body)
        except (ValueError, RecursionError):
            raise Refused(HTTPStatus.BAD_REQUEST, "the body is no JSON") from None
        if not isinstance(asked, dict):
            raise Refused(HTTPStatus.BAD_REQUEST, "the body is no JSON object")
        return asked

    def _say(self, status: HTTPStatus, why: str) -> None:
        self._send(status, "application/json", json.dumps({"error": " ".join(why.split())}).encode())

    def _send(self, status: HTTPStatus, kind: str, body: bytes) -> None:
        self.close_connection = True
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Content-Security-Policy", self.server.live.policy)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.send_header("Cross-Origin-Opener-Policy", "same-origin")
        self.send_header("Cache-Control", "no-store")
        self.send_header("Connection", "close")
        if status == HTTPStatus.METHOD_NOT_ALLOWED:
            self.send_header("Allow", "GET, HEAD, POST")
        if status == HTTPStatus.SERVICE_UNAVAILABLE:
            self.send_header("Retry-After", str(RETRY))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """What the standard library refuses: in one line too, and methods it does not know as wrong ones."""
        status = HTTPStatus.METHOD_NOT_ALLOWED if code == HTTPStatus.NOT_IMPLEMENTED else HTTPStatus(code)
        self._say(status, status.phrase.lower())

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: paths hold the token."""
