"""Test that any sweep file, dict or CSV ends in a sweep or in a one-line error, when it is read and as a command.

VIBROJAX_FUZZ=100000 pytest tests/test_sweep_file_fuzzed.py searches longer.
"""

import contextlib
import io
import os
import random
import re
import signal
import sys
import time
import warnings
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from vibrojax.cli import main
from vibrojax.cli.command import named_values
from vibrojax.errors import InputError, Place
from vibrojax.maps.cost import check_size, estimated_steps
from vibrojax.maps.read import read_point, read_sweep
from vibrojax.studies.trajectory import Trajectories

SWEEPS = [path.read_text(encoding="utf-8") for path in sorted((Path(__file__).parents[1] / "sweeps").glob("*.toml"))]
fuzzed = settings(
    max_examples=int(os.environ.get("VIBROJAX_FUZZ", 60)),
    deadline=5000,  # [ms]; catches hangs
    derandomize="VIBROJAX_FUZZ" not in os.environ,
    suppress_health_check=list(HealthCheck),
)

KEYS = """
    scene title starts points parameters grid run beta gamma v delta k0 c0 c2 m1 mu rpm bit_radius rock threshold k3
    zeta force frequency friction pulse_shape settle observe error chunk keep_returns method step smoothing
    precision end_early start stop num spacing
"""
VALID = """
    vibro-impact rotary penetration drilling coupled-drilling drive stuck touching stribeck coulomb sandstone
    granite located smoothed float32 float64 log linear sweep half-sine p.csv
"""
NAMES, WORDS = st.sampled_from(KEYS.split()), st.sampled_from(VALID.split())
NUMBERS = (
    st.floats()
    | st.integers(-3, 10**6)
    | st.sampled_from([0, -0.0, 1, 0.4, 1e-3, 5e-324, 1e308, 10**12, 2**63, 10**400])
)
SCALARS = NUMBERS | st.booleans() | WORDS | st.text(max_size=8) | st.none()
VALUES = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=5) | st.dictionaries(NAMES | st.text(max_size=5), inner, max_size=5)
)
RANGES = st.fixed_dictionaries(
    {"start": NUMBERS, "stop": NUMBERS, "num": NUMBERS}, optional={"spacing": WORDS | st.none()}
)
AXES = st.lists(NUMBERS, max_size=4) | RANGES | VALUES
TABLES = st.fixed_dictionaries(
    {"scene": st.sampled_from(["vibro-impact", "rotary", "penetration", "drilling"]) | VALUES},
    optional={
        "title": VALUES,
        "starts": st.lists(WORDS | st.lists(NUMBERS, max_size=5), max_size=3) | VALUES,
        "parameters": st.dictionaries(NAMES, SCALARS, max_size=4) | VALUES,
        "grid": st.dictionaries(NAMES, AXES, max_size=3) | VALUES,
        "points": st.dictionaries(NAMES, st.lists(SCALARS, max_size=4), max_size=3) | VALUES,
        "run": st.dictionaries(NAMES, SCALARS, max_size=4) | VALUES,
    },
)


def check_reading_ends(source) -> None:
    """Check that reading gives a usable sweep or a one-line error."""
    try:
        sweep = read_sweep(source)
        assert sweep.lanes >= 1 and sweep.dims and sweep.identity()
        values, starts = sweep.lane_values(sweep.lanes - 1, sweep.lanes)
        assert set(values) == set(sweep.system.parameters()) and starts.shape == (1,)
        check_size(sweep)
    except InputError as error:
        assert str(error) and "\n" not in str(error)


@fuzzed
@given(TABLES | st.dictionaries(NAMES | st.text(max_size=5), VALUES, max_size=5))
@example({"scene": "rotary", "grid": {"beta": [5e-324, 1.7e308]}, "run": {"settle": 1.7e308, "observe": 1.7e308}})
@example({"scene": "rotary", "grid": {"beta": {"start": 1e-300, "stop": 1.7e308, "num": 3, "spacing": "log"}}})
def test_dicts(tables):
    check_reading_ends(tables)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzzed") / "map.toml"


@st.composite
def mutated_sweep_text(draw) -> str:
    """Draw a bundled sweep in which parts are removed, repeated, replaced or inserted."""
    text = draw(st.sampled_from(SWEEPS))
    for _ in range(draw(st.integers(1, 4))):
        a, b = sorted((draw(st.integers(0, len(text))), draw(st.integers(0, len(text)))))
        b = min(b, a + draw(st.integers(0, 30)))
        new = draw(st.sampled_from(["", text[a:b] * 2]) | SCALARS.map(str) | NAMES | st.text(max_size=5))
        text = text[:a] + new + text[b:]
    return text


@fuzzed
@given(mutated_sweep_text() | st.text(max_size=200))
@example("a = " + "[" * 5000)
@example("a" + ".a" * 5000 + " = 1")
@example("scene = 'rotary'\ngrid.beta = [1_0e9999, 0x1f, 1979-05-27T07:32:00Z]")
def test_files(file, text):
    file.write_bytes(text.encode("utf-8", "surrogatepass"))
    check_reading_ends(file)


@fuzzed
@given(st.binary(max_size=300))
def test_bytes(file, content):
    file.write_bytes(content)
    check_reading_ends(file)


CELLS = SCALARS.map(str) | st.sampled_from(["0.3", "", " 1e0 ", '"', '"0.3"', "\0", "nan", "1_0", "½"])


@pytest.mark.filterwarnings("ignore:.*semicolons separate the columns")
@fuzzed
@given(
    st.lists(NAMES | CELLS, max_size=4),
    st.lists(st.lists(CELLS, max_size=4), max_size=5),
    st.sampled_from([",", ";", "\t"]),
    st.sampled_from(["\n", "\r\n", "\r"]),
    st.sampled_from(["utf-8", "utf-8-sig", "utf-16"]),
)
def test_points(file, header, rows, comma, newline, encoding):
    text = newline.join(comma.join(row) for row in [header, *rows])
    (file.parent / "p.csv").write_bytes(text.encode(encoding, "surrogatepass"))
    file.write_text('scene = "vibro-impact"\npoints = "p.csv"\n')
    check_reading_ends(file)


@fuzzed
@given(
    st.text(max_size=8) | WORDS,
    st.lists(st.tuples(NAMES | st.text(max_size=5), st.sampled_from(["=", "", " = "]), SCALARS.map(str)), max_size=4),
)
@example("rotary", [("start", "=", "[" * 5000)])
@example("rotary", [("beta", "=", "9" * 5000)])
def test_names_and_values_on_command_line(scene, words):
    try:
        settings, parameters = named_values(
            Place("simulate"), ["".join(word) for word in words], Trajectories.words(), lists=False
        )
        read_point(Place("simulate"), scene, parameters, settings.pop("start", None))
    except InputError as error:
        assert "\n" not in str(error)


SMALL = """
scene = "vibro-impact"
starts = ["drive", [0.01, 0.0, 0.0, 0.1]]
[parameters]
delta = 0.005
friction = "stribeck"
[grid]
beta = { start = 0.3, stop = 0.4, num = 2 }
gamma = [0.65, 0.7]
[run]
settle = 1.0
observe = 1.0
error = 1e-3
"""
"""A sweep of few short lanes, most of whose mutations are run."""

TEXT_OF_LITERALS = """
    0 -0.0 1 -1 2 3 0.4 1e-3 5e-324 1e-300 1e308 1e12 1_000_000 9223372036854775807 99999999999999999999999 inf -inf nan
    true false "" "stuck" "located" "smoothed" "float32" "rotary" "drilling" "penetration" "granite" "gamma" [] [0.4]
    [0.4,0.4] [1e308,-1e308] ["stuck"] [[0,0,0,0]] [[1e300,0,0,0]] {} {start=0.3,stop=0.6,num=10000000}
    {start=0.3,stop=0.6,num=3,spacing="log"} {sample="sobol",count=4096,box={x1=[-1,1]}} 1979-05-27
"""
LITERALS = TEXT_OF_LITERALS.split()
"""Values that replace others in a file."""

LINES = [f"{key} = " for key in KEYS.split()] + ["[run]", "[parameters]", "[points]", "[grid]"]

DRY_SECONDS, RUN_SECONDS, BYTES = 10.0, 60.0, 1e9
"""Processor time that a command on one file may take without and with stepping lanes, and additional memory. Lanes that
are too stiff are abandoned after 1e6 steps, which takes seconds."""


def mutated_file(seed: int) -> str:
    """Return a sweep file in which some values, lines or characters are others."""
    draw = random.Random(seed)
    lines = (SMALL if seed % 2 else draw.choice(SWEEPS)).splitlines()
    for _ in range(draw.randint(1, 3)):
        at = draw.choice([k for k, line in enumerate(lines) if line.strip()])
        kind = draw.random()
        if kind < 0.75 and (numbers := list(re.finditer(r"(?<![\w.])\d[\d.e+-]*", lines[at]))):
            number = draw.choice(numbers)
            scaled = float(number[0]) * draw.choice([-1, 0, 0.5, 1.001, 2, 10 ** draw.uniform(-9, 9)])
            text = str(round(scaled)) if number[0].isdigit() and abs(scaled) < 1e15 else repr(scaled)
            lines[at] = lines[at][: number.start()] + text + lines[at][number.end() :]
        elif kind < 0.87 and "=" in lines[at]:
            lines[at] = f"{lines[at].partition('=')[0]}= {draw.choice(LITERALS)}"
        elif kind < 0.93:
            line = draw.choice(LINES)
            lines.insert(at + 1, line + draw.choice(LITERALS) if line.endswith("= ") else line)
        elif kind < 0.95:
            lines.insert(draw.randrange(len(lines)), lines[at])
        elif kind < 0.97 and len(lines) > 1:
            del lines[at]
        else:
            place = draw.randint(0, len(lines[at]))
            lines[at] = lines[at][:place] + draw.choice('\0\x1b[]{}="\u202e½#\n.,e-') + lines[at][place:]
    return "\n".join(lines)


def peak_memory() -> float:
    """Return the greatest resident memory of this process so far [bytes]."""
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def is_small(path: Path) -> bool:
    """Return whether a file is a sweep that runs within seconds."""
    try:
        sweep = read_sweep(path)
        steps = estimated_steps(sweep)
        return sweep.lanes <= 64 and steps.total < 3e6 and sweep.run.keep_returns < 1000 and sweep.run.chunk is None
    except InputError:
        return False


@contextlib.contextmanager
def alarm(seconds: int, seed: int):
    """Fail after some seconds: a command may wait without computing."""

    def fail(*_):
        raise AssertionError(f"case {seed} takes {seconds} s")

    before = signal.signal(signal.SIGALRM, fail)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def check_command(folder: Path, seed: int) -> int:
    """Run the command on one file, and return its status."""
    file = folder / "map.toml"
    file.write_bytes(mutated_file(seed).encode("utf-8"))
    commands = [(DRY_SECONDS, ["--dry-run"])]
    if is_small(file):
        commands.append((RUN_SECONDS, ["--fresh", "-o", str(folder / "out.nc")]))
    for most_seconds, options in commands:
        out, err = io.StringIO(), io.StringIO()
        began, used = time.process_time(), peak_memory()
        with alarm(120, seed), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = main(["sweep", str(file), *options])
        about = (seed, options, err.getvalue())
        assert status in (0, 2) and "Traceback" not in err.getvalue(), about
        assert status == 0 or (out.getvalue() == "" and err.getvalue().strip().count("\n") == 0), about
        assert time.process_time() - began < most_seconds, about
        assert peak_memory() - used < BYTES, about
    return status


@pytest.mark.skipif(not hasattr(signal, "SIGALRM"), reason="no alarms")
@pytest.mark.parametrize(
    "seeds", [range(10), *(pytest.param(range(k, k + 58), marks=pytest.mark.long) for k in range(10, 300, 58))], ids=str
)
def test_command_ends(tmp_path, seeds):
    """The command ends with a result or one line, whatever its file holds, without much time or memory."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        statuses = [check_command(tmp_path, seed) for seed in seeds]
    assert set(statuses) == {0, 2}
