"""Test rig data with their own column names and units: conversion, refusals and warnings."""

import subprocess
import sys
import warnings

import numpy as np
import pytest
import xarray as xr

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.errors import InputError
from vibrojax.io.log_columns import read_columns, split_unit
from vibrojax.io.riglog import read_log
from vibrojax.physics.units import factor, is_unit
from vibrojax.studies.rop_law import fit_rop
from vibrojax.studies.rop_results import recommended, verdict

C, ETA0, D = 1.2e-3, 0.08, 150e3
FORCE = np.linspace(20e3, 60e3, 9)
RATE = C * np.log(FORCE / D / ETA0)


def rig(path, header, *columns):
    rows = zip(*(np.broadcast_to(column, RATE.shape) for column in columns), strict=True)
    path.write_text("\n".join([header, *(",".join(repr(float(cell)) for cell in row) for row in rows)]) + "\n")
    return path


def onset(path, **named):
    """Return C and eta0 of the onset form, which generated the data."""
    form = fit_rop(path, progress=False, **named).sel(form="onset")
    return float(form.C), float(form.eta0)


@pytest.mark.parametrize(
    ("header", "columns"),
    [
        ("ROP (m/h),WOB (kN)", {"rate_of_penetration": "ROP (m/h)", "mean_force": "WOB (kN)"}),
        ("ROP [m/h],WOB_kN", {"rate_of_penetration": "ROP (m/h)", "mean_force": "WOB (kN)"}),
        ("ROP,WOB", {"rate_of_penetration": "ROP (m/h)", "mean_force": "WOB [kN]"}),
        ("rop M/HR,Weight on bit [KN]", {"rate_of_penetration": "ROP", "mean_force": "weight on bit"}),
        ('ROP_m/h,"WOB, kN"', {"rate_of_penetration": "ROP", "mean_force": "WOB"}),
        ("rate_of_penetration (m/h),mean_force (kN)", {}),
    ],
)
def test_columns_with_any_names_are_converted(tmp_path, header, columns):
    path = rig(tmp_path / "rig.csv", header, 3600 * RATE, FORCE / 1e3)
    assert onset(path, columns={**columns, "threshold": "150 kN"}) == pytest.approx((C, ETA0), rel=1e-6)


def test_fit_prints_columns_and_units(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rig(tmp_path / "rig.csv", "ROP [m/h],WOB_kN,D", 3600 * RATE, FORCE / 1e3, D)
    words = ["rate_of_penetration=ROP (m/h)", "mean_force=WOB", "threshold=D"]
    for argv in (["fit", "rig.csv", "--columns", *words], ["fit", "--columns", *words, "rig.csv"]):
        assert main([*argv, "--fresh"]) == 0
        assert capsys.readouterr().out.splitlines()[:3] == [
            'rate_of_penetration: column "ROP [m/h]", in m/h',
            'mean_force: column "WOB_kN", in kN',
            'threshold: column "D", taken as N, since it names no unit',
        ]
    fit_rop("rig.csv", columns=read_columns(words))
    assert 'mean_force: column "WOB_kN", in kN' in capsys.readouterr().err


def test_parameters_are_converted_and_stay_coordinates(tmp_path):
    path = rig(tmp_path / "rig.csv", "ROP (m/h),P/D,k (MN/m)", 3600 * RATE, FORCE / D, 300.0)
    columns = {"rate_of_penetration": "ROP", "relief": "P/D", "k3": "k (MN/m)"}
    fit = fit_rop(path, along="k3", columns=columns, progress=False)
    assert float(fit.sel(form="onset").C.squeeze()) == pytest.approx(C, rel=1e-6)


@pytest.mark.parametrize(
    ("header", "columns", "line"),
    [
        (
            "ROP (m/h),WOB (kN)",
            {"rate_of_penetration": "ROP (kN)"},
            '"kN" is not a unit of rate_of_penetration; choose fr',
        ),
        ("ROP (m/h),WOB (kN)", {"rate_of_penetration": "ROP (m/s)"}, '"ROP (m/h)" is in m/h by its name, not in m/s'),
        (
            "ROP,WOB",
            {"rate_of_penetration": "ROP (mph)"},
            '"mph" is not a unit of rate_of_penetration; did you mean "m/h"?',
        ),
        ("ROP,WOB", {"mean_force": "WOB (mN)"}, '"mN" is not a unit of mean_force'),
        ("ROP,WOB", {"rate_of_penetration": "RPO (m/h)"}, 'the file has no column "RPO (m/h)"; did you mean "ROP"?'),
        ("ROP,ROP", {"rate_of_penetration": "ROP (m/h)"}, '"ROP (m/h)" may be "ROP", "ROP"; give each column a name'),
        ("ROP (m/h),ROP (ft/h)", {"rate_of_penetration": "ROP"}, '"ROP" may be "ROP (m/h)", "ROP (ft/h)"'),
        (
            "ROP,WOB",
            {"rop": "ROP (m/h)"},
            'columns: rop: is not a quantity of rig data; did you mean "rate_of_penetration"? choose from rate_of_p',
        ),
        ("ROP,WOB", {"relief": "ROP", "mean_force": "ROP"}, 'column "ROP" is relief already; give another'),
        ("ROP,WOB", {"threshold": "20,5 klbf"}, '"20,5 klbf" has a decimal comma; write a point, like "20.5 klbf"'),
        ("ROP,WOB", {"threshold": "-150 kN"}, "columns: threshold: is -150000; it must be at least 0 N"),
        ("ROP,WOB", {"threshold": "150 m/h"}, '"m/h" is not a unit of threshold'),
        ("ROP,WOB", {"relief": 3}, "columns: relief: 3 is not a column; write one with its unit"),
        (
            "ROP,rate_of_penetration",
            {"rate_of_penetration": "ROP"},
            "is another column rate_of_penetration; rename one of them",
        ),
        (
            "Rate (m/h),WOB",
            {},
            'missing; if "Rate (m/h)" is it, rename it, or name it: --columns rate_of_penetration=',
        ),
        (
            "ROP (m/h),Load_kN",
            {"rate_of_penetration": "ROP"},
            'mean_force [N] is missing, or relief; if "Load_kN" is it, rename it, or name it: --columns m',
        ),
        (
            "Rate (m/h),Load_kN",
            {"rate_of_penetration": "Rate", "mean_force": "Load"},
            'or for all rows: --columns threshold="150 kN", rock=granite or threshold=unknown',
        ),
    ],
)
def test_wrong_columns_are_refused_in_one_line(tmp_path, header, columns, line):
    path = rig(tmp_path / "rig.csv", header, RATE, FORCE)
    with pytest.raises(InputError) as caught:
        fit_rop(path, columns=columns, progress=False)
    assert "\n" not in str(caught.value) and line in str(caught.value)


def test_invalid_tables_are_refused(tmp_path):
    path = tmp_path / "rig.csv"
    columns = {"rate_of_penetration": "ROP (m/h)", "mean_force": "WOB (kN)", "threshold": "150 kN"}
    for text, line in (
        ("ROP,WOB\n", "no rows; add a line for each measurement"),
        ("", "empty; a line of column names"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match="rig") as caught:
            fit_rop(path, columns=columns)
        assert line in str(caught.value)
    with pytest.raises(InputError, match="fit_rop: has its names and units already"):
        fit_rop(xr.Dataset(), columns=columns)
    with pytest.raises(InputError, match="does not name columns; give a dict"):
        fit_rop(path, columns="ROP")


def test_wrong_words_of_command_are_refused_in_one_line(capsys):
    for argv, line in (
        (
            ["rig.csv", "--columns", "ROP"],
            '--columns: "ROP" is not NAME=COLUMN; write, for example, rate_of_penetration="ROP',
        ),
        (["rig.csv", "--columns", "a=b", "a=c"], '--columns: a: "c" is a second column; give one'),
    ):
        assert main(["fit", *argv]) == 2
        assert line in capsys.readouterr().err


def test_implausible_values_are_refused_or_warned_of_if_a_unit_is_given(tmp_path):
    path = rig(tmp_path / "rig.csv", "rate_of_penetration,mean_force,threshold", 3600 * RATE, FORCE, D)
    with pytest.raises(InputError, match=r"no unit is given, and the median is far .* m/s .*; likely --col") as caught:
        fit_rop(path, progress=False)
    assert str(caught.value).endswith(
        'rate_of_penetration="rate_of_penetration (m/h or ft/h or mm/s)" (choose one unit)'
    )
    with pytest.warns(vj.UnusualValue, match="m/s is far outside .* likely --columns .*m/h") as warned:
        fit_rop(path, columns={"rate_of_penetration": "rate_of_penetration (m/s)"}, progress=False)
    assert len(warned) == 1
    rig(path, "rate_of_penetration,mean_force,threshold", RATE, FORCE / 1e3, D / 1e3)
    with pytest.raises(InputError, match=r"median is far .*: mean_force .* threshold .* --columns mean_force=.*kN"):
        fit_rop(path, progress=False)
    rig(path, "rate_of_penetration,mean_force", RATE, FORCE)
    with pytest.raises(InputError, match=r"no unit is given.* 150 N .* --columns threshold=\"150 kN"):
        fit_rop(path, columns={"threshold": "150"}, progress=False)
    rig(path, "rate_of_penetration,mean_force,threshold", RATE, FORCE, D)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fit_rop(path, progress=False)


def test_decimal_commas_are_read_with_a_note(tmp_path):
    path = rig(tmp_path / "rig.csv", "ROP (m/h),WOB (kN)", 3600 * RATE, FORCE / 1e3)
    columns = {"rate_of_penetration": "ROP", "mean_force": "WOB", "threshold": "150 kN"}
    own = onset(path, columns=columns)
    path.write_text(path.read_text().replace(",", ";").replace(".", ","))
    assert onset(path, columns=columns) == own and "commas are decimal marks" in read_log(path).attrs["notes"]


def test_rock_gives_the_threshold(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = rig(tmp_path / "rig.csv", "rate_of_penetration,mean_force", RATE, FORCE)
    own = fit_rop(path, columns={"threshold": "204.5 kN"}, progress=False)  # Table 4.5
    xr.testing.assert_equal(fit_rop(path, columns={"rock": "granite"}, progress=False), own)
    assert main(["fit", "rig.csv", "--columns", "rock=granite"]) == 0
    assert "threshold: 204500 N for all rows" in capsys.readouterr().out
    for columns, line in (
        ({"rock": "granit"}, 'columns: rock: "granit" is not a rock of the source; did you mean "granite"?'),
        ({"rock": "granite", "threshold": "1 kN"}, "rock: gives the threshold, and threshold is given too"),
    ):
        with pytest.raises(InputError) as caught:
            fit_rop(path, columns=columns, progress=False)
        assert line in str(caught.value)


def test_recommended_constant_is_also_in_unit_of_data(tmp_path):
    noisy = RATE * (1 + 0.02 * np.cos(7 * np.arange(RATE.size)))
    path = rig(tmp_path / "rig.csv", "ROP (ft/h),mean_force", noisy * 3600 / 0.3048, FORCE)
    fit = fit_rop(path, columns={"rate_of_penetration": "ROP", "threshold": "150 kN"}, progress=False)
    [choice] = recommended(fit)
    assert choice["form"] == "onset" and choice["unit"] == "ft/h" and choice["low"] < C < choice["high"]
    for name, value in choice["in_unit"].items():
        assert value == pytest.approx(choice[name] * 3600 / 0.3048, rel=1e-12)
    assert (
        f"C = {choice['C']:.4g} m/s (" in verdict(fit)[-1] and f"{choice['in_unit']['C']:.4g} ft/h" in verdict(fit)[-1]
    )


def test_unit_factors():
    assert factor("m/h", "m s-1") * 3600 == factor("m/s", "m s-1") == factor("m s-1", "m s-1") == 1.0
    assert factor("ft/hr", "m s-1") == pytest.approx(0.3048 / 3600)
    assert factor("klbf", "N") == pytest.approx(4448.2216)  # of 9.80665 m/s2 and 0.45359237 kg
    assert factor("t", "N") == pytest.approx(9806.65) and factor("t", "kg") == 1000.0
    assert factor("KN", "N") == 1e3 and factor("MN", "N") == 1e6 and factor("mN", "N") is None
    assert factor("lb", "N") == pytest.approx(4.4482216) and factor("kN", "kg") is None  # a weight, not a mass
    assert factor("rpm", "s-1") == factor("1/min", "s-1") and factor("rad/s", "min-1") == pytest.approx(30 / np.pi)
    assert factor("µm", "m") == 1e-6 and factor("kN*s/m", "N s m-1") == 1e3 and factor("cm/s2", "m s-2") == 1e-2
    assert not any(is_unit(text) for text in ("point", "bit", "3 m", "9**9**9**9", "m/", "", "mph"))
    spelt = {"F": "m", "METRES": "m", "METERS": "m", "MTS": "m", "lbf-ft": "N m", "lb.ft": "N m", "ft.lbs": "N m"}
    spelt |= {"daN.m": "N m", "kgf.m": "N m", "klbf": "N", "1000 lbf": "N", "MT": "N", "tonne": "N", "KLb": "N"}
    spelt |= {"c/min": "rad s-1", "tr/min": "rad s-1", "rev/min": "rad s-1", "galUS/min": "m3 s-1", "lb.F": "N m"}
    assert [unit for unit, si in spelt.items() if factor(unit, si) is None] == []
    assert factor("lb.ft", "N m") == pytest.approx(1.3558179483314) == factor("lbf-ft", "N m") == factor("lb.F", "N m")
    assert factor("1000 lbf", "N") == factor("klbf", "N") and factor("daN.m", "N m") == 10
    assert factor("kN/" * 700 + "m", "N") is None and factor("lbf", "N m") is None
    assert split_unit("ROP (m/h)") == ("ROP", "m/h") and split_unit("WOB (mean) [kN]") == ("WOB (mean)", "kN")
    assert split_unit("rate_of_penetration") == ("rate_of_penetration", None) and split_unit("x_1") == ("x_1", None)


def test_units_are_imported_only_to_parse_them():
    code = "import sys, vibrojax as vj; vj.fit_rop; vj.read_sweep('regime-map'); print('pint' in sys.modules)"
    completed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert completed.stdout == "False\n", completed.stderr


# regressions


def groups_of_points(**coordinates):
    relief = np.linspace(0.2, 1.0, 8)
    rates = {"rate_of_penetration": (("start", "point"), np.stack([C * np.log(relief / ETA0)] * 2)), "relief": relief}
    rates["relief"] = ("point", relief)
    return xr.Dataset(rates, {"point": np.arange(8), "start": ["drive", "stuck"]} | coordinates)


def test_points_without_parameters_are_fitted_but_not_drawn(tmp_path, monkeypatch, capsys):
    with pytest.raises(InputError, match="nothing to draw over: no parameter varies along the 8 points"):
        vj.picture(fit_rop(groups_of_points(), along="start", progress=False))
    monkeypatch.chdir(tmp_path)
    vj.write_dataset(groups_of_points().assign_attrs(source="vibrojax 0"), "points.nc")
    assert main(["fit", "points.nc", "--along", "start"]) == 0
    captured = capsys.readouterr()
    assert captured.out.endswith("points-fit.nc\n")
    assert captured.err == "no picture: nothing to draw over: no parameter varies along the 8 points\n"
