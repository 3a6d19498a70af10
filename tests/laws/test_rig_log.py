"""Test reading of rig logs: dialects, dropped rows with reasons, and one-line refusals of bad files."""

import sys
from pathlib import Path

import numpy as np
import pytest

from vibrojax.errors import InputError
from vibrojax.io.attributes import table_of
from vibrojax.io.riglog import log_lines, read_log

sys.path.insert(0, str(Path(__file__).parents[2] / "notebooks"))
import rig_logs

pytestmark = pytest.mark.filterwarnings("ignore:.*semicolons separate the columns:UserWarning")


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    return rig_logs.write_all(tmp_path_factory.mktemp("logs"))


def pason(folder, **changes):
    """Write a log of 12 rows without traps, with columns replaced by `changes` (header: cells), and return its path."""
    path = rig_logs.write(folder / "log.csv", "pason", rig_logs.drilling(12))
    header, *lines = (line.split(",") for line in path.read_text().splitlines())
    for name, cells in changes.items():
        for line, cell in zip(lines, cells, strict=False):
            line[header.index(name)] = str(cell)
    path.write_text("\n".join(map(",".join, [header, *lines])) + "\n")
    return path


@pytest.mark.parametrize("name", list(rig_logs.DIALECTS))
def test_dialect_is_detected_and_its_traps_are_dropped(logs, name):
    """Only drilling rows remain, in SI units. Dropped rows are counted by reason."""
    planted, (_, traps) = rig_logs.drilling(), rig_logs.with_traps(rig_logs.drilling())
    log = read_log(logs[name])
    assert log.dialect == name.partition("-")[0] and log.rows_read == len(planted["depth"]) + sum(traps.values())
    assert {reason: entry["rows"] for reason, entry in table_of(log, "dropped").items()} == traps
    names = {"depth": "depth", "rate_of_penetration": "rate", "weight_on_bit": "weight"}
    for quantity, column in names.items():
        np.testing.assert_allclose(log[quantity], planted[column], rtol=1e-12)
    np.testing.assert_allclose(log.rotary_speed, planted["rpm"] * 2 * np.pi / 60, rtol=1e-12)
    for quantity in ("torque", "flow", "pressure"):
        if quantity in log:
            np.testing.assert_allclose(log[quantity], planted[quantity], rtol=1e-12)
    assert ("torque" in log) == (name != "pason-processed")  # the column is a pressure there
    lines = "\n".join(log_lines(log))
    assert f"dialect {log.dialect}: " in lines and "dropped 6 of 406 rows" in lines
    assert "missing weight: 2 (line" in lines and ("is left out" in lines) == (name == "pason-processed")
    last = logs[name].read_text().splitlines()[int(log.line[-1]) - 1]
    assert last == logs[name].read_text().splitlines()[-1]


def test_times_are_seconds_since_the_first_row(logs, tmp_path):
    for name in ("pason", "rigcloud"):
        log = read_log(logs[name])
        np.testing.assert_allclose(log.time, 10.0 * (log.line - 2))
    night = pason(tmp_path, **{"HH:MM:SS": ["23:59:50"], "YYYY/MM/DD": ["2020/11/03"]})
    np.testing.assert_allclose(read_log(night).time[:3], [0, 20, 30])
    odd = pason(tmp_path, **{"HH:MM:SS": ["noon"] * 12})
    assert "time" not in read_log(odd) and 'column "HH:MM:SS" holds no times' in "\n".join(log_lines(read_log(odd)))


def test_units_and_columns_and_dialects_can_be_overridden(logs, tmp_path):
    rigcloud = read_log(logs["rigcloud"])
    metric = read_log(logs["rigcloud"], units={"weight_on_bit": "t"})
    ratio = (metric.weight_on_bit / rigcloud.weight_on_bit).values
    np.testing.assert_allclose(ratio, 9806.65 / 4448.2216152605)
    assert table_of(metric, "columns")["weight_on_bit"] == {"column": "Weight on Bit", "unit": "t", "assumed": False}
    given = {"bit_diameter": "8.5 in", "rate_of_penetration": "ROP(1 m) (m/h)"}
    log = read_log(logs["pason-processed"], columns=given)
    np.testing.assert_allclose(log.bit_diameter, 0.2159)
    np.testing.assert_allclose(log.rate_of_penetration, rigcloud.rate_of_penetration, rtol=1e-12)
    with pytest.raises(InputError, match='dialect: "pasen" is unknown; did you mean "pason"'):
        read_log(logs["pason"], dialect="pasen")
    forced = read_log(logs["witsml"], dialect="rigcloud")  # same names, other units
    np.testing.assert_allclose(forced.weight_on_bit[:100], 4448.2216152605 * rigcloud.weight_on_bit[:100])
    assert forced.detected == "as the user says"
    fast = read_log(logs["pason"], fastest="3000 ft/h")
    assert fast.sizes["row"] == rigcloud.sizes["row"] + 1 and "rate beyond reason" not in table_of(fast, "dropped")


def test_rows_off_bottom_and_depth_outliers_are_dropped(tmp_path):
    """An outlier costs only its own row, not the rows after it."""
    depths = (rig_logs.drilling(12)["depth"] / rig_logs.FOOT).tolist()
    path = pason(tmp_path, **{"Hole Depth (feet)": [*depths[:4], 9e4], "Bit Depth (feet)": [*depths[:4], 9e4, 0.0]})
    dropped = table_of(read_log(path), "dropped")
    assert dropped == {
        "off bottom": {"rows": 1, "lines": "7"},
        "depth not monotonic": {"rows": 1, "lines": "6"},
    }


ROWS = "10,20,30,120\n11,22,33,121\n"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("Depth (m),WOB (kN),ROP (m/h),RPM (rpm)\n" + ROWS, "dialect generic"),
        ('\ufeffDepth (m),"WOB (kN)",ROP (M_PER_HR),RPM (rpm)\r\n' + ROWS + "\r\n\r\n", "dialect generic"),
        ("Depth,WOB,ROP,Rotary RPM\n(m),kN,[m/h],RPM\n" + ROWS, "line 2 holds the units of the columns"),
        ("Depth, m;WOB, kN;ROP, m/h;RPM, rpm\n" + ROWS.replace(",", ",0;").replace("\n", ",0\n"), "dialect semicolon"),
        ("Depth (m);WOB (N);ROP (m/h);RPM (rpm)\n10,0;20.000,0;30,0;120,0\n11,0;22.000,0;33,0;121,0\n", "semicolon"),
        ('Depth (m),WOB (N),ROP (m/h),RPM (rpm)\n10,"20,000.0",30,120\n11,"22,000.0",33,121\n', "dialect generic"),
    ],
    ids=["plain", "byte-order-mark", "row-of-units", "commas-in-names", "german-thousands", "us-thousands"],
)
def test_exports_are_read_without_editing(tmp_path, text, expected):
    (tmp_path / "log.csv").write_bytes(text.encode())
    log = read_log(tmp_path / "log.csv")
    np.testing.assert_allclose(log.depth, [10, 11])
    np.testing.assert_allclose(log.weight_on_bit, [20e3, 22e3])
    np.testing.assert_allclose(log.rate_of_penetration, np.array([30, 33]) / 3600)
    np.testing.assert_allclose(log.rotary_speed, np.array([120, 121]) * 2 * np.pi / 60)
    assert expected in "\n".join(log_lines(log))


def test_windows_1252_is_read_with_a_warning(tmp_path):
    (tmp_path / "log.csv").write_bytes("Depth (m),WOB (kN),Temp (\xb0C)\n1,2,3\n".encode("cp1252"))
    with pytest.warns(UserWarning, match=r"log.csv: not UTF-8 \(byte 25\), read as Windows-1252"):
        assert "Temp (\xb0C)" in read_log(tmp_path / "log.csv").coords


BAD = {
    "a word": ({"Weight on Bit (klbs)": [9, "high"]}, 'line 3, column Weight on Bit (klbs): "high" is not a number'),
    "thousands": ({"Hole Depth (feet)": [5, '"1.234.5"']}, 'line 3, column Hole Depth (feet): "1.234.5" is not a n'),
    "infinity": ({"Rate Of Penetration (ft_per_hr)": [9, 9, "1e999"]}, "line 4, column Rate Of Penetration (ft_per"),
    "a wrong time": ({"HH:MM:SS": ["12:00:00", "25:61:00"]}, 'line 3, column HH:MM:SS: "2020-11-04 25:61:00" is not'),
    "a falling depth": ({"Hole Depth (feet)": range(99, 0, -1)}, "line 3, column Hole Depth (feet): the depth falls"),
    "no drilling": ({"Rotary RPM (RPM)": [0] * 12}, "line 2 to 13, column Rate Of Penetration (ft_per_hr): no row is"),
    "nulls alone": ({"Weight on Bit (klbs)": ["-999.25"] * 12}, "no row is left of 12: missing weight 12"),
    "a cell more": ({"Formation": ["a,b"]}, "line 2: has 13 cells; 12 are needed"),
}


@pytest.mark.parametrize("kind", list(BAD))
def test_bad_cells_are_refused_with_column_and_line(tmp_path, kind):
    changes, line = BAD[kind]
    with pytest.raises(InputError) as caught:
        read_log(pason(tmp_path, **changes))
    assert line in str(caught.value) and "\n" not in str(caught.value)


FILES = {
    "empty": ("log.csv", "", "empty; a line of column names"),
    "no header": ("log.csv", "1,2\n3,4\n", 'line 1: "1, 2" are numbers'),
    "no rows": ("log.csv", "DMEA,WOB,ROPA\n", "no rows; add a line for each measurement"),
    "units and no rows": ("log.csv", "DMEA,WOB,ROPA\nm,N,m/s\n", "no rows; add a line for each measurement below"),
    "no text": ("log.csv", b"PK\x03\x04\xff\xfe", "not UTF-8 text (byte 4)"),
    "a unit of other things": (
        "log.csv",
        "Hole Depth (feet),Rotary RPM (RPM),Weight on Bit (psi)\n1,2,3\n",
        'line 1, column Weight on Bit (psi): "psi" is not a unit of weight_on_bit',
    ),
    "columns that differ": (
        "log.csv",
        "Depth(ft),Depth(m),ROP(1 ft),ROP(1 m)\n1,1,9,9\n2,2,9,9\n",
        'line 1, column Depth(m): is 3.281 times column "Depth(ft)", which should be the same depth',
    ),
    "points and commas": ("log.csv", "WOB (kN);ROP (m/h)\n1,5;2.5\n", 'line 2: "1,5" is ambiguous'),
    "commas of thousands": ("log.csv", "WOB (kN);ROP (m/h)\n1,500;2,500\n", 'line 2: "1,500" is ambiguous'),
    "an open quote": ("log.csv", 'WOB (kN),ROP (m/h)\n"1,2\n', "line 2: not CSV"),
    "LAS without data": (
        "log.las",
        "~Version\nVERS. 2.0 :\n~Curve\nDEPT.M :\n",
        "not LAS 2.0: it has no section ~ASCII",
    ),
    "wrapped LAS": (
        "log.las",
        "~V\nVERS. 2.0 :\nWRAP. YES :\n~C\nDEPT.M :\n~A\n1\n",
        "line 1: its lines are wrapped (WRAP YES)",
    ),
    "LAS 3": ("log.las", "~V\nVERS. 3.0 :\nWRAP. NO :\n~C\nDEPT.M :\n~A\n1\n", "line 1: it is LAS 3; write LAS 2.0"),
    "a short row of LAS": (
        "log.las",
        "~V\nVERS. 2.0 :\nWRAP. NO :\n~C\nDEPT.M :\nROP.M/HR :\n~A\n1 2\n3\n",
        "line 9, from 3: has 1 cells; 2 are needed, one a curve",
    ),
    "LAS in name alone": ("log.las", "DEPT,ROP\n1,2\n", "not LAS 2.0: it has no section ~Version"),
    "no LAS header": ("log.las", "~V\nnonsense\n~C\nDEPT.M :\n~A\n1\n", "line 1: not LAS 2.0"),
}


@pytest.mark.parametrize("kind", list(FILES))
def test_bad_files_are_refused_in_one_line(tmp_path, kind):
    name, text, line = FILES[kind]
    (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError) as caught:
        read_log(tmp_path / name)
    assert line in str(caught.value) and "\n" not in str(caught.value)


def test_wrong_arguments_are_refused(logs):
    for fastest in ("fast", "500", "-1 m/h", "3 kN", "nan m/s"):
        with pytest.raises(InputError, match="is not a rate above 0 with its unit; write one, like 500 ft/h"):
            read_log(logs["pason"], fastest=fastest)
    with pytest.raises(InputError, match='"kN" is not a unit of rate_of_penetration'):
        read_log(logs["rigcloud"], units={"rate_of_penetration": "kN"})


def test_las_requires_lasio(logs, monkeypatch):
    monkeypatch.setitem(sys.modules, "lasio", None)
    with pytest.raises(InputError, match=r'lasio, which is not installed; pip install "vibrojax\[las\]"'):
        read_log(logs["las"])
