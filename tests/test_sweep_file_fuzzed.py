"""Test that any sweep file, dict or CSV ends in a sweep or in a one-line error, when it is read and as a command.

VIBROJAX_FUZZ=100000 pytest tests/test_sweep_file_fuzzed.py searches longer.
"""

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from vibrojax.errors import InputError
from vibrojax.maps.cost import check_size
from vibrojax.maps.read import read_sweep

SWEEPS = [path.read_text(encoding="utf-8") for path in sorted((Path(__file__).parents[1] / "sweeps").glob("*.toml"))]
fuzzed = settings(
    max_examples=int(os.environ.get("VIBROJAX_FUZZ", 40)),
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
