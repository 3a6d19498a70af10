"""Test rig data with their own column names and units: conversion, refusals and warnings."""

import warnings

import numpy as np
import pytest
import xarray as xr

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.errors import InputError
from vibrojax.io.log_columns import KNOWN, LAW, RIG, split_unit
from vibrojax.physics.units import factor, is_unit
from vibrojax.studies.rop_law import fit_rop

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
        ("ROP,WOB", {"mean_force": "WOB (mN)"}, '"mN" is not a unit of mean_force'),
        ("ROP,WOB", {"rate_of_penetration": "RPO (m/h)"}, 'the file has no column "RPO (m/h)"; did you mean "ROP"?'),
        ("ROP,WOB", {"threshold": "20,5 klbf"}, '"20,5 klbf" has a decimal comma; write a point, like "20.5 klbf"'),
        ("ROP,WOB", {"threshold": "150 m/h"}, '"m/h" is not a unit of threshold'),
        (
            "ROP,WOB",
            {"wob": "WOB"},
            'wob: is not a quantity of rig data; did you mean "weight_on_bit"? choose from rate_of_penetration, '
            f"relief, mean_force, threshold, rock, {', '.join([*RIG, *(x for x in KNOWN if x not in LAW | RIG)])}",
        ),
        ("Rate (m/h),WOB", {}, 'missing; if "Rate (m/h)" is it, rename it, or name it: --columns rate_of_penetration='),
    ],
)
def test_wrong_columns_are_refused_in_one_line(tmp_path, header, columns, line):
    path = rig(tmp_path / "rig.csv", header, RATE, FORCE)
    with pytest.raises(InputError) as caught:
        fit_rop(path, columns=columns, progress=False)
    assert "\n" not in str(caught.value) and line in str(caught.value)


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
