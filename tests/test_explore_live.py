"""Tests of the live server, which requests it refuses and what it leaves behind, and of the motions in its answers."""

import http.client
import json
import socket
import threading
import time
from contextlib import closing, contextmanager
from itertools import count
from urllib.parse import quote

import numpy as np
import pytest
from cell_blocks import decode

import vibrojax as vj
from vibrojax.compile.native import kernels
from vibrojax.explorer import encoding
from vibrojax.explorer.document import run_document
from vibrojax.explorer.live import Live
from vibrojax.explorer.motions import LiveMotions, motions_of

HTML = "<!doctype html><title>page</title><script type=module>export const a = 1;</script>"


class SlowAnswers:
    """A source of answers that repeats the parameters after a delay, unless the server stops."""

    def __init__(self, seconds=0.0):
        self.seconds, self.warmed = seconds, threading.Event()

    def warm(self):
        self.warmed.set()

    def answer(self, message, check):
        if message.get("parameters") == "wrong":
            raise vj.InputError("explore: beta: is -1; it must be above 0\nsecond line")
        if message.get("parameters") == "broken":
            raise ZeroDivisionError("secret of the inside")
        end = time.monotonic() + self.seconds
        while time.monotonic() < end:
            time.sleep(0.001)
            check()
        return json.dumps(message["parameters"]).encode()


@contextmanager
def running_server(answers):
    """Run a server, then check that its port is closed."""
    with closing(Live(HTML, answers.answer, answers.warm)) as live:
        assert answers.warmed.wait(5)
        yield live
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.1", live.port), 1).close()


@pytest.fixture(scope="module")
def live():
    with running_server(SlowAnswers()) as live:
        yield live


NUMBERS = count(1)


def request_body(**changes):
    return json.dumps({"client": "a", "number": next(NUMBERS), "parameters": {"beta": 0.4}, **changes})


def request(live, method="POST", path="motion", body=None, token=None, **headers):
    """Return status, headers and body of an answer."""
    all_headers = {"Content-Type": "application/json"} | {n.replace("_", "-"): text for n, text in headers.items()}
    with closing(http.client.HTTPConnection("127.0.0.1", live.port, timeout=100)) as connection:
        connection.request(method, f"/{live.token if token is None else token}/{path}", body, all_headers)
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read()


def refusal(live, *args, **kwargs):
    """Return status and line of a refusal; check that its headers protect the browser and that no internals show."""
    status, headers, body = request(live, *args, **kwargs)
    assert headers["X-Content-Type-Options"] == "nosniff" and headers["Referrer-Policy"] == "no-referrer"
    assert headers["Cache-Control"] == "no-store" and "default-src 'none'" in headers["Content-Security-Policy"]
    assert "Access-Control-Allow-Origin" not in headers and "Python" not in headers["Server"]
    assert b"Traceback" not in body
    line = json.loads(body)["error"] if body else ""
    assert "\n" not in line
    return status, line


def test_page_and_motion_are_answered_on_loopback_only(live):
    assert live._server.server_address[0] == "127.0.0.1"
    status, headers, body = request(live, "GET", "")
    assert status == 200 and body.decode() == HTML and headers["Content-Type"] == "text/html; charset=utf-8"
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    assert live.url == f"http://127.0.0.1:{live.port}/{live.token}/" and len(live.token) >= 43
    status, headers, body = request(live, body=request_body())
    assert (status, json.loads(body)) == (200, {"beta": 0.4})
    assert headers["Connection"] == "close"
    status, headers, body = request(live, "HEAD", "")
    assert (status, body, int(headers["Content-Length"])) == (200, b"", len(HTML))
    for own in (f"{name}:{live.port}" for name in ("127.0.0.1", "LOCALHOST")):
        assert request(live, body=request_body(), Host=own, Origin=f"http://{own.lower()}")[0] == 200


REFUSED = {
    ("Host", 403): ("evil.example:{port}", "127.0.0.1:1", ""),  # DNS rebinding: another name is another host
    ("Origin", 403): ("http://evil.example", "null", "https://127.0.0.1:{port}", ""),
    ("Sec-Fetch-Site", 403): ("cross-site",),
    ("Content-Type", 415): ("text/plain",),  # forms of other pages may send this type
    ("token", 403): ("", "x" * 43, quote("é"), "../" * 9, "{token:.42}", "{token}x"),
    ("path", 404): ("nowhere", "motion/", "../../etc/passwd", "motion?x=1"),
    ("path", 405): ("",),
    ("body", 400): ("[]", '{"client": "", "number": 1}', '{"client": "a", "number": true}', "\xff", "[" * 9000),
    ("body", 413): ("x" * 20_000,),
}


@pytest.mark.parametrize(("what", "status"), REFUSED)
def test_wrong_requests_are_refused(live, what, status):
    for given in REFUSED[what, status]:
        if what != "body":
            given = given.format(port=live.port, token=live.token)
        named = {what: given.encode("latin-1") if what == "body" else given}
        headers = {}
        if what not in ("token", "path", "body"):
            named, headers = {}, {what.replace("-", "_"): given}
        code, line = refusal(live, **{"body": request_body()} | named, **headers)
        assert code == status and line and live.token not in line, given
        if what in ("Host", "token", "path") and given:
            assert refusal(live, "GET", **{"path": ""} | named, **headers)[0] == status, given


def test_wrong_methods_and_malformed_requests_are_refused(live):
    for method in ("PUT", "TRACE", "FOO"):
        status, headers, _ = request(live, method, "motion")
        assert status == 405 and headers["Allow"] == "GET, HEAD, POST"
    assert refusal(live, "GET", "motion")[0] == 405
    assert refusal(live, "OPTIONS", body=None, Origin="http://evil.example")[0] in (403, 405)
    for content, status in RAW:
        with socket.create_connection(("127.0.0.1", live.port), 10) as connection, connection.makefile("rb") as answers:
            connection.sendall(content.format(port=live.port, token=live.token).encode("latin-1"))
            connection.shutdown(socket.SHUT_WR)
            answer = answers.read()
        assert b"200 OK" not in answer
        assert status is None or answer.startswith(f"HTTP/1.1 {status}".encode()), content


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
    *((POST + f"Content-Length: {length}\r\n\r\n", 400) for length in ("-1", "1_0", "")),
    (POST + "Content-Length: 1\r\nContent-Length: 2\r\n\r\n", 400),
    (POST + "Content-Length: 9\r\n\r\n{{}}", 400),
    *((begin + "\r\n\r\n", None) for begin in ("\x16\x03\x01\x02\x00\x01", "GET", "GET / HTTP/9.9")),
]


def test_wrong_values_give_one_line_and_faults_stay_hidden(live):
    line = "explore: beta: is -1; it must be above 0 second line"
    assert refusal(live, body=request_body(parameters="wrong")) == (400, line)
    status, line = refusal(live, body=request_body(parameters="broken"))
    assert status == 500 and "secret" not in line and "ZeroDivision" not in line
    assert request(live, body=request_body())[0] == 200


def test_closing_releases_all_clients():
    """One motion is being computed, another request waits, and a third connection is silent. No thread is left."""
    answers, outcomes, before = SlowAnswers(30.0), [], set(threading.enumerate())

    def attempt(client):
        try:
            outcomes.append(request(live, body=request_body(client=client))[0])
        except (OSError, http.client.HTTPException):
            outcomes.append("broken")

    with running_server(answers) as live, socket.create_connection(("127.0.0.1", live.port), 10):
        threads = [threading.Thread(target=attempt, args=(name,)) for name in "ab"]
        for thread in threads:
            thread.start()
        time.sleep(0.2)
        began = time.monotonic()
        live.close()
        assert time.monotonic() - began < 25  # a motion takes 30
        for thread in threads:
            thread.join()
    assert len(outcomes) == 2 and set(outcomes) <= {503, "broken"}
    for thread in set(threading.enumerate()) - before:
        thread.join(100)
        assert not thread.is_alive()


SWEEP = {
    "scene": "vibro-impact",
    "starts": ["drive", [0.0, 0.0, 0.01, 0.0]],
    "parameters": {"v": 1.2},
    "grid": {"beta": [0.3, 0.4], "gamma": [0.65, 0.75, 0.8]},
    "run": {"settle": 8.0, "observe": 6.0},
}


@pytest.fixture(scope="module")
def motions():
    return motions_of(vj.read_sweep(SWEEP))


no_newer_request = lambda *_: None


def single(motions, **message):
    """Return the cell of an answer."""
    [cell] = decode(motions.answer(message, no_newer_request))
    return cell


@pytest.mark.parametrize("start", [None, [0.0, 0.5, 0.01, -1.0]])
def test_motion_has_numbers_of_simulate(motions, start):
    changed = {"beta": 0.37, "delta": 0.002}
    cell = single(motions, parameters=changed, start=start)
    values = {"v": 1.2, "gamma": 0.65} | changed
    motion = vj.simulate("vibro-impact", **values, start=start or "drive", duration=14.0, progress=False)
    assert {"regime", "period", "impact_velocity", "stick_fraction"} <= set(cell.numbers)
    for name, value in cell.numbers.items():
        np.testing.assert_equal(np.nan if value is None else value, motion[name].item(), err_msg=name)
    assert set(cell.numbers) == {name for name, data in motion.data_vars.items() if data.ndim == 0}


def test_cell_lies_on_trajectory(motions):
    """At the cell's times, the trajectory of `simulate` agrees to a level of the cell's columns."""
    cell = single(motions, parameters={"beta": 0.4, "gamma": 0.75, "v": 1.5})
    motion = vj.simulate("vibro-impact", duration=14.0, sampling=1e-4, progress=False)
    sections = motion["event_time"].values[motion["event_kind"].values == 5]
    assert cell.kind == "orbit" and cell.duration == pytest.approx(sections[-1] - sections[-1 - cell.returns], rel=1e-6)
    for name in ("x1", "v1", "x2", "v2"):
        expected = np.interp(sections[-1 - cell.returns] + cell.time, motion["time"], motion[name])
        rate = np.abs(np.gradient(motion[name], motion["time"])).max()
        # States and times are both rounded to their levels.
        tolerance = 0.6 * np.ptp(expected) / encoding.STATE_LEVELS + 0.6 * rate * cell.duration / encoding.TIME_LEVELS
        np.testing.assert_allclose(cell.states[name], expected, atol=tolerance)


@pytest.mark.parametrize(
    ("fixed", "grid"),
    [({"bit_frequency": 4.5}, {"m1": [200.0, 300.0]}), ({"threshold": 15e3}, {"bit_radius": [0.04, 0.05]})],
)
def test_sliders_stand_at_machine_of_lane(fixed, grid):
    """Coordinates that replace parameters, and the radius of the hole, count beside a lane and in its command."""
    scene = "drilling" if "threshold" in fixed else "vibro-impact"
    table = {"scene": scene, "parameters": fixed, "grid": grid, "starts": ["drive"], "run": {"settle": 20.0}}
    sweep = vj.read_sweep(table | {"unusual": True})
    data = vj.run_sweep(sweep, progress=False)
    point = single(motions_of(sweep), lane=1).point
    numbers = single(motions_of(sweep), parameters=point["parameters"], start=point["start"]).numbers
    lane = data.isel(start=0, **dict.fromkeys(grid, 1))
    compared = ["period", "impact_energy", *(["specific_energy"] if scene == "drilling" else [])]
    for name in compared:
        assert numbers[name] == pytest.approx(float(lane[name]), rel=1e-4), name
    given = run_document(data, sweep)["parameters"]
    command = vj.simulate(scene, **given | {name: x[1] for name, x in grid.items()}, duration=28.0, progress=False)
    for name in compared:
        assert float(command[name]) == pytest.approx(float(lane[name]), rel=1e-4), name


@pytest.mark.parametrize("scene", ["penetration", "coupled-drilling"])
def test_every_scene_answers(scene):
    motions = LiveMotions(scene, {}, None, 2.0 if scene == "penetration" else 12.0)
    cell = single(motions, parameters={})
    assert cell.kind != "none" and len(cell.time) > 50 and cell.numbers
    offered = motions.offered()
    assert {entry["name"] for entry in offered["parameters"]} == set(motions.point.parameters)
    of_hole = {"bit_radius"} if scene == "coupled-drilling" else set()
    assert set(offered["values"]) - set(motions.point.parameters) == of_hole
    for slider in offered["parameters"]:
        assert slider["low"] <= offered["values"][slider["name"]] <= slider["high"]
        assert motions.names.parameters[slider["name"]].problem(slider["low"]) is None
    assert json.loads(json.dumps(offered, allow_nan=False)) == offered


def test_superseded_motion_is_interrupted(motions):
    calls = []

    def check(*_):
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        motions.answer({"parameters": {"k0": 300e6}}, check)
    assert len(calls) == 2


def test_values_compile_nothing():
    """Only the first motion compiles."""
    motions = LiveMotions("vibro-impact", {})
    assert motions.duration == 48.0
    motions.warm()
    before, random = len(kernels), np.random.default_rng(0)
    for start in ("drive", "stuck"):
        beta, delta, k0 = random.uniform(0.3, 0.5), random.uniform(-0.01, 0.01), random.uniform(10e6, 100e6)
        motions.answer({"parameters": {"beta": beta, "delta": delta, "k0": k0}, "start": start}, no_newer_request)
    assert len(kernels) == before


def test_box_is_the_sweep_of_its_cells(motions):
    """The part that a user zooms into has the labels and numbers of a sweep over the same values."""
    box = {"beta": [0.31, 0.39], "gamma": [0.66, 0.78]}
    answer = json.loads(motions.answer({"box": box, "lane": 1}, no_newer_request))
    grid = {"beta": [0.31, 0.39], "gamma": np.linspace(0.66, 0.78, 3).tolist()}
    expected = vj.run_sweep({**SWEEP, "grid": grid, "starts": [[0.0, 0.0, 0.01, 0.0]]}, progress=False)
    assert answer["axes"] == grid
    for name in ("regime", "period", "impact_velocity"):
        assert answer["variables"][name] == encoding.pack(expected[name].isel(start=0).values), name
    for wrong in ([1], {"beta": [0.3, 0.4]}, {**box, "gamma": [0.78, 0.66]}, {**box, "beta": ["a", 1]}):
        with pytest.raises(vj.InputError, match="explore: box"):
            motions.answer({"box": wrong, "lane": 1}, no_newer_request)
