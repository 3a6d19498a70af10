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
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import AbstractContextManager
from http import HTTPStatus
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

import xarray as xr

from vibrojax.explorer._loopback import HOST, RefusedRequest, Server
from vibrojax.explorer.write import page_contents, page_text
from vibrojax.progress import LOG

Result = TypeVar("Result")

Check = Callable[..., None]
"""Function that a computation calls from time to time, with any arguments; raises if the result is obsolete."""

MAX_WAITING_CLIENTS, MAX_KNOWN_CLIENTS = 8, 256
"""Maximum number of waiting clients, and of clients whose newest number is stored. An open page is a client."""


class Superseded(RefusedRequest):
    """The same client has sent a newer request."""

    def __init__(self) -> None:
        super().__init__(HTTPStatus.CONFLICT, "superseded by a newer request")


class Busy(RefusedRequest):
    """Too many clients are waiting."""

    def __init__(self) -> None:
        super().__init__(HTTPStatus.SERVICE_UNAVAILABLE, "too many requests at once; try again")


class Closed(Busy):
    """The queue is closed."""


class _Request(NamedTuple):
    """A client's computation and its future result; a rejection replaces the result before the computation ends."""

    client: str
    work: Callable[[Check], Any]
    future: Future[Any]

    def check(self, *_: object) -> None:
        """Raise the error with which the request was rejected, if it was."""
        if self.future.done():
            self.future.result()

    def refuse(self, error: RefusedRequest) -> None:
        """Reject the request with an error, unless it has ended."""
        if not self.future.done():
            self.future.set_exception(error)


class RequestQueue:
    """A thread that runs the computations of many clients in the order of their requests.

    A request with a greater number ends the client's earlier request. If the earlier request is waiting, the newer one
    takes its place in the queue; if it is running, it stops at its next `check`. A request whose number is not greater
    is rejected. After `Busy`, a client may send the same number again.
    """

    def __init__(self, waiting: int = MAX_WAITING_CLIENTS) -> None:
        self._max_waiting = waiting
        self._waiting: OrderedDict[str, _Request] = OrderedDict()
        self._newest: OrderedDict[str, int] = OrderedDict()
        self._current: _Request | None = None
        self._closed = False
        self._changed = threading.Condition()  # its lock guards the attributes above and all futures
        self._thread = threading.Thread(target=self._run, name="requests", daemon=True)
        self._thread.start()

    def ask(self, client: str, number: int, work: Callable[[Check], Result]) -> Result:
        """Run `work(check)` in the thread, and return its result.

        **Arguments:** `client`: name of the client; `number`: request number, greater with each request of the client.

        **Raises:** any error of `work`, `Superseded`, `Busy` or `Closed`.
        """
        request = _Request(client, work, Future())
        with self._changed:
            if self._closed:
                raise Closed
            if number <= self._newest.get(client, -1):
                raise Superseded
            if client not in self._waiting and len(self._waiting) >= self._max_waiting:
                raise Busy
            self._newest[client] = number
            self._newest.move_to_end(client)
            while len(self._newest) > MAX_KNOWN_CLIENTS:
                self._newest.popitem(last=False)
            for older in (self._current, self._waiting.get(client)):
                if older is not None and older.client == client:
                    older.refuse(Superseded())
            self._waiting[client] = request  # in the place of the older request, if there is one
            self._changed.notify()
        result: Result = request.future.result()
        return result

    def _run(self) -> None:
        while True:
            with self._changed:
                self._current = None
                self._changed.wait_for(lambda: self._waiting or self._closed)
                if self._closed:
                    return
                _, request = self._waiting.popitem(last=False)
                self._current = request
            result, error = None, None
            try:
                result = request.work(request.check)
            except BaseException as raised:  # raised again in the thread that waits for the result
                error = raised
            with self._changed:
                if request.future.done():
                    continue
                if error is not None:
                    request.future.set_exception(error)
                else:
                    request.future.set_result(result)

    def close(self, seconds: float = 10.0) -> None:
        """Reject all requests with `Closed`, and wait up to `seconds` for the thread to end."""
        with self._changed:
            self._closed = True
            for request in [*self._waiting.values(), *([self._current] if self._current else [])]:
                request.refuse(Closed())
            self._waiting.clear()
            self._changed.notify_all()
        self._thread.join(seconds)


@runtime_checkable
class Answers(Protocol):
    """An object that computes motions, such as [vibrojax.explorer.motions.LiveMotions][]."""

    def answer(self, request: dict[str, Any], check: Check) -> bytes:
        """Return the requested motion, encoded; raise `InputError`, or the error that `check()` raises."""

    def warm(self) -> None:
        """Compile the programs that simulate motions."""


class Live(AbstractContextManager["Live"]):
    """A server of one explorer page, which runs in its own threads until closed; `url` is the page's address.

    **Raises:** `OSError` if no port is free.
    """

    def __init__(self, html: str, answers: Answers) -> None:
        self.answers = answers
        self.token = secrets.token_urlsafe(32)

        def ask(client: str, number: int, request: dict[str, Any]) -> bytes:
            return self.queue.ask(client, number, lambda check: answers.answer(request, check))

        self._server = Server(html.encode(), self.token, ask)
        self.queue = RequestQueue()
        self.port = int(self._server.server_address[1])
        self.url = f"http://{HOST}:{self.port}/{self.token}/"
        self._threads = [
            threading.Thread(target=self._server.serve_forever, args=(0.1,), name="page", daemon=True),
            threading.Thread(target=self._warm, name="warm", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def __exit__(self, *_: object) -> None:
        self.close()

    def wait(self) -> None:
        """Wait until the server is closed, or this thread is interrupted."""
        while self._threads[0].is_alive():
            self._threads[0].join(0.5)

    def close(self, seconds: float = 10.0) -> None:
        """Close the port, and wait up to `seconds` for each thread to end."""
        self.queue.close(seconds)
        self._server.shutdown()
        self._server.server_close()
        for thread in self._threads:
            thread.join(seconds)

    def _warm(self) -> None:
        """Compile all programs before the first request; an error here occurs again at a client's request."""
        try:
            self.queue.ask("", 0, lambda check: self.answers.warm())
        except Exception as error:
            LOG.info("not warm: %s", error)


def serve(ds: xr.Dataset, over: xr.Dataset | None = None, progress: bool = False) -> Live:
    """Serve the live page of a dataset until it is closed.

    **Arguments:** `ds`, `over`, `progress`: as for `write_page`.

    **Raises:** `InputError` if the dataset holds nothing to show or to simulate; `OSError` if no port is free.
    """
    _, document, blocks, motions = page_contents(ds, over, None, True, progress)
    assert motions is not None
    return Live(page_text(document | {"live": motions.offered()}, blocks), motions)
