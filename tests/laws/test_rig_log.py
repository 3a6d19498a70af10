"""Test reading of rig logs: the same rows in the clothes of many exports, dropped rows, conditions, and refusals."""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from refusals import refusal

import vibrojax as vj
from vibrojax.errors import InputError
from vibrojax.io.riglog import log_lines, read_log, to_dataset

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[2] / "notebooks"))
import rig_logs

N = 60
DEPTH, WEIGHT = 1000 + 0.5 * np.arange(N), 40 + 90 * ((7 * np.arange(N)) % N) / N  # m, kN
RATE, SPEED = 6 + 22 * np.log(WEIGHT / 30), 90 + 5.5 * np.arange(N) % 30  # m/h, rpm
TORQUE, PRESSURE, FLOW = 6 + 0.04 * np.arange(N), 15 + 0.01 * np.arange(N), np.full(N, 3035.0)  # kN m, MPa, L/min
TONNE, KLBF, FOOT = 9.80665, 4.4482216152605, 0.3048
SI = {"depth": DEPTH, "weight_on_bit": 1e3 * WEIGHT, "rate_of_penetration": RATE / 3600}
SI |= {"rotary_speed": SPEED * np.pi / 30, "torque": 1e3 * TORQUE, "pressure": 1e6 * PRESSURE, "flow": FLOW / 6e4}
FOUR = DEPTH, RATE, WEIGHT, SPEED
METRIC = "DEPTH (m),ROP (m/h),WOB (kN),RPM (rpm)"


def lines_of(*columns, separator=","):
    rows = zip(*(np.broadcast_to(column, N) for column in columns), strict=True)
    return [separator.join(cell if isinstance(cell, str) else f"{cell:.12g}" for cell in row) for row in rows]


def csv(*head, columns=FOUR):
    return "\n".join([*head, *lines_of(*columns)]) + "\n"


def las(head, data, version="2.0", wrap="NO"):
    versions = f"~version\n VERS. {version} : CWLS\n WRAP. {wrap} : x\n~well\n NULL. -999.25 : null\n"
    return versions + head + "\n".join(data) + "\n"


def witsml(head, rows, more=""):
    name = 'xmlns="http://www.witsml.org/schemas/1series" version="1.4.1.1"'
    data = "\n".join(f"<data>{row}</data>" for row in rows)
    return f'<?xml version="1.0"?>\n<logs {name}><log>{more}<logData>\n{head}\n{data}\n</logData></log></logs>\n'


def wrapped(short, separator=" "):
    """Return a wrapped LAS file, in which some records have lost their last cell."""
    records = [line.split(" ")[: 3 + (k not in short)] for k, line in enumerate(lines_of(*FOUR, separator=" "))]
    lines = [f"{record[0]}\n{separator.join(record[1:])}" for record in records]
    return las(f"~C\n{CURVES.format('KN')}~A\n", lines, wrap="YES")


FIELD = (DEPTH / FOOT, RATE / FOOT, WEIGHT / KLBF, SPEED)
CURVES = " DEPT.M : depth\n ROP .M/HR : rate\n WOB .{} : weight\n RPM .RPM : rotary\n"
LISTS = "<mnemonicList>DEPTH,ROP,WOB,RPM</mnemonicList><unitList>m,m/h,kN,rpm</unitList>"
INFO = "<logCurveInfo><mnemonic>{}</mnemonic><unit>{}</unit></logCurveInfo>"
INFOS = "".join(INFO.format(*pair) for pair in (("DEPTH", "m"), ("ROP", "m/h"), ("WOB", "kN"), ("RPM", "rpm")))
WIDE = "TVD(ft),Depth (ft),ROP(ft/hr),WOB(KLb),RPM,Torque(lb.F),Stand Pipe Pressure(Psi),Flow In(GPM)"
IMPERIAL = TORQUE * 1e3 / FOOT / KLBF, PRESSURE * 1e6 / 6894.757293168362, FLOW / 3.785411784
CLOCK = [f"{(23 + (30 + k) // 60) % 24:02}:{(30 + k) % 60:02}:00" for k in range(N)]
VOLVE = "MD,TVD,RPMA,WOBA,MFIA,TQA,SPPA,ROPA", (DEPTH, DEPTH, SPEED, WEIGHT / TONNE, FLOW, TORQUE, 1e3 * PRESSURE, RATE)
SAID = {"weight_on_bit": "WOBA (t)", "torque": "TQA (kN m)", "pressure": "SPPA (kPa)", "flow": "MFIA (L/min)"}
SAID |= {"rate_of_penetration": "ROPA (m/h)"}
COMMAS = [line.replace(".", ",") for line in lines_of(*FOUR, FLOW, separator=";")]
FEET = "~CURVE\n DEPT.F :\n ROP .FT/HR :\n WOB .KLB :\n RPM .RPM :\n~A\n"
THREE = f"~Log_Definition\n{CURVES.format('KN')}~Log_Data | Log_Definition\n"
CLOTHES = {
    "clock.csv": csv(f"Time,{METRIC}", columns=(CLOCK, *FOUR)),
    "title-and-units.csv": csv("Well 5,,,", "", "DEPTH,ROP,WOB,RPM", "m,m/h,kN,rpm"),
    "klb.csv": csv(WIDE, columns=(DEPTH / FOOT, *FIELD, *IMPERIAL)),
    "named-volve.csv": csv(VOLVE[0], columns=VOLVE[1]),
    "commas.csv": "\n".join(["DEPTH (m);ROP (m/h);WOB (kN);RPM;Flow In (L/min)", *COMMAS]) + "\n",
    "feet.las": las(FEET, lines_of(*FIELD, separator=" ")),
    "wrapped.las": las(f"~Curve\n{CURVES.format('KN')}~A\n", lines_of(*FOUR, separator="\n"), wrap="YES"),
    "three.las": las(THREE, lines_of(*FOUR), "3.0", "NO : x\n DLM. COMMA"),
    "lists.xml": witsml(LISTS, lines_of(*FOUR)),
    "infos.xml": witsml("", lines_of(*FOUR), INFOS),
}


@pytest.mark.parametrize("name", list(CLOTHES))
def test_same_rows_in_other_clothes_are_the_same(tmp_path, name):
    text = CLOTHES[name]
    (tmp_path / name).write_text(text)
    log = read_log(tmp_path / name, columns=SAID if name == "named-volve.csv" else None)
    assert len(log) == N and not log.attrs["dropped"] and set(SI) & set(log) >= set(list(SI)[:4])
    for quantity in set(SI) & set(log):
        np.testing.assert_allclose(log[quantity], SI[quantity], rtol=1e-8, err_msg=quantity)
        assert log.attrs["units"][quantity]
    if name == "clock.csv":
        np.testing.assert_allclose(log.time, 60.0 * np.arange(N))  # past midnight
    if name.endswith(".csv"):
        assert log.line.iloc[-1] == text.count("\n")


def test_rows_of_shifted_cells_are_dropped(tmp_path):
    """With one cell on a line, nothing shows the four lost cells but the depth, which is a rate in these rows."""
    (tmp_path / "shifted.las").write_text(wrapped([2, 3, 4, 5], "\n"))
    log = read_log(tmp_path / "shifted.las")
    np.testing.assert_allclose(log.weight_on_bit, np.delete(SI["weight_on_bit"], [2, 3, 4, 5]))


def test_xlsx_is_read(tmp_path):
    pytest.importorskip("openpyxl")
    path = tmp_path / "log.xlsx"
    path.write_bytes(b"PK")
    assert "log.xlsx: cannot be read as xlsx" in refusal(read_log, path)
    pd.DataFrame(dict(zip(METRIC.split(","), FOUR, strict=True))).to_excel(path, index=False)
    np.testing.assert_allclose(read_log(path).weight_on_bit, SI["weight_on_bit"], rtol=1e-12)


def test_names_and_formats_of_exports_decide_how_cells_are_read():
    """Times name a format, names end in a unit, and a column that is not read shows that commas are decimal marks."""
    table = pd.DataFrame({"DATE (D-MMM-YYYY)": "4-May-2023", "TIME (HH:MM:SS)": CLOCK})
    for name, values in zip(("Teufe [m]", "ROP [m/h]", "WOB [kN]", "Bit RPM (rpm)"), FOUR, strict=True):
        table[name] = [f"{value:.3f}".replace(".", ",") for value in values]
    log = read_log(table, columns={"rotary_speed": "bit RPM"})
    for name in ("weight_on_bit", "rate_of_penetration", "rotary_speed"):
        np.testing.assert_allclose(log[name], SI[name], rtol=1e-3)
    np.testing.assert_allclose(log.time, 60.0 * np.arange(N))
    assert log.attrs["notes"][-1] == "columns without a known name, which --columns can give: Teufe [m]"
    with pytest.raises(InputError, match=r"like WOB \(kN\), above numbers only"):
        read_log(pd.DataFrame({"WOB": ["90 kN", "91 kN"], "ROP (m/h)": 20}))


REFUSED = {
    "bare.csv": (csv(VOLVE[0], columns=VOLVE[1]), 'weight_on_bit="WOBA .kN or klbf or t." .*pressure="SPPA .kPa."'),
    "cut.xml": (witsml(LISTS, lines_of(*FOUR))[:-30], r"not XML \(.*\); export the log again, or as CSV"),
    "bomb.xml": ('<?xml version="1.0"?><!DOCTYPE x><x/>', "defines entities, which are not read"),
    "short.las": (las(f"~C\n{CURVES.format('KN')}~A\n", ["1 2 3 4", "1 2 3"]), "line 13 has 3 cells; 4 are needed"),
    # In the last file, the lost cells add up to a whole record.
    "lost.las": (wrapped([2]), "line 16: the record that begins here has other than 4 cells"),
    "lost-four.las": (wrapped([2, 3, 4, 5]), "line 16: the record that begins here has other than 4 cells"),
    "cells.csv": ("DEPTH (m),ROP (m/h)\n1,2,3\n2,3\n4\n", "line 2 has 3 cells; line 4 has 1 cell; 2 are needed"),
    "bars.csv": ("WOB (kN)|ROP (m/h)\n100|20\n110|21\n", "no numbers in the first 3 lines; commas, semicolons or tabs"),
    "slow.csv": ("WOB (kN),ROP (min/ft)\n100,3\n110,2\n", '"min/ft" is a time per length; give the rate 1/x, in ft/'),
    "thousands.csv": ("WOB (kN);ROP (m/h)\n1,500;2,500\n", "commas are ambiguous: they may be"),
    "falling.csv": (csv(METRIC, columns=(DEPTH[::-1], *FOUR[1:])), r"line 3, column DEPTH \(m\): the depth falls in"),
}


@pytest.mark.parametrize("name", list(REFUSED))
def test_what_cannot_be_read_is_refused_in_one_line(tmp_path, name):
    text, line = REFUSED[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=line) as caught:
        read_log(tmp_path / name)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 1000


def test_bad_cells_are_listed_at_once_and_nulls_can_be_named(tmp_path):
    table = pd.DataFrame(dict(zip(METRIC.split(","), FOUR, strict=True))).astype(object)
    table.iloc[3, 1], table.iloc[5:20, 2] = "NULL", "absent"  # NULL is known
    with pytest.raises(InputError) as caught:
        read_log(table)
    line = str(caught.value)
    assert line.startswith('DataFrame: line 7, column WOB (kN): "absent"; line 8, ') and line.count("column") == 10
    assert "; and 5 more; 15 cells are not numbers" in line and line.endswith('--nulls "absent"')
    log = read_log(table, nulls=["Absent"])
    assert log.attrs["dropped"] == {"missing rate": 1, "missing weight": 15} and len(log) == 44
    assert log.attrs["lines"] == {"missing rate": "5", "missing weight": "7-21"}
    with pytest.raises(InputError, match=r"nulls: .* is not a list"):
        read_log(table, nulls="absent")


def test_columns_that_are_not_needed_never_stop_a_fit(tmp_path):
    """Neither thousands, words, nor units that are not known, in columns that the law does not use."""
    flow = [f'"{3 + k % 2},{k:03}"' for k in range(N)]
    text = csv(f"{METRIC},Flow In (L/min),SPPA,Torque (furlong),Time", columns=(*FOUR, flow, 15000, 6, "soon"))
    (tmp_path / "log.csv").write_text(text.replace("15000", "x", 1))
    fit = vj.fit_rop(tmp_path / "log.csv", progress=False)
    assert float(fit.C.sel(form="onset").item()) == pytest.approx(22 / 3600, rel=1e-6)
    assert 'line 2, column SPPA: "x"' in refusal(read_log, tmp_path / "log.csv")


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    return rig_logs.write_all(tmp_path_factory.mktemp("logs"))


@pytest.mark.parametrize("name", list(rig_logs.DIALECTS))
def test_traps_of_exports_are_dropped_with_their_reasons(logs, name):
    planted, (_, traps) = rig_logs.drilling(), rig_logs.with_traps(rig_logs.drilling())
    log = read_log(logs[name])
    assert log.attrs["dropped"] == traps and log.attrs["rows_read"] == len(planted["depth"]) + sum(traps.values())
    names = {"depth": "depth", "rate_of_penetration": "rate", "weight_on_bit": "weight"}
    for quantity, column in (names | {quantity: quantity for quantity in ("torque", "flow", "pressure")}).items():
        if quantity in log:
            np.testing.assert_allclose(log[quantity], planted[column], rtol=1e-12)
    np.testing.assert_allclose(log.rotary_speed, planted["rpm"] * 2 * np.pi / 60, rtol=1e-12)
    assert ("torque" in log) == (name != "pason-processed")  # the column is a pressure there
    lines = "\n".join(log_lines(to_dataset(log)))
    assert "dropped 6 of 406 rows" in lines and "missing weight: 2 (line" in lines
    assert name == "las" or set(log.Formation) == {"upper", "lower"}
    if "time" in log:
        np.testing.assert_allclose(log.time, 10.0 * (log.line - 2))


def test_values_beyond_reason_do_not_reach_a_fit():
    spike = 1000.0
    table = pd.DataFrame(dict(zip(METRIC.split(","), FOUR, strict=True)) | {"Torque (kN m)": TORQUE})
    table.loc[9, "WOB (kN)"], table.loc[7, "RPM (rpm)"], table.loc[5, "Torque (kN m)"] = spike, spike, spike
    log = read_log(table)
    assert log.attrs["dropped"] == {"weight beyond reason": 1, "rotation beyond reason": 1}
    assert np.isnan(log.torque).sum() == 1 and "torque: 1 value above 200000 N m taken as missing" in log.attrs["notes"]


def test_rows_off_bottom_and_depth_outliers_cost_only_themselves():
    depth, bit = DEPTH.copy(), DEPTH.copy()
    depth[4], bit[4], bit[5] = 9e4, 9e4, 0.0
    table = pd.DataFrame({"Hole Depth (m)": depth, "Bit Depth (m)": bit, "ROP (m/h)": RATE, "WOB (kN)": WEIGHT})
    log = read_log(table)
    assert log.attrs["lines"] == {"off bottom": "7", "depth not monotonic": "6"}


def test_conditions_choose_rows():
    names = ["Time (min)", *METRIC.split(","), "Gas (ppm)", "Formation"]
    columns = np.arange(N), *FOUR, np.arange(N), ["chalk", "shale"] * (N // 2)
    table = pd.DataFrame(dict(zip(names, columns, strict=True)))
    for where, kept in (
        ("weight_on_bit < 20 klbf", WEIGHT / KLBF < 20),
        (["depth (m) >= 1010", "depth < 1020"], (DEPTH >= 1010) & (DEPTH < 1020)),
        ("time (h) > 0.5", np.arange(N) > 30),
        ("Gas (ppm) > 30", np.arange(N) > 30),
        ({"Formation": "shale"}, np.arange(N) % 2 == 1),
        ("Formation != shale", np.arange(N) % 2 == 0),
    ):
        log = read_log(table, where=where)
        np.testing.assert_allclose(log.weight_on_bit, 1e3 * WEIGHT[kept])
        assert sum(log.attrs["dropped"].values()) == (~kept).sum()
    bare = read_log(table, where="WOB < 80")
    assert "WOB (kN) < 80: in kN, as the column" in bare.attrs["notes"] and "not WOB (kN) < 80" in bare.attrs["dropped"]
    fast = table.assign(**{"ROP (m/h)": 10 * RATE})
    assert read_log(fast).attrs["dropped"]["rate beyond reason"] > 30
    assert "rate beyond reason" not in read_log(fast, where="ROP < 400").attrs["dropped"]  # it replaces the limit
    for where, line in (
        ("WOB", 'where: "WOB" is no condition; write one, like "WOB'),
        ("WOB (psi) < 3", r'where WOB \(psi\) < 3: "3" does not suit weight_on_bit; write a number with a unit of N'),
        ("WOB (kN) < 20 klbf", "the unit is kN and klbf; give one of them"),
        ("WOB (kN) < 80,5", '"80,5" does not suit weight_on_bit'),
        ("Formation < 3", "texts are only compared by = or !="),
        ("Formation=Shale", 'no row of column Formation is "Shale"; it has chalk, shale$'),
    ):
        with pytest.raises(InputError, match=line):
            read_log(table, where=where)


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        (["0", "-999.25", "NULL", "30"], [0, np.nan, np.nan, 30]),
        (["-999.25", "10", "20", "30"], [np.nan, 0, 10, 20]),
        (["0,5", "1,5", "", "3"], [0, 1, np.nan, 2.5]),
        (["23:59:50", "null", "00:00:05", "00:00:06,0"], [0, np.nan, 15, np.nan]),
        (["59:50", "59:55", "60:00", "60:05"], [np.nan] * 4),  # minutes and seconds, or hours and minutes
        (["10:00", "10:01", "N/A", "10:03"], [0, 60, np.nan, 180]),
    ],
)
def test_times_with_missing_values_are_seconds_since_the_first(cells, expected):
    table = pd.DataFrame({"Time": cells, "WOB (kN)": ["100,5", "110,5", "120,5", "130,5"], "ROP (m/h)": 20})
    np.testing.assert_array_equal(read_log(table).time, expected)
