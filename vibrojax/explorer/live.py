"""The explorer page from a server on this machine that computes motions on demand: `vibrojax explore OUT.nc --live`.

The server handles two requests. Their paths begin with a token. Only the printed address contains the token.

    GET  /TOKEN/          the page
    POST /TOKEN/motion    JSON {"client": string, "number": integer} with {"parameters": {name: value}, "start": name
                          or vector} or {"lane": integer}: one motion, encoded as in [vibrojax.explorer.encoding][]

A request makes all requests of the same client (an open page) with smaller numbers obsolete. A rejected request gets
{"error": line} and a status: 409 if it is obsolete, 503 with Retry-After if there are too many requests, or another
HTTP status.
"""

import secrets
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from http import HTTPStatus
from typing import Any, TypeVar

import xarray as xr

from vibrojax.explorer._loopback import HOST, RefusedRequest, Server
from vibrojax.explorer.write import page_contents, page_text
from vibrojax.progress import LOG

Result = TypeVar("Result")

Check = Callable[..., None]
"""Function that a computation calls from time to time, with any arguments; raises if the result is obsolete."""

MAX_WAITING_CLIENTS, MAX_KNOWN_CLIENTS = 8, 256
"""Maximum number of waiting clients, and of clients whose newest number is stored. An open page is a client."""


class RequestQueue:
    """Computations of many clients, one at a time, in the order of the requests.

    A request with a greater number ends the client's earlier request. If the earlier request is waiting, the newer one
    takes its place in the queue; if it is running, it stops at its next `check`. A request whose number is not greater
    is rejected. If too many clients are waiting, a client may send the same number again.
    """

    def __init__(self, waiting: int = MAX_WAITING_CLIENTS) -> None:
        self._max_waiting = waiting
        self._waiting: dict[str, int] = {}  # number of the waiting request by client, in the order of turns
        self._newest: dict[str, int] = {}  # the client that has asked last is the last
        self._running = self._closed = False
        self._changed = threading.Condition()

    def ask(self, client: str, number: int, work: Callable[[Check], Result]) -> Result:
        """Return `work(check)`, computed in this thread when it is the client's turn.

        **Arguments:** `client`: name of the client; `number`: request number, greater with each request of the client.

        **Raises:** any error of `work`; `RefusedRequest` if the request is obsolete, too many clients are waiting, or
        the queue is closed.
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

    **Arguments:** `answer(request, check)` returns the requested motion, encoded; it raises `InputError`, or the error
    that `check()` raises. `warm()` compiles the programs that simulate motions.

    **Raises:** `OSError` if no port is free.
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
    """Serve the live page of a dataset until it is closed.

    **Arguments:** `ds`, `over`, `progress`: as for `write_page`.

    **Raises:** `InputError` if the dataset holds nothing to show or to simulate; `OSError` if no port is free.
    """
    _, document, blocks, motions = page_contents(ds, over, None, True, progress)
    assert motions is not None
    return Live(page_text(document | {"live": motions.offered()}, blocks), motions.answer, motions.warm)
