"""A server for one page on this machine alone: who may ask, and how much; [vibrojax.explorer.live][] answers.

What could be done from other pages of the browser, it refuses: it listens on the loopback, its token is new each time
and compared in constant time, the Host must be its own (or else a name that is made to lead here would do), and an
Origin, if the browser says one, its own.
"""

import hmac
import json
import re
import socket
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, NamedTuple

from vibrojax.errors import InputError
from vibrojax.explorer._turns import Busy, Closed, Superseded
from vibrojax.progress import LOG

HOST = "127.0.0.1"

MOST_BYTES = 16_384
"""Of a request's body."""

CONNECTIONS = 32
"""That are open at once; a browser opens six."""

HEADER_SECONDS = 3.0
"""Seconds in which a connection must show the token: the whole header, which a browser sends at once."""

SILENCE, PATIENCE = 5.0, 30.0
"""Seconds that a request with the token may keep silent, and may take to come and be answered all together."""

RETRY = 1
"""Seconds after which who was sent away may come again."""

BLOCK = "application/octet-stream"
HTML = "text/html; charset=utf-8"


class Served(NamedTuple):
    """What is served: the page, the token, and who answers.

    `ask(client, number, asked)` gives a block; it raises `InputError`, `Superseded`, `Busy` or `Closed`.
    """

    html: bytes
    token: str
    ask: Callable[[str, int, dict[str, Any]], bytes]


class Refused(Exception):
    """What a request is answered with instead: a status, and why, in one line."""

    def __init__(self, status: HTTPStatus, why: str) -> None:
        super().__init__(why)
        self.status = status


@dataclass
class _Connection:
    """An open connection: since when, and whether its header has shown the token."""

    since: float
    admitted: bool = False

    def is_late(self, now: float) -> bool:
        """Return whether it has taken longer than it may."""
        return now - self.since > (PATIENCE if self.admitted else HEADER_SECONDS)


class Server(ThreadingHTTPServer):
    """Each connection in a thread; not too many, and none for too long.

    A connection that has not shown the token has little time, and makes room when there are too many: the oldest goes.
    So whoever has no token cannot keep out the page, however many connections they open and however slowly they send.
    """

    daemon_threads = False  # so that closing waits for them
    allow_reuse_address = False
    request_queue_size = 64

    def __init__(self, served: Served) -> None:
        self.served = served
        self._open: dict[socket.socket, _Connection] = {}  # the oldest first
        self._lock = threading.Lock()
        super().__init__((HOST, 0), _Handler)
        self.names = {f"{host}:{self.server_address[1]}" for host in (HOST, "localhost")}

    def verify_request(self, request: Any, client_address: Any) -> bool:
        """Make room for a connection; return whether there is any, and answer 503 if there is none."""
        with self._lock:
            evicted = []
            if len(self._open) >= CONNECTIONS:
                evicted = [socket for socket, connection in self._open.items() if not connection.admitted][:1]
            for oldest in evicted:
                del self._open[oldest]
            room = len(self._open) < CONNECTIONS
            if room:
                self._open[request] = _Connection(time.monotonic())
        self._hang_up(evicted)
        if not room:
            request.settimeout(SILENCE / 100)
            with suppress(OSError):
                request.sendall(
                    f"HTTP/1.1 503 Service Unavailable\r\nRetry-After: {RETRY}\r\n"
                    "Content-Length: 0\r\nConnection: close\r\n\r\n".encode()
                )
        return room

    def admit(self, request: socket.socket) -> None:
        """Give a connection that has shown the token its time."""
        with self._lock:
            if request in self._open:
                self._open[request].admitted = True

    def shutdown_request(self, request: Any) -> None:
        """A connection is over."""
        with self._lock:
            self._open.pop(request, None)
        super().shutdown_request(request)

    def service_actions(self) -> None:
        """Hang up on connections that are late; called ten times a second."""
        now = time.monotonic()
        with self._lock:
            late = [socket for socket, connection in self._open.items() if connection.is_late(now)]
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

    server: Server
    timeout = SILENCE
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "vibrojax", ""
    unread = False

    def do_GET(self) -> None:
        """The page, or why not."""
        self._answered(lambda: (HTML, self._page()))

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
        if not hmac.compare_digest(given.encode(), self.server.served.token.encode()):
            raise Refused(HTTPStatus.FORBIDDEN, "no token, or a wrong one: open the address that was printed")
        self.server.admit(self.connection)

    def _page(self) -> bytes:
        if self.rest == "motion":
            raise Refused(HTTPStatus.METHOD_NOT_ALLOWED, "POST is for motions")
        if self.rest:
            raise Refused(HTTPStatus.NOT_FOUND, "there is nothing here")
        return self.server.served.html

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
        return self.server.served.ask(client, number, asked)

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
        # The page says itself what its browser may do; no other answer may do anything.
        allowed = "base-uri 'none'; form-action 'none'" if kind == HTML else "default-src 'none'"
        self.send_header("Content-Security-Policy", f"{allowed}; frame-ancestors 'none'")
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
