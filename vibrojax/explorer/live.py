"""The explorer page from a server on this machine that computes motions on demand: `vibrojax explore OUT.nc --live`.

The server handles two requests. Their paths begin with a token. Only the printed address contains the token.

    GET  /TOKEN/          the page
    POST /TOKEN/motion    JSON {"client": string, "number": integer} with {"parameters": {name: value}, "start": name
                          or vector} or {"lane": integer}: one motion, encoded as in [vibrojax.explorer.encoding][]

A request makes all requests of the same client (an open page) with smaller numbers obsolete. A rejected request gets
{"error": line} and a status: 409 if it is obsolete, 503 with Retry-After if there are too many requests, or another
HTTP status.

The server protects itself from other web pages in the same browser. It listens on the loopback interface only. Its
token is new at each start and is compared in constant time. The Host header must be the server's own, since another
host name could be made to resolve to this machine. An Origin header, if the browser sends one, must be the server's
own, too. A connection that has not sent the token is soon closed.
"""

import hmac
import json
import re
import secrets
import socket
import sys
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, TypeVar

import xarray as xr

from vibrojax.errors import InputError
from vibrojax.explorer.write import page_contents, page_text
from vibrojax.progress import LOG

HOST = "127.0.0.1"

BODY_MAX_BYTES = 16_384  # maximum size of a request body; parameters and an initial condition take a few hundred bytes

HEADER_MAX_SECONDS, REQUEST_MAX_SECONDS = 3.0, 30.0
"""Time within which a connection must have sent the token, and further time for the request and its response."""

CONNECTIONS_MAX = 32  # open connections; a new one takes the place of the one whose time limit ends first
SILENCE_MAX_SECONDS = 5.0  # longest pause within a request
METHODS = {"": ("GET", "HEAD"), "motion": ("POST",)}  # allowed methods by the path after the token

SECURITY_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
    "Connection": "close",
}

Ask = Callable[[str, int, dict[str, Any]], bytes]
"""`ask(client, number, request)` returns an encoded motion; it raises `InputError` or `RefusedRequest`."""


class RefusedRequest(Exception):
    """A rejected request: the HTTP status of the response, and the reason in one line."""

    def __init__(self, status: HTTPStatus, reason: str) -> None:
        super().__init__(reason)
        self.status = status


class Server(ThreadingHTTPServer):
    """A server with one thread per connection, which closes connections after a limit, short without the token."""

    allow_reuse_address = False
    request_queue_size = 64

    def __init__(self, html: bytes, token: str, ask: Ask) -> None:
        self.html, self.token, self.ask = html, token, ask
        self.deadlines: dict[socket.socket, float] = {}
        super().__init__((HOST, 0), _Handler)
        self.names = {f"{host}:{self.server_address[1]}" for host in (HOST, "localhost")}

    def process_request(self, request: Any, client_address: Any) -> None:
        if len(self.deadlines) >= CONNECTIONS_MAX:
            self._hang_up(min(self.deadlines.values()))
        self.deadlines[request] = time.monotonic() + HEADER_MAX_SECONDS
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        self.deadlines.pop(request, None)
        super().shutdown_request(request)

    def service_actions(self) -> None:
        """Close connections that take too long; called ten times per second."""
        self._hang_up(time.monotonic())

    def server_close(self) -> None:
        super().server_close()
        self._hang_up(float("inf"))

    def _hang_up(self, now: float) -> None:
        for connection, deadline in list(self.deadlines.items()):
            if now >= deadline:
                with suppress(OSError):  # the connection may be closed already
                    connection.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Log a broken connection without a traceback."""
        LOG.info("a connection ended: %s", sys.exc_info()[1])


class _Handler(BaseHTTPRequestHandler):
    """Handler of one request; the connection is closed after the response."""

    server: Server
    timeout = SILENCE_MAX_SECONDS
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "vibrojax", ""
    has_unread_body = False

    def finish(self) -> None:
        """Close the connection after reading the rest of the request; closing it earlier could lose the response."""
        super().finish()
        if self.has_unread_body:
            with suppress(OSError):
                self.connection.shutdown(socket.SHUT_WR)
                while self.connection.recv(65536):  # until the time limit of the connection at most
                    pass

    def _answer(self) -> None:
        self.has_unread_body = "Content-Length" in self.headers or "Transfer-Encoding" in self.headers
        try:
            path = self._check_access()
            if path not in METHODS:
                raise RefusedRequest(HTTPStatus.NOT_FOUND, "there is nothing here")
            if self.command not in METHODS[path]:
                raise RefusedRequest(HTTPStatus.METHOD_NOT_ALLOWED, "GET is for the page, POST for motions")
            body = self._motion() if path else self.server.html
        except RefusedRequest as refusal:
            self._send_line(refusal.status, str(refusal))
        except InputError as error:
            self._send_line(HTTPStatus.BAD_REQUEST, str(error))
        except TimeoutError:
            self._send_line(HTTPStatus.REQUEST_TIMEOUT, "the request did not come to its end")
        except ConnectionError:
            raise
        except Exception as error:
            LOG.error("explore: %s: %s", type(error).__name__, error)
            reason = "this could not be computed; the server's log may give the reason"
            self._send_line(HTTPStatus.INTERNAL_SERVER_ERROR, reason)
        else:
            # The page contains its own policy.
            policy = "default-src 'none'" if path else "base-uri 'none'; form-action 'none'"
            self._send(HTTPStatus.OK, "application/octet-stream" if path else "text/html; charset=utf-8", body, policy)

    do_GET = do_HEAD = do_POST = _answer

    def _check_access(self) -> str:
        """Return the path after the token; raise `RefusedRequest` unless host, origin and token are its own."""
        hosts, origins = self.headers.get_all("Host", []), self.headers.get_all("Origin", [])
        if len(hosts) != 1 or hosts[0].lower() not in self.server.names:
            raise RefusedRequest(HTTPStatus.FORBIDDEN, "another host than this server's")
        is_own = all(origin in {f"http://{name}" for name in self.server.names} for origin in origins)
        if not is_own or self.headers.get("Sec-Fetch-Site", "none") not in ("none", "same-origin"):
            raise RefusedRequest(HTTPStatus.FORBIDDEN, "another origin than this server's")
        token, _, path = self.path.removeprefix("/").partition("/")
        if not hmac.compare_digest(token.encode(), self.server.token.encode()):
            raise RefusedRequest(HTTPStatus.FORBIDDEN, "a missing or wrong token: open the address that was printed")
        self.server.deadlines[self.connection] = time.monotonic() + REQUEST_MAX_SECONDS
        return path

    def _motion(self) -> bytes:
        if self.headers.get_content_type() != "application/json":
            raise RefusedRequest(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "application/json is needed")
        lengths = self.headers.get_all("Content-Length", [])
        if not lengths or "Transfer-Encoding" in self.headers:
            raise RefusedRequest(HTTPStatus.LENGTH_REQUIRED, "a Content-Length is needed")
        if len(lengths) > 1 or not re.fullmatch(r"[0-9]{1,18}", lengths[0]):
            raise RefusedRequest(HTTPStatus.BAD_REQUEST, "Content-Length: one whole number is needed")
        length = int(lengths[0])
        if length > BODY_MAX_BYTES:
            raise RefusedRequest(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"{BODY_MAX_BYTES} bytes at most")
        content = self.rfile.read(length)
        self.has_unread_body = False
        try:
            request = json.loads(content) if len(content) == length else None
        except (ValueError, RecursionError):
            request = None
        if not isinstance(request, dict):
            raise RefusedRequest(HTTPStatus.BAD_REQUEST, "the body is not a JSON object of its Content-Length")
        client, number = request.pop("client", None), request.pop("number", None)
        if not isinstance(client, str) or not 0 < len(client) <= 64:
            raise RefusedRequest(HTTPStatus.BAD_REQUEST, "client: 1 to 64 characters are needed")
        if type(number) is not int or not 0 <= number < 2**53:
            raise RefusedRequest(HTTPStatus.BAD_REQUEST, "number: a whole number from 0 is needed")
        return self.server.ask(client, number, request)

    def _send_line(self, status: HTTPStatus, line: str) -> None:
        self._send(status, "application/json", json.dumps({"error": " ".join(line.split())}).encode())

    def _send(self, status: HTTPStatus, content_type: str, body: bytes, policy: str = "default-src 'none'") -> None:
        self.close_connection = True
        headers = {"Content-Type": content_type, "Content-Length": str(len(body))}
        headers |= {"Content-Security-Policy": f"{policy}; frame-ancestors 'none'"} | SECURITY_HEADERS
        if status == HTTPStatus.METHOD_NOT_ALLOWED:
            headers["Allow"] = "GET, HEAD, POST"
        if status == HTTPStatus.SERVICE_UNAVAILABLE:
            headers["Retry-After"] = "1"  # s
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Send an error of the standard library in one line; an unknown method has the status of a wrong method."""
        status = HTTPStatus.METHOD_NOT_ALLOWED if code == HTTPStatus.NOT_IMPLEMENTED else HTTPStatus(code)
        self._send_line(status, status.phrase.lower())

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing, because paths contain the token."""


Result = TypeVar("Result")

Check = Callable[..., None]
"""Function that a computation calls from time to time, with any arguments; raises if the result is obsolete."""

MAX_WAITING_CLIENTS, MAX_KNOWN_CLIENTS = 8, 256
"""Maximum number of waiting clients, and of clients whose newest number is stored. An open page is a client."""


class RequestQueue:
    """Computations of many clients, one at a time, in the order of the requests.

    A request with a greater number takes the place of the client's waiting request, and stops the running one at its
    next `check`. A request whose number is not greater is rejected, unless too many clients were waiting.
    """

    def __init__(self, waiting: int = MAX_WAITING_CLIENTS) -> None:
        self._max_waiting = waiting
        self._waiting: dict[str, int] = {}  # number of the waiting request by client, in the order of turns
        self._newest: dict[str, int] = {}  # the client that has asked last is the last
        self._running = self._closed = False
        self._changed = threading.Condition()

    def ask(self, client: str, number: int, work: Callable[[Check], Result]) -> Result:
        """Return `work(check)`, computed in this thread when it is the turn of the client's request `number`.

        **Raises:** `RefusedRequest` if the request is obsolete, too many clients are waiting, or the queue is closed.
        """

        def check(*_: object) -> None:
            if self._closed:
                raise RefusedRequest(HTTPStatus.SERVICE_UNAVAILABLE, "the server is closed")
            if self._newest.get(client, number) > number:
                raise RefusedRequest(HTTPStatus.CONFLICT, "superseded by a newer request")

        with self._changed:
            check()
            if self._newest.get(client, -1) == number:
                raise RefusedRequest(HTTPStatus.CONFLICT, "the same number as an earlier request")
            if client not in self._waiting and len(self._waiting) >= self._max_waiting:
                raise RefusedRequest(HTTPStatus.SERVICE_UNAVAILABLE, "too many requests at once; try again")
            self._newest.pop(client, None)
            self._newest[client] = number
            if len(self._newest) > MAX_KNOWN_CLIENTS:
                del self._newest[next(iter(self._newest))]
            self._waiting[client] = number  # in the place of the older request, if there is one
            self._changed.notify_all()
            self._changed.wait_for(
                lambda: (
                    self._closed
                    or self._waiting.get(client) != number
                    or (not self._running and next(iter(self._waiting)) == client)
                )
            )
            check()
            del self._waiting[client]
            self._running = True
        try:
            return work(check)
        finally:
            with self._changed:
                self._running = False
                self._changed.notify_all()

    def close(self, seconds: float = 10.0) -> None:
        """Reject all requests, and wait up to `seconds` for the running computation to end."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
            self._changed.wait_for(lambda: not self._running, seconds)


class Live(AbstractContextManager["Live"]):
    """A server of one explorer page, which runs in its own threads until closed; `url` is the page's address.

    `answer(request, check)` returns the requested motion, encoded; `warm()` compiles the programs for motions.
    """

    def __init__(self, html: str, answer: Callable[[dict[str, Any], Check], bytes], warm: Callable[[], None]) -> None:
        self.queue = RequestQueue()
        self.token = secrets.token_urlsafe(32)

        def ask(client: str, number: int, request: dict[str, Any]) -> bytes:
            return self.queue.ask(client, number, lambda check: answer(request, check))

        def compile_all() -> None:
            try:
                self.queue.ask("", 0, lambda check: warm())
            except Exception as error:  # it occurs again at a client's request
                LOG.info("not warm: %s", error)

        self._server = Server(html.encode(), self.token, ask)
        self.port = int(self._server.server_address[1])
        self.url = f"http://{HOST}:{self.port}/{self.token}/"
        self._threads = [
            threading.Thread(target=self._server.serve_forever, args=(0.1,), name="page", daemon=True),
            threading.Thread(target=compile_all, name="warm", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def __exit__(self, *_: object) -> None:
        self.close()

    def wait(self) -> None:
        while self._threads[0].is_alive():
            self._threads[0].join(0.5)

    def close(self, seconds: float = 10.0) -> None:
        """Close the port and all connections, and wait up to `seconds` for computations to end."""
        self.queue.close(seconds)
        self._server.shutdown()
        self._server.server_close()
        for thread in self._threads:
            thread.join(seconds)


def serve(ds: xr.Dataset, over: xr.Dataset | None = None, progress: bool = False) -> Live:
    """Serve the live page of a dataset until it is closed; the arguments are those of `write_page`.

    **Raises:** `InputError` if the dataset holds nothing to show or to simulate; `OSError` if no port is free.
    """
    _, document, blocks, motions = page_contents(ds, over, None, True, progress)
    assert motions is not None
    return Live(page_text(document | {"live": motions.offered()}, blocks), motions.answer, motions.warm)
