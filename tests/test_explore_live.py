"""The server of the live page: whom it refuses, in which order it answers, and that it leaves nothing behind."""

import http.client
import json
import socket
import threading
import time
from contextlib import contextmanager
from urllib.parse import quote

import pytest

from vibrojax.errors import InputError
from vibrojax.explorer import _loopback as server
from vibrojax.explorer._loopback import RefusedRequest
from vibrojax.explorer.live import Live, RequestQueue

HTML = "<!doctype html><title>page</title><script type=module>export const a = 1;</script>"


class Slow:
    """Answers with what was asked, after a while, if nobody asks for something newer."""

    def __init__(self, seconds=0.0):
        self.seconds, self.answered, self.left, self.warmed = seconds, [], 0, threading.Event()

    def warm(self):
        self.warmed.set()

    def answer(self, asked, check):
        if asked.get("parameters") == "wrong":
            raise InputError("explore: beta: is -1; it must be above 0\nsecond line")
        if asked.get("parameters") == "broken":
            raise ZeroDivisionError("secret of the inside")
        end = time.monotonic() + self.seconds
        while time.monotonic() < end:
            time.sleep(0.001)
            try:
                check()
            except RefusedRequest as refusal:
                self.left += refusal.status == 409
                raise
        self.answered.append(asked["parameters"])
        return json.dumps(asked["parameters"]).encode()


@contextmanager
def served(answers):
    """A server, and afterwards: no thread and no port is left of it."""
    before = set(threading.enumerate())
    live = Live(HTML, answers.answer, answers.warm)
    try:
        assert answers.warmed.wait(5)
        yield live
    finally:
        live.close()
    wait_until(lambda: not set(threading.enumerate()) - before)
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.1", live.port), 1).close()


@pytest.fixture(scope="module")
def live():
    with served(Slow()) as live:
        yield live


NUMBERS = iter(range(1, 10**6))


def asked(**changes):
    return json.dumps({"client": "a", "number": next(NUMBERS), "parameters": {"beta": 0.4}, **changes})


def request(live, method="POST", path="motion", body=None, token=None, **headers):
    """Status, headers and body of an answer."""
    connection = http.client.HTTPConnection("127.0.0.1", live.port, timeout=100)
    named = {"Content-Type": "application/json"} | {name.replace("_", "-"): text for name, text in headers.items()}
    try:
        where = f"/{live.token if token is None else token}/{path}"
        connection.request(method, where, body, {name: text for name, text in named.items() if text is not None})
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read()
    finally:
        connection.close()


def refusal(live, *args, **kwargs):
    """Status and line of a refusal; every answer has the headers that keep a browser from harm, and shows no inside."""
    status, headers, body = request(live, *args, **kwargs)
    assert headers["X-Content-Type-Options"] == "nosniff" and headers["Referrer-Policy"] == "no-referrer"
    assert headers["Cache-Control"] == "no-store" and "default-src 'none'" in headers["Content-Security-Policy"]
    assert "Access-Control-Allow-Origin" not in headers and "Python" not in headers["Server"]
    assert b"Traceback" not in body
    line = json.loads(body)["error"] if body else ""
    assert "\n" not in line
    return status, line


def raw(live, content, end=False):
    """All that comes back for some bytes."""
    with socket.create_connection(("127.0.0.1", live.port), 10) as one:
        one.sendall(content)
        if end:
            one.shutdown(socket.SHUT_WR)
        found = b""
        while part := one.recv(65536):
            found += part
        return found


def test_the_page_and_a_motion_are_answered(live):
    status, headers, body = request(live, "GET", "")
    assert status == 200 and body.decode() == HTML and headers["Content-Type"] == "text/html; charset=utf-8"
    assert live.url == f"http://127.0.0.1:{live.port}/{live.token}/" and len(live.token) >= 43
    status, headers, body = request(live, body=asked())
    assert (status, json.loads(body)) == (200, {"beta": 0.4})
    assert headers["Connection"] == "close"
    status, headers, body = request(live, "HEAD", "")
    assert (status, body, int(headers["Content-Length"])) == (200, b"", len(HTML))


def test_the_server_is_found_on_the_loopback_alone_and_framed_by_nobody(live):
    assert live._server.server_address[0] == "127.0.0.1"
    assert "frame-ancestors 'none'" in request(live, "GET", "")[1]["Content-Security-Policy"]
    for name in ("127.0.0.1", "localhost", "LOCALHOST"):
        own = f"{name}:{live.port}"
        assert request(live, body=asked(), Host=own, Origin=f"http://{own.lower()}")[0] == 200


HOSTS = ("evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "", "[::1]:{port}")
ORIGINS = ("http://evil.example", "null", "https://127.0.0.1:{port}", "http://127.0.0.1:1", "")
TOKENS = ("", "motion", "x" * 43, quote("é"), "../" * 9, "%00", "{token:.42}", "{token}x")
PATHS = ("nowhere", "motion/", "../../etc/passwd", "motion?x=1", "?x=1")
BODIES = ("", "{", "[]", "3", "null", '{"client": 3}', '{"client": "", "number": 1}', '{"client": "a", "number": true}')
BODIES += ('{"client": "a", "number": -1}', '{"client": "a", "number": 1e9}', '{"client": "a"}', "\xff", "[" * 9000)
REFUSED = [
    *((403, "Host", host) for host in HOSTS),  # a name that leads to the loopback (DNS rebinding) is another host
    *((403, "Origin", origin) for origin in ORIGINS),
    (403, "Sec-Fetch-Site", "cross-site"),
    (415, "Content-Type", "text/plain"),  # what forms of other pages may send
    *((403, "token", token) for token in TOKENS),
    *((404, "path", path) for path in PATHS),
    (405, "path", ""),
    *((400, "body", body) for body in BODIES),
    *((413, "body", body) for body in ("x" * 20_000, "x" * 3_000_000)),
]


@pytest.mark.parametrize(("status", "what", "given"), REFUSED, ids=lambda one: str(one)[:20])
def test_wrong_requests_are_refused(live, status, what, given):
    given = given.format(port=live.port, token=live.token) if "{" not in given[:1] else given
    named = {what: given.encode("latin-1") if what == "body" else given} if what in ("token", "path", "body") else {}
    headers = {} if named else {what.replace("-", "_"): given}
    found, line = refusal(live, **{"body": asked()} | named, **headers)
    assert found == status and line and live.token not in line
    if what in ("Host", "token", "path") and given:
        assert refusal(live, "GET", **{"path": ""} | named, **headers)[0] == status


def test_wrong_methods_are_refused(live):
    for method in ("PUT", "DELETE", "PATCH", "TRACE", "OPTIONS", "FOO"):
        status, headers, _ = request(live, method, "motion")
        assert status == 405 and headers["Allow"] == "GET, HEAD, POST"
    assert refusal(live, "GET", "motion")[0] == 405
    assert refusal(live, "OPTIONS", body=None, Origin="http://evil.example")[0] in (403, 405)


OWN = "Host: 127.0.0.1:{port}\r\nContent-Type: application/json\r\n"
POST = "POST /{token}/motion HTTP/1.1\r\n" + OWN
RAW = [
    ("GET /{token}/ HTTP/1.1\r\n\r\n", 403),
    ("GET /{token}/ HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nHost: evil\r\n\r\n", 403),
    (POST + "Content-Length: 999999999999999999\r\n\r\n", 413),
    ("GET /" + "x" * 70_000 + " HTTP/1.1\r\n\r\n", 414),
    ("GET / HTTP/1.1\r\n" + "".join(f"X-{k}: y\r\n" for k in range(200)) + "\r\n", 431),
    (POST + "\r\n", 411),
    (POST + "Transfer-Encoding: chunked\r\n\r\n2\r\n{{}}\r\n0\r\n\r\n", 411),
    *((POST + f"Content-Length: {length}\r\n\r\n", 400) for length in ("-1", "+1", "1_0", "x", "")),
    (POST + "Content-Length: 1\r\nContent-Length: 2\r\n\r\n", 400),
    (POST + "Content-Length: 9\r\n\r\n{{}}", 400),
    *((begin + "\r\n\r\n", None) for begin in ("\x16\x03\x01\x02\x00\x01", "GET", "GET / HTTP/9.9", "GET / HTTP/x")),
]


@pytest.mark.parametrize(("content", "status"), RAW, ids=lambda one: str(one)[-20:])
def test_malformed_requests_are_refused(live, content, status):
    answer = raw(live, content.format(port=live.port, token=live.token).encode("latin-1"), end=True)
    assert b"200 OK" not in answer
    assert status is None or answer.startswith(f"HTTP/1.1 {status}".encode())


def test_who_keeps_silent_is_let_go(live, monkeypatch):
    monkeypatch.setattr(server._Handler, "timeout", 0.1)
    begin = POST.format(port=live.port, token=live.token) + "Content-Length: 9\r\n\r\n{"
    assert raw(live, begin.encode()).startswith(b"HTTP/1.1 408")
    assert raw(live, b"GET / HT") == b""


@pytest.mark.parametrize(
    ("limit", "begin"),
    [("HEADER_MAX_SECONDS", "GET /"), ("REQUEST_MAX_SECONDS", POST + "Content-Length: 9999\r\n\r\n")],
)
def test_who_comes_byte_by_byte_is_let_go(live, monkeypatch, limit, begin):
    """Before the token is shown after one time, after it after another."""
    monkeypatch.setattr(server, limit, 0.3)
    with socket.create_connection(("127.0.0.1", live.port), 10) as one, pytest.raises(OSError):
        one.sendall(begin.format(token=live.token, port=live.port).encode())
        for _ in range(200):
            one.sendall(b"x")
            time.sleep(0.02)


def test_a_new_connection_takes_the_place_of_one_without_the_token(live, monkeypatch):
    monkeypatch.setattr(server, "CONNECTIONS_MAX", 3)
    silent = [socket.create_connection(("127.0.0.1", live.port)) for _ in range(4)]
    silent[0].settimeout(2.0)
    assert silent[0].recv(1) == b""  # long before its own limit
    assert request(live, "GET", path="")[0] == 200
    for one in silent:
        one.close()


def test_the_page_is_answered_beside_many_slow_connections(live):
    """Connections without a token, each of which sends a byte now and then, keep nobody out."""
    slow, end = [], threading.Event()

    def trickle():
        while not end.wait(0.1):
            for one in list(slow):
                try:
                    one.send(b"x")
                except OSError:  # hung up on
                    slow.remove(one)

    trickling = threading.Thread(target=trickle)
    trickling.start()
    try:
        for _ in range(60):
            slow.append(socket.create_connection(("127.0.0.1", live.port), 10))
        assert request(live, "GET", "")[0] == 200  # within the 10 s of the request's timeout
        assert request(live, body=asked())[0] == 200
    finally:
        end.set()
        trickling.join()
        for one in slow:
            one.close()


def test_wrong_values_are_said_in_one_line_and_faults_are_not_shown(live):
    line = "explore: beta: is -1; it must be above 0 second line"
    assert refusal(live, body=asked(parameters="wrong")) == (400, line)
    status, line = refusal(live, body=asked(parameters="broken"))
    assert status == 500 and "secret" not in line and "ZeroDivision" not in line
    assert request(live, body=asked())[0] == 200


def wait_until(condition):
    end = time.monotonic() + 100
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_thousand_quick_clicks_are_answered_or_refused_in_order():
    """Six at a time, as browsers do: who was overtaken is told so, the last is answered, nothing is out of order."""
    answers = Slow(0.01)
    with served(answers) as live:
        next_number, lock, found = iter(range(1000)), threading.Lock(), {}

        def click():
            while True:
                with lock:
                    number = next(next_number, None)
                if number is None:
                    return
                body = asked(number=number, parameters=number)
                found[number] = request(live, body=body)[0]

        clickers = [threading.Thread(target=click) for _ in range(6)]
        for one in clickers:
            one.start()
        for one in clickers:
            one.join()
        assert len(found) == 1000 and set(found.values()) == {200, 409}
        assert found[999] == 200
        assert answers.answered == sorted(answers.answered)
        assert set(answers.answered) >= {number for number, status in found.items() if status == 200}
        assert answers.left > 0 and len(live.queue._newest) <= 2 and not live.queue._waiting
    assert request_fails(live)


def request_fails(live):
    try:
        request(live, body=asked())
    except OSError:
        return True
    return False


def test_clients_wait_for_one_another_and_too_many_are_sent_away():
    answers = Slow(0.3)
    with served(answers) as live:
        found = []

        def ask(client):
            found.append(request(live, body=asked(client=client, number=1, parameters=client)))

        threads = [threading.Thread(target=ask, args=(str(k),)) for k in range(12)]
        for one in threads:
            one.start()
            time.sleep(0.01)
        for one in threads:
            one.join()
    statuses = [status for status, *_ in found]
    assert statuses.count(503) == 3 and statuses.count(200) == 9  # one at work, eight that wait
    assert {headers["Retry-After"] for status, headers, _ in found if status == 503} == {"1"}
    assert answers.answered == [str(k) for k in range(9)]


def test_closing_lets_everybody_go():
    """Also while a motion is being computed, one waits, and a connection says nothing."""
    answers = Slow(30.0)
    found = []
    with served(answers) as live:
        idle = socket.create_connection(("127.0.0.1", live.port), 10)
        ask = [threading.Thread(target=lambda k=k: found.append(attempt(live, str(k)))) for k in range(2)]
        for one in ask:
            one.start()
        time.sleep(0.2)
        began = time.monotonic()
        live.close()
        assert time.monotonic() - began < 25  # a motion takes 30
        for one in ask:
            one.join()
        idle.close()
    assert len(found) == 2 and set(found) <= {503, "broken"}


def attempt(live, client):
    try:
        return request(live, body=asked(client=client))[0]
    except (OSError, http.client.HTTPException):
        return "broken"


def test_turns_keep_their_order():
    queue, done = RequestQueue(waiting=1), []
    begun, go = threading.Event(), threading.Event()

    def long(check):
        begun.set()
        go.wait(5)
        done.append("long")

    threads = [threading.Thread(target=lambda: queue.ask("a", 5, long))]
    threads[0].start()
    assert begun.wait(5)
    with pytest.raises(RefusedRequest, match="earlier"):
        queue.ask("a", 5, long)
    threads.append(threading.Thread(target=lambda: queue.ask("b", 1, lambda check: done.append("b"))))
    threads[1].start()
    while not queue._waiting:
        time.sleep(0.001)
    with pytest.raises(RefusedRequest, match="too many"):
        queue.ask("c", 1, long)
    go.set()
    for one in threads:
        one.join()
    assert queue.ask("c", 1, lambda check: "c") == "c"  # the same number again: it was sent away, not answered
    assert done == ["long", "b"]
    queue.close()
    with pytest.raises(RefusedRequest, match="closed"):
        queue.ask("a", 9, long)
