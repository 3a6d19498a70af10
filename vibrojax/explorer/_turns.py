"""Who is computed for next: one thread does it all, and of each client only what it asked last."""

import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, TypeVar

Result = TypeVar("Result")

Check = Callable[..., None]
"""Called by work now and then, with anything; raises where nobody waits for its result any more."""

WAITING = 8
"""Clients that may wait at once."""

CLIENTS = 256
"""Clients whose newest number is remembered."""


class Superseded(Exception):
    """The same client has asked for something newer."""


class Busy(Exception):
    """Too many clients wait."""


class Closed(Exception):
    """Nothing is computed any more."""


class _Turn:
    """One piece of work, and what becomes of it."""

    def __init__(self, client: str, work: Callable[[Check], Any]) -> None:
        self.client, self.work = client, work
        self.over = threading.Event()
        self.result: Any = None
        self.error: BaseException | None = None

    def end(self, result: Any = None, error: BaseException | None = None) -> None:
        """Let go who waits for it; the first end counts. Called by one thread at a time."""
        if not self.over.is_set():
            self.result, self.error = result, error
            self.over.set()

    def check(self, *_: object) -> None:
        """Raise where it is over already: nobody waits for the rest of the work."""
        if self.over.is_set():
            assert self.error is not None
            raise self.error


class Turns:
    """One thread that works for many, in the order in which they came.

    Of a client, a newer number ends what it asked before: what waits gives its place to the newer, what is being worked
    on is left at its next `check`, and a number that comes after a newer one is refused. Who finds no place may come
    again with the same number.
    """

    def __init__(self, waiting: int = WAITING) -> None:
        self._most = waiting
        self._waiting: OrderedDict[str, _Turn] = OrderedDict()
        self._newest: OrderedDict[str, int] = OrderedDict()
        self._current: _Turn | None = None
        self._closed = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._work, name="turns", daemon=True)
        self._thread.start()

    def ask(self, client: str, number: int, work: Callable[[Check], Result]) -> Result:
        """Have `work` done, and wait for it.

        **Arguments:** `client`: who asks; `number`: greater with each question of a client; `work(check)`: called in
        the thread.

        **Returns:** what `work` returned.

        **Raises:** what `work` raised, `Superseded`, `Busy` or `Closed`.
        """
        turn = _Turn(client, work)
        with self._changed:
            self._enter(turn, number)
            self._changed.notify()
        turn.over.wait()
        if turn.error is not None:
            raise turn.error
        result: Result = turn.result
        return result

    def _enter(self, turn: _Turn, number: int) -> None:
        client = turn.client
        if self._closed:
            raise Closed
        if number <= self._newest.get(client, -1):
            raise Superseded
        if client not in self._waiting and len(self._waiting) >= self._most:
            raise Busy
        self._newest[client] = number
        self._newest.move_to_end(client)
        while len(self._newest) > CLIENTS:
            self._newest.popitem(last=False)
        if self._current is not None and self._current.client == client:
            self._current.end(error=Superseded())
        if client in self._waiting:
            self._waiting[client].end(error=Superseded())
        self._waiting[client] = turn  # in the place of the older one, if there was one

    def _work(self) -> None:
        while True:
            with self._changed:
                self._current = None
                self._changed.wait_for(lambda: self._waiting or self._closed)
                if self._closed:
                    return
                _, turn = self._waiting.popitem(last=False)
                self._current = turn
            result, error = None, None
            try:
                result = turn.work(turn.check)
            except BaseException as raised:  # whatever it is, it is raised where it is waited for
                error = raised
            with self._changed:
                turn.end(result, error)

    def close(self, seconds: float = 10.0) -> None:
        """Let go who waits, and wait so long [s] for the thread to end."""
        with self._changed:
            self._closed = True
            turns = [*self._waiting.values(), *([self._current] if self._current else [])]
            self._waiting.clear()
            for turn in turns:
                turn.end(error=Closed())
            self._changed.notify_all()
        self._thread.join(seconds)
