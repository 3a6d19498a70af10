"""Test that invalid sweep files give one line that names the file, the key and the value, and suggests a fix.

VIBROJAX_FUZZ=100000 pytest tests/test_sweep_file_refused.py -k fuzzed searches longer."""

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from refusals import refusal

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.maps.cost import check_size

GRID = {"beta": [0.4]}


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "p.csv: empty; a line of column names"),
        ("0.3,0.7\n0.4,0.7\n", 'p.csv: line 1: "0.3, 0.7" are numbers; the first line names the columns'),
        ("beta,gamma\n0.3,1\n0.3\n", "p.csv: line 3: has 1 cells; 2 are needed"),
        ("beta\n0.3\nabc\n", 'p.csv: line 3, column beta: "abc" is not a number'),
        ("beta,start\n0.3,drvie\n", 'p.csv: line 2, column start: "drvie" is unknown; did you mean "drive"?'),
    ],
)
def test_wrong_points_are_refused(tmp_path, text, line):
    (tmp_path / "p.csv").write_text(text)
    source = tmp_path / "map.toml"
    source.write_text('scene = "vibro-impact"\npoints = "p.csv"\n')
    assert line in refusal(vj.read_sweep, source).replace(str(tmp_path) + "/", "")


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"scene": None}, "sweep: scene: missing"),
        ({"scene": "vibroimpact"}, 'sweep: scene: "vibroimpact" is unknown; did you mean "vibro-impact"?'),
        ({"k0": 3}, "sweep: k0: unknown key at the top; it belongs in [parameters]"),
        ({"grid": None}, "sweep: grid: missing, so there is nothing to sweep"),
        ({"parameters": {"beta": 0.3}}, "sweep: grid.beta: is in [parameters] as well"),
        ({"parameters": {"m2": 100}}, "sweep: parameters.m2: is not a parameter: m2 = beta m1; give beta"),
        ({"parameters": {"m1": 10**5000}}, "sweep: parameters.m1: a whole number of 5001 digits or so is too large"),
        ({"parameters": {"delta_f": 3}}, 'friction "stribeck" has no delta_f; it belongs to friction = "hyperbolic"'),
        ({"parameters": {"rpm": 60}}, "sweep: parameters.rpm: bit_radius [m] is missing"),
        ({"grid": {"beta": [0.4, float("nan")]}}, "sweep: grid.beta[1]: is nan; a finite number is needed"),
        ({"grid": {"beta": [0.4, 0.5, 0.4]}}, "sweep: grid.beta[2]: 0.4 is there already, at [0]"),
        ({"grid": {"beta": {"start": 1, "stop": 2, "step": 0.1}}}, "unknown key; give num, how many values there are"),
        ({"grid": {"beta": {"start": 1, "stop": 1 + 1e-15, "num": 99}}}, "are not all different"),
        ({"starts": ["dirve"]}, 'sweep: starts[0]: "dirve" is unknown; did you mean "drive"?'),
        ({"starts": [[0, 0, 0]]}, "sweep: starts[0]: [0, 0, 0] has 3 numbers; 4 are needed"),
        ({"run": {"smoothing": 1e-3}}, 'sweep: run.smoothing: 0.001 has no use with method "located"'),
        ({"grid": None, "points": {"beta": [1, 2], "gamma": [1]}}, "sweep: points.gamma: has 1 values; 2 are needed"),
    ],
)
def test_wrong_input_is_refused(changes, line):
    tables = {"scene": "vibro-impact", "grid": GRID} | changes
    dropped = [key for key in ("scene", "grid") if tables[key] is None]
    assert line in refusal(vj.read_sweep, {key: value for key, value in tables.items() if key not in dropped})


def test_missing_files_and_other_formats_are_refused(tmp_path):
    for content, line in (
        (b'scene = "rotary\n', "map.toml: not TOML: Illegal character '\\n' (at line 1, column 16)"),
        (b"\xff\xfe", "map.toml: UTF-16 text; save it as UTF-8"),
    ):
        (tmp_path / "map.toml").write_bytes(content)
        assert line in refusal(vj.read_sweep, tmp_path / "map.toml")
    line = 'mpa.toml: no such file; give the path of one that is there (did you mean "map.toml"?)'
    assert line in refusal(vj.read_sweep, tmp_path / "mpa.toml")
    assert "is a folder; give the path of a file" in refusal(vj.read_sweep, tmp_path)
    assert "cannot be read" in refusal(vj.read_sweep, "a\0.toml")
    assert refusal(vj.read_sweep, 3) == "sweep: 3 is not a sweep; give a path, a bundled name or a dict"


def test_smallest_accepted_error_is_reached():
    sweep = {"scene": "rotary", "grid": {"gamma": [0.5, 0.6, 0.7]}}
    for run, least in (({"settle": 200.0}, 1e-12), ({"method": "smoothed"}, 3.2e-5)):
        assert vj.read_sweep(sweep | {"run": run | {"error": least}}).run.error == least
        with pytest.raises(vj.InputError, match=r"run\.error: .* cannot be reached"):
            vj.read_sweep(sweep | {"run": run | {"error": 0.9 * least}})
    ds = vj.run_sweep(sweep | {"run": {"error": 1e-12, "settle": 200.0}}, progress=False)
    assert (ds.cycles > 0).all() and (ds.error_estimate <= 1e-12).all()
    for setting, method in (({"error": 1e-13}, "located"), ({"error": 1e-5, "solver": "Tsit5"}, "diffrax")):
        with pytest.raises(vj.InputError, match=f'simulate: error: .* cannot be reached; method "{method}" reaches'):
            vj.simulate("rotary", duration=0.1, progress=False, **setting)


BASE = {"scene": "vibro-impact", "parameters": {"k1": 2e5}, "grid": {"beta": [0.3, 0.4], "gamma": [0.6, 0.7]}}


changed = lambda *words: vj.read_sweep(BASE, words)


def test_parameters_become_fixed_values_or_axes():
    sweep = changed("k1=312500", "v = 2", "beta=0.5", "friction=coulomb", "delta={start=-0.005, stop=0.005, num=3}")
    assert sweep.parameters["k1"] == 312500 and sweep.parameters["v"] == 2.0 and sweep.parameters["beta"] == 0.5
    assert sweep.friction == "coulomb" and list(sweep.axes) == ["gamma", "delta"] and len(sweep.axes["delta"]) == 3
    assert list(changed("k1=[2e5, 3e5]").axes) == ["beta", "gamma", "k1"]
    law = vj.FRICTION_LAWS["coulomb"]
    sweep = vj.read_sweep({**BASE, "parameters": {"friction": law}}, ["v=2"])
    assert sweep.system.friction is law and 'friction = "coulomb"' in sweep.text


def test_bad_words_are_refused():
    for word, line in (
        ("k1", '--set: "k1" is not NAME=VALUE; write one, like k1=312500 or run.settle=200'),
        ("ran.settle=3", '--set: ran.settle: unknown table "ran"; did you mean "run"?'),
        ("kk1=3", 'scene "vibro-impact" has no such parameter; did you mean "k1"?'),
        ("settle=long", 'run.settle: "long" is text'),
    ):
        assert line in refusal(changed, word)


def test_command(here, capsys):
    words = ["run.settle=0.5", "observe=0.5", "beta=0.4", "gamma=[0.6,0.7]", "delta=0.005"]
    words = [part for word in words for part in ("--set", word)]
    assert main(["sweep", "regime-map", "--dry-run", *words]) == 0
    assert capsys.readouterr().out.startswith("lanes   4 (2 gamma x 2 start)")


SPEEDS = "v (drive speed [m/s]), v_cr (Stribeck speed [m/s]) or rpm (rotation speed of the drive [1/min])"


def test_names_are_suggested_by_meaning_and_values_that_determine_no_parameter_refused():
    for word, meant in (("gap", "delta (gap [m])"), ("speed", SPEEDS)):
        line = refusal(vj.read_sweep, {"scene": "vibro-impact", "grid": {word: [1.0, 2.0]}})
        assert line.endswith(f"; did you mean {meant}?")
    for scene, values, line in (
        ("rotary", {"gap": 1}, 'gap: scene "rotary" has no delta (gap [m]); scenes with one: coupled-drilling, '),
        ("vibro-impact", {"blows": 200}, "blows: is a result of the motion and determines no parameter; give v"),
        ("rotary", {"gamma": 0.7, "striker_frequency": 3}, "striker_frequency: gamma is given as well; give gamma, or"),
        ("rotary", {"striker_frequency": 0}, "striker_frequency: is 0; it must be above 0 Hz"),
    ):
        assert line in refusal(vj.simulate, scene, **values, progress=False)
        assert line in refusal(vj.read_sweep, {"scene": scene, "parameters": values, "grid": {"m1": [250.0]}})


# Any sweep file, dict or CSV ends in a sweep or in a one-line error
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
LIMITS = [0, -0.0, 1, 0.4, 1e-3, 5e-324, 1e308, 10**12, 2**63, 10**400]
NUMBERS = st.floats() | st.integers(-3, 10**6) | st.sampled_from(LIMITS)
SCALARS = NUMBERS | st.booleans() | WORDS | st.text(max_size=8) | st.none()
OWN_NAMES = NAMES | st.text(max_size=5)
ANY_VALUES = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=5) | st.dictionaries(OWN_NAMES, inner, max_size=5)
)
RANGES = st.fixed_dictionaries(dict.fromkeys(("start", "stop", "num"), NUMBERS), optional={"spacing": WORDS})
OPTIONAL = {
    "title": ANY_VALUES,
    "starts": st.lists(WORDS | st.lists(NUMBERS, max_size=5), max_size=3),
    "parameters": st.dictionaries(NAMES, SCALARS, max_size=4),
    "grid": st.dictionaries(NAMES, st.lists(NUMBERS, max_size=4) | RANGES | ANY_VALUES, max_size=3),
    "points": st.dictionaries(NAMES, st.lists(SCALARS, max_size=4), max_size=3),
    "run": st.dictionaries(NAMES, SCALARS, max_size=4),
}
TABLES = st.fixed_dictionaries(
    {"scene": st.sampled_from(["vibro-impact", "rotary", "penetration", "drilling"]) | ANY_VALUES},
    optional={name: values | ANY_VALUES for name, values in OPTIONAL.items()},
)


def check_reading_ends(source) -> None:
    """Check that reading gives a usable sweep or a one-line error."""
    try:
        sweep = vj.read_sweep(source)
        assert sweep.lanes >= 1 and sweep.dims and sweep.identity()
        values, starts = sweep.lane_values(sweep.lanes - 1, sweep.lanes)
        assert set(values) == set(sweep.system.parameters()) and starts.shape == (1,)
        check_size(sweep)
    except vj.InputError as error:
        assert str(error) and "\n" not in str(error)


@fuzzed
@given(TABLES | st.dictionaries(OWN_NAMES, ANY_VALUES, max_size=5))
@example({"scene": "rotary", "grid": {"beta": [5e-324, 1.7e308]}, "run": {"settle": 1.7e308, "observe": 1.7e308}})
@example({"scene": "rotary", "grid": {"beta": {"start": 1e-300, "stop": 1.7e308, "num": 3, "spacing": "log"}}})
def test_fuzzed_dicts(tables):
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
def test_fuzzed_files(file, text):
    file.write_bytes(text.encode("utf-8", "surrogatepass"))
    check_reading_ends(file)
