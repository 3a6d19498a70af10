"""Test that invalid sweep files give one line that names the file, the key and the value, and suggests a fix."""

import pytest

import vibrojax as vj
from vibrojax.errors import InputError, Place
from vibrojax.maps.read import read_point, read_sweep
from vibrojax.settings import toml as source

GRID = {"beta": [0.4]}


def refusal(source) -> str:
    """Return the line with which `source` is refused."""
    with pytest.raises(InputError) as caught:
        read_sweep(source)
    line = str(caught.value)
    assert "\n" not in line
    return line


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "p.csv: empty; a line of column names"),
        ("beta,gamma\n", "p.csv: no points; add"),
        ("0.3,0.7\n0.4,0.7\n", 'p.csv: line 1: "0.3, 0.7" are numbers; the first line names the columns'),
        ("beta,\n0.3,1\n", "p.csv: line 1: column 2 has no name"),
        (
            "beta,gama\n0.3,1\n",
            'p.csv: line 1, column gama: scene "vibro-impact" has no such parameter; did you mean "gamma"?',
        ),
        ("beta,beta\n0.3,1\n", "p.csv: line 1, column beta: is there already"),
        ("beta\tgamma\n0.3\t1\n", "is one column; separate them by commas"),
        ("beta,gamma\n0.3,1\n0.3\n", "p.csv: line 3: has 1 cells; 2 are needed"),
        ("beta\n0.3\nabc\n", 'p.csv: line 3, column beta: "abc" is not a number'),
        ("beta,gamma\n0.3,\n", "p.csv: line 2, column gamma: empty; write one"),
        ("beta\n-1\n", "p.csv: line 2, column beta: is -1; it must be above 0"),
        ("beta\nnan\n", "p.csv: line 2, column beta: is nan; a finite number is needed"),
        ("beta,start\n0.3,drvie\n", 'p.csv: line 2, column start: "drvie" is unknown; did you mean "drive"?'),
        ("friction\ncoulomb\n", "p.csv: line 1, column friction: is chosen once"),
        ('beta\n"0.3\n', "p.csv: line 2: not CSV:"),
    ],
)
def test_wrong_points_are_refused(tmp_path, text, line):
    (tmp_path / "p.csv").write_text(text)
    source = tmp_path / "map.toml"
    source.write_text('scene = "vibro-impact"\npoints = "p.csv"\n')
    assert line in refusal(source).replace(str(tmp_path) + "/", "")


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"scene": None}, "sweep: scene: missing"),
        ({"scene": "vibroimpact"}, 'sweep: scene: "vibroimpact" is unknown; did you mean "vibro-impact"?'),
        ({"scene": 3}, "sweep: scene: 3 is not a name; choose from"),
        ({"title": 3}, "sweep: title: 3 is not text"),
        ({"gird": {}}, 'sweep: gird: unknown key; did you mean "grid"?'),
        ({"settle": 3}, "sweep: settle: unknown key at the top; it belongs in [run]"),
        ({"k0": 3}, "sweep: k0: unknown key at the top; it belongs in [parameters]"),
        ({"grid": {}}, "sweep: grid: empty, so there is nothing to sweep"),
        ({"grid": None}, "sweep: grid: missing, so there is nothing to sweep"),
        ({"grid": 3}, "sweep: grid: 3 is not a table"),
        ({"points": "p.csv"}, 'sweep: points: "p.csv" beside [grid]; give one of them'),
        ({"parameters": {"beta": 0.3}}, "sweep: grid.beta: is in [parameters] as well"),
        (
            {"parameters": {"bata": 0.3}},
            'sweep: parameters.bata: scene "vibro-impact" has no such parameter; did you mean "beta"?',
        ),
        ({"parameters": {"c1": 75}}, 'did you mean "c2"?'),
        ({"parameters": {"m2": 100}}, "sweep: parameters.m2: is not a parameter: m2 = beta m1; give beta"),
        ({"parameters": {"k2": 1e4}}, "sweep: parameters.k2: is not a parameter: k2 = beta gamma^2 k1; give gamma"),
        ({"parameters": {"m1": "250"}}, 'sweep: parameters.m1: "250" is text; write a number, without quotes'),
        ({"parameters": {"m1": True}}, "sweep: parameters.m1: true is not a number"),
        ({"parameters": {"m1": [1, 2]}}, "sweep: parameters.m1: [1, 2] is not a number; what varies belongs in [grid]"),
        ({"parameters": {"m1": 10**5000}}, "sweep: parameters.m1: a whole number of 5001 digits or so is too large"),
        ({"parameters": {"m1": 0}}, "sweep: parameters.m1: is 0; it must be above 0 kg"),
        ({"parameters": {"settle": 3}}, "sweep: parameters.settle: is not a parameter; it belongs in [run]"),
        (
            {"parameters": {"friction": "stribek"}},
            'parameters.friction: "stribek" is unknown; did you mean "stribeck"?',
        ),
        ({"parameters": {"friction": 3}}, "sweep: parameters.friction: 3 is not a name"),
        ({"parameters": {"delta_f": 3}}, 'friction "stribeck" has no delta_f; it belongs to friction = "hyperbolic"'),
        ({"parameters": {"friction": "coulomb", "v_cr": 3}}, 'friction "coulomb" has no v_cr'),
        ({"parameters": {"rpm": 60}}, "sweep: parameters.rpm: bit_radius [m] is missing"),
        ({"parameters": {"bit_radius": 0.1}}, "sweep: parameters.bit_radius: rpm [1/min] is missing"),
        ({"parameters": {"rpm": 60, "bit_radius": 0.1, "v": 1}}, "sweep: parameters.rpm: v is given as well"),
        ({"parameters": {"rpm": 60, "bit_radius": 0.1}, "grid": {"v": [1]}}, "v is given as well; give v, or rpm"),
        (
            {"grid": {"friction": ["coulomb"]}},
            "sweep: grid.friction: is chosen once for all lanes, in [parameters]",
        ),
        ({"grid": {"beta": []}}, "sweep: grid.beta: [] has no values"),
        ({"grid": {"beta": 0.4}}, "sweep: grid.beta: 0.4 is not an axis"),
        ({"grid": {"beta": [0.4, float("nan")]}}, "sweep: grid.beta[1]: is nan; a finite number is needed"),
        ({"grid": {"delta": [float("inf")]}}, "sweep: grid.delta[0]: is inf; a finite number is needed"),
        ({"grid": {"beta": [0.4, -0.1]}}, "sweep: grid.beta[1]: is -0.1; it must be above 0"),
        ({"grid": {"beta": ["0.4"]}}, 'sweep: grid.beta[0]: "0.4" is text'),
        ({"grid": {"beta": [0.4, False]}}, "sweep: grid.beta[1]: false is not a number"),
        ({"grid": {"beta": [0.4, 0.5, 0.4]}}, "sweep: grid.beta[2]: 0.4 is there already, at [0]"),
        (
            {"grid": {"beta": {"start": 1, "stop": 2, "number": 3}}},
            'sweep: grid.beta.number: unknown key; did you mean "num"?',
        ),
        ({"grid": {"beta": {"start": 1, "stop": 2, "step": 0.1}}}, "unknown key; give num, how many values there are"),
        ({"grid": {"beta": {"start": 1, "stop": 2, "scale": "log"}}}, 'unknown key; did you mean "spacing"?'),
        ({"grid": {"beta": {"start": 1, "num": 3}}}, "sweep: grid.beta: stop is missing"),
        ({"grid": {"beta": {"start": 0, "stop": 1, "num": 3}}}, "sweep: grid.beta.start: is 0; it must be above 0"),
        ({"grid": {"beta": {"start": 1, "stop": 2, "num": 0}}}, "sweep: grid.beta.num: 0 does not fit; a whole number"),
        ({"grid": {"beta": {"start": 1, "stop": 2, "num": 2.5}}}, "sweep: grid.beta.num: 2.5 does not fit"),
        ({"grid": {"beta": {"start": 1, "stop": 2, "num": 1}}}, "sweep: grid.beta.num: 1 does not fit from 1 to 2"),
        ({"grid": {"beta": {"start": 1, "stop": 1, "num": 4}}}, "sweep: grid.beta.num: 4 does not fit from 1 to 1"),
        ({"grid": {"beta": {"start": 1, "stop": 2, "num": 10**9}}}, "a whole number from 1 to 10000000 is needed"),
        ({"grid": {"beta": {"start": 1, "stop": 1 + 1e-15, "num": 99}}}, "are not all different"),
        (
            {"grid": {"beta": {"start": 1, "stop": 2, "num": 3, "spacing": "lgo"}}},
            'spacing: "lgo" is unknown; did you mean',
        ),
        (
            {"grid": {"delta": {"start": -1, "stop": 2, "num": 3, "spacing": "log"}}},
            'sweep: grid.delta.start: is -1; spacing "log" needs ends above 0',
        ),
        (
            {"grid": {name: {"start": 1, "stop": 2, "num": 10**7} for name in ("beta", "gamma", "v")}},
            "lanes are too many",
        ),
        ({"starts": "drive"}, 'sweep: starts: "drive" is not a list of starts'),
        ({"starts": []}, "sweep: starts: [] is not a list of starts"),
        ({"starts": ["drive", "drive"]}, 'sweep: starts[1]: "drive" is there already'),
        ({"starts": ["dirve"]}, 'sweep: starts[0]: "dirve" is unknown; did you mean "drive"?'),
        ({"starts": [[0, 0, 0]]}, "sweep: starts[0]: [0, 0, 0] has 3 numbers; 4 are needed"),
        ({"starts": [[0, 0, 0, float("nan")]]}, "sweep: starts[0][3]: is nan"),
        ({"run": {"setle": 3}}, 'sweep: run.setle: unknown key; did you mean "settle"?'),
        ({"run": {"settle": -1}}, "sweep: run.settle: is -1; it must be at least 0 s"),
        ({"run": {"observe": 0}}, "sweep: run.observe: is 0; it must be above 0 s"),
        ({"run": {"error": 0}}, "sweep: run.error: is 0; it must be above 0"),
        ({"run": {"error": 1}}, "sweep: run.error: is 1; it must be below 1"),
        (
            {"run": {"error": 1e-30}},
            'sweep: run.error: 1e-30 cannot be reached; method "located" reaches 1e-12 in float64: give 1e-12 or more',
        ),
        ({"run": {"error": 1e-6, "precision": "float32"}}, 'method "located" reaches 3e-06 in float32: give 3e-06 or'),
        ({"run": {"error": 3e-5, "method": "smoothed"}}, 'method "smoothed" reaches 3.2e-05 in float64: give 3.2e-05'),
        (
            {"run": {"error": 9e-5, "method": "smoothed", "precision": "float32"}},
            'sweep: run.error: 9e-05 cannot be reached; method "smoothed" reaches 0.0001 in float32',
        ),
        (
            {"run": {"error": 1e-9, "method": "smoothed", "smoothing": 1e-8}},
            "sweep: run.error: 1e-09 cannot be reached",
        ),
        ({"run": {"end_early": 1}}, "sweep: run.end_early: 1 is neither true nor false"),
        ({"run": {"keep_returns": -1}}, "sweep: run.keep_returns: -1 does not fit"),
        ({"run": {"keep_returns": True}}, "sweep: run.keep_returns: true does not fit"),
        ({"run": {"chunk": 0}}, "sweep: run.chunk: 0 does not fit"),
        ({"run": {"step": 0}}, "sweep: run.step: is 0; it must be above 0 s"),
        ({"run": {"method": "smooth"}}, 'sweep: run.method: "smooth" is unknown; did you mean "smoothed"?'),
        ({"run": {"precision": "double"}}, 'sweep: run.precision: "double" is unknown'),
        ({"run": {"smoothing": 1e-3}}, 'sweep: run.smoothing: 0.001 has no use with method "located"'),
        ({"run": {"method": "smoothed", "smoothing": 0}}, "sweep: run.smoothing: is 0; it must be above 0"),
        ({"parameters": {"m1": None}}, "sweep: parameters.m1: None cannot stand in a sweep"),
        ({"grid": None, "points": {"beta": [1, 2], "gamma": [1]}}, "sweep: points.gamma: has 1 values; 2 are needed"),
        ({"grid": None, "points": {}}, "sweep: points: no columns"),
    ],
)
def test_wrong_input_is_refused(changes, line):
    tables = {"scene": "vibro-impact", "grid": GRID} | changes
    dropped = [key for key in ("scene", "grid") if tables[key] is None]
    assert line in refusal({key: value for key, value in tables.items() if key not in dropped})


@pytest.mark.parametrize("name", ["delta", "k0", "c0"])
def test_rotary_has_no_contact(name):
    for tables in ({"grid": {name: [1.0]}}, {"grid": GRID, "parameters": {name: 1.0}}):
        line = refusal({"scene": "rotary"} | tables)
        assert f'{name}: scene "rotary" has no {name}; it has m1, beta, gamma' in line


def test_rotary_has_no_touching_start():
    line = refusal({"scene": "rotary", "grid": GRID, "starts": ["touching"]})
    assert line == 'sweep: starts[0]: "touching" is not a start of scene "rotary"; choose from drive, stuck'


# files


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b'scene = "rotary\n', "map.toml: not TOML: Illegal character '\\n' (at line 1, column 16)"),
        (b"\xff\xfe", "map.toml: not UTF-8 text (byte 0); save it as UTF-8"),
        (b"a = 1" + b"0" * 5000, "map.toml: not TOML:"),
    ],
)
def test_files_that_are_not_toml_are_refused(tmp_path, content, line):
    path = tmp_path / "map.toml"
    path.write_bytes(content)
    assert line in refusal(path)


def test_missing_files_are_refused(tmp_path):
    (tmp_path / "map.toml").write_text("")
    assert 'mpa.toml: no such file; give the path of one that is there (did you mean "map.toml"?)' in refusal(
        tmp_path / "mpa.toml"
    )
    assert "is a folder; give the path of a file" in refusal(tmp_path)
    assert "cannot be read" in refusal("a\0.toml")
    assert refusal(3) == "sweep: 3 is not a sweep; give a path, a bundled name or a dict"


def test_unknown_bundled_name_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(source, "BUNDLED_FOLDERS", (tmp_path,))
    (tmp_path / "regime_map.toml").write_text("")
    assert refusal("regime-mpa") == 'regime-mpa: no such bundled sweep or file; did you mean "regime-map"?'


def test_wrong_point_is_refused_like_file():
    for scene, parameters, start, line in (
        ("rotary", {"delta": 1.0}, None, 'simulate: delta: scene "rotary" has no delta'),
        ("rotary", {}, "touching", 'simulate: start: "touching" is not a start'),
        ("rotary", {"beta": -1.0}, None, "simulate: beta: is -1; it must be above 0"),
        ("rotery", {}, None, 'simulate: scene: "rotery" is unknown; did you mean "rotary"?'),
    ):
        with pytest.raises(InputError) as caught:
            read_point(Place("simulate"), scene, parameters, start)
        assert str(caught.value).startswith(line)


@pytest.mark.parametrize(
    ("run", "least"),
    [
        ({}, 1e-12),
        ({"precision": "float32"}, 3e-6),
        ({"method": "smoothed"}, 3.2e-5),
        ({"method": "smoothed", "precision": "float32"}, 1e-4),
        ({"method": "smoothed", "smoothing": 1e-2}, 3.2e-5),
        ({"method": "smoothed", "smoothing": 1e-8}, 1.01e-6),
    ],
)
def test_smallest_accepted_error(run, least):
    sweep = {"scene": "rotary", "grid": {"gamma": [0.5]}, "run": run | {"error": least}}
    assert vj.read_sweep(sweep).run.error == least
    with pytest.raises(InputError, match=r"run\.error: .* cannot be reached"):
        vj.read_sweep(sweep | {"run": run | {"error": 0.9 * least}})


@pytest.mark.parametrize("run", [{"error": 1e-12}, {"error": 3e-6, "precision": "float32"}])
def test_smallest_accepted_error_is_reached(run):
    sweep = {"scene": "rotary", "grid": {"gamma": [0.5, 0.6, 0.7]}, "run": run | {"settle": 200.0}}
    ds = vj.run_sweep(sweep, progress=False)
    assert (ds.cycles > 0).all() and (ds.error_estimate <= run["error"]).all()


@pytest.mark.parametrize(
    ("setting", "method"),
    [
        ({"error": 1e-13}, "located"),
        ({"error": 1e-5, "method": "smoothed"}, "smoothed"),
        ({"error": 1e-5, "solver": "Tsit5"}, "diffrax"),
        ({"error": 1e-13, "solver": "Tsit5", "smoothing": 1e-2}, "diffrax"),
    ],
)
def test_simulate_refuses_unreachable_error(setting, method):
    with pytest.raises(InputError, match=f'simulate: error: .* cannot be reached; method "{method}" reaches'):
        vj.simulate("rotary", duration=0.1, progress=False, **setting)
