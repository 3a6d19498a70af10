"""The page from a server on this machine, which computes what is clicked or dragged: `vibrojax explore OUT.nc --live`.

It answers two things, under a path that begins with a token that only its address tells:

    GET  /TOKEN/          the page
    POST /TOKEN/motion    JSON {"client": text, "number": whole} with {"parameters": {name: value}, "start": name or
                          vector} or {"lane": whole}: that motion as a block of one cell (see
                          [vibrojax.explorer.cells][])

Of a client (a page that is open), a greater number makes smaller ones obsolete. What is refused is said in one line,
{"error": line}: 400 (wrong values or no such request), 403 (no token, another host or origin), 404, 405, 408, 409
(superseded), 411, 413, 415, 431, 500, 503 with Retry-After.

Who may ask, [vibrojax.explorer._loopback][] decides.
"""

import secrets
import threading
from types import TracebackType
from typing import Any, Protocol, runtime_checkable

import xarray as xr

from vibrojax.explorer._loopback import HOST, Served, Server
from vibrojax.explorer._turns import Check, Turns
from vibrojax.explorer.at_point import motions_around, motions_of
from vibrojax.explorer.of_dataset import _sweep, cells_of, document_of, explored
from vibrojax.explorer.write import SIZE, blocks_of, page_text
from vibrojax.progress import LOG


@runtime_checkable
class Answers(Protocol):
    """What computes: see [vibrojax.explorer.at_point.Motions][]."""

    def answer(self, asked: dict[str, Any], check: Check) -> bytes:
        """The block for a request; raises `InputError`, or what `check()` raises."""

    def warm(self) -> None:
        """Compile what answers need."""


class Live:
    """A server of one page, in threads of its own until it is closed; `url` is where the page is.

    **Raises:** `OSError` where this machine gives no port.
    """

    def __init__(self, html: str, answers: Answers) -> None:
        self.answers = answers
        self.token = secrets.token_urlsafe(32)
        self._server = Server(Served(html.encode(), self.token, self._ask))
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

    def _ask(self, client: str, number: int, asked: dict[str, Any]) -> bytes:
        return self.turns.ask(client, number, lambda check: self.answers.answer(asked, check))

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
    sweep, _ = _sweep(ds, None)
    motions = motions_of(sweep) if sweep is not None else motions_around(ds)
    blocks = [] if sweep is not None else blocks_of(cells_of(ds, progress))
    if blocks:
        document["cells"] = {"size": SIZE, "blocks": len(blocks)}
    return Live(page_text(document | {"live": motions.offered()}, blocks), motions)
