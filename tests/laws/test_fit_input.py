"""Test the input of a fit: datasets, columns with their own names and units, the command, and refusals."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from refusals import command_refusal, refusal

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.io.dataset import open_dataset
from vibrojax.io.log_columns import split_unit
from vibrojax.io.writers import write_dataset
from vibrojax.physics.units import factor, is_unit
from vibrojax.studies.rop_law import fit_rop
from vibrojax.studies.rop_results import tables

C, ETA0 = 1.3e-3, 0.21
RELIEF = np.linspace(0.25, 1.5, 8)
RATE = C * np.log(RELIEF / ETA0)


def sweep(**more):
    """Return a dataset like that of a penetration sweep, with a rate of the onset form along frequency."""
    force = np.array([2e5, 3e5])
    values = {"rate_of_penetration": np.outer([1.0, 2.0], RATE), "relief": np.stack([RELIEF, RELIEF])}
    values |= {"status": np.zeros((2, 8), np.int8)}
    variables = {name: (("force", "frequency"), x) for name, x in values.items()}
    coordinates = {"force": ("force", force, {"units": "N"}), "frequency": np.linspace(10, 40, 8), "k3": 3e8}
    attributes = {"source": "vibrojax 0", "title": "a sweep", "scene": "penetration", "history": "made"}
    return xr.Dataset(variables, coordinates, attributes).assign(**more)


def test_wrong_data_are_refused():
    for data, named, line in (
        (sweep().drop_vars("relief"), {}, "fit_rop: relief: missing; a sweep of a scene with rock has it, this holds"),
        (sweep(), {"along": "frequncy"}, 'along: "frequncy" is not an axis of the data; did you mean "frequency"?'),
        (sweep().isel(force=0, frequency=0), {}, "along: there is one lane only; a law needs an axis of several"),
        (sweep(), {"where": "force > 250 kN"}, "fit_rop: `where` is for a rig log; select lanes of a dataset by"),
        (3, {}, "fit_rop: 3 is not data; give a dataset or a path"),
    ):
        assert line in refusal(fit_rop, data, **named)


def test_datasets_are_converted_from_the_units_that_they_state():
    """The law is the same whatever units the dataset is in."""
    fit, own = fit_rop(sweep()), sweep()
    for name, scale, unit in (("rate_of_penetration", 3600.0, "m/h"), ("relief", 100.0, "%")):
        own[name] = (scale * own[name]).assign_attrs(units=unit)
    names = ["C", "eta0", "data_relief", "data_rate_of_penetration"]
    xr.testing.assert_allclose(fit_rop(own)[names], fit[names], rtol=1e-9)
    own.relief.attrs["units"] = "kN"
    assert refusal(fit_rop, own) == 'fit_rop: relief: is in "kN"; a unit of 1 is needed'


def test_columns_define_groups(tmp_path):
    """The rows have two forces and rocks in unequal numbers. Each group gives the same fit as alone."""
    path = tmp_path / "rig.csv"
    lines = [f"{f:.17g},{e:.17g},{r:.17g},granite,1e5" for f, e, r in zip(range(8), RELIEF, RATE, strict=True)]
    lines += [f"{f},{e:.17g},{2 * r:.17g},chalk,2e5" for f, e, r in zip(range(6), RELIEF, RATE, strict=False)]
    lines.insert(3, "9,0.5,nan,granite,1e5")
    path.write_text("frequency,relief,rate_of_penetration,rock,force\n" + "\n".join(lines) + "\n")
    for named in ({"along": "frequency"}, {"by": ("rock", "force")}, {"by": "rock"}):
        fit = fit_rop(path, progress=False, **named).sel(form="onset")
        assert fit.C.sizes == {"group": 2} and list(fit.rock.values) == ["chalk", "granite"]
        assert list(fit.used.values) == [6, 8] and list(fit.left_out.values) == [0, 1]
        np.testing.assert_allclose(fit.C, [2 * C, C], rtol=1e-10)
    assert "rock=chalk, force=200000" in "\n".join(tables(fit_rop(path, "frequency", progress=False)))
    assert fit_rop(path, progress=False).sel(form="onset").used.item() == 14
    assert 'by: "rok" is not a column of the data; did you mean "rock"?' in refusal(fit_rop, path, by="rok")
    assert 'by: "force" is not a column of the data: the data are not a table' in refusal(fit_rop, sweep(), by="force")


D, ONSET = 150e3, 0.08
FORCE = np.linspace(20e3, 60e3, 9)
RATES = C * np.log(FORCE / D / ONSET)


def rig(path, header, *columns):
    rows = zip(*(np.broadcast_to(column, RATES.shape) for column in columns), strict=True)
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
        ("ROP,WOB", {"rate_of_penetration": "ROP (m/h)", "mean_force": "WOB [kN]"}),
        ('ROP_m/h,"WOB, kN"', {"rate_of_penetration": "ROP", "mean_force": "WOB"}),
        ("rate_of_penetration (m/h),mean_force (kN)", {}),
    ],
)
def test_columns_with_any_names_are_converted(tmp_path, header, columns):
    path = rig(tmp_path / "rig.csv", header, 3600 * RATES, FORCE / 1e3)
    assert onset(path, columns={**columns, "threshold": "150 kN"}) == pytest.approx((C, ONSET), rel=1e-6)


@pytest.mark.parametrize(
    ("header", "columns", "line"),
    [
        ("ROP,WOB", {"mean_force": "WOB (mN)"}, '"mN" is not a unit of mean_force'),
        ("ROP,WOB", {"rate_of_penetration": "RPO (m/h)"}, 'the file has no column "RPO (m/h)"; did you mean "ROP"?'),
        ("ROP,WOB", {"threshold": "20,5 klbf"}, '"20,5 klbf" has a decimal comma; write a point, like "20.5 klbf"'),
        ("ROP,WOB", {"wob": "WOB"}, 'wob: is not a quantity of rig data; did you mean "weight_on_bit"? choose from'),
        ("Rate (m/h),WOB", {}, 'missing; if "Rate (m/h)" is it, name it with its unit: --columns rate_of_penetration='),
    ],
)
def test_wrong_columns_are_refused_in_one_line(tmp_path, header, columns, line):
    path = rig(tmp_path / "rig.csv", header, RATES, FORCE)
    assert line in refusal(fit_rop, path, columns=columns, progress=False)


def test_implausible_values_are_refused_or_warned_of_if_a_unit_is_given(tmp_path):
    path = rig(tmp_path / "rig.csv", "rate_of_penetration,mean_force,threshold", 3600 * RATES, FORCE, D)
    line = refusal(fit_rop, path, progress=False)
    assert "no unit is given, and the median is far " in line and "; likely --col" in line
    assert line.endswith('rate_of_penetration="rate_of_penetration (m/h or ft/h or mm/s)" (choose one unit)')
    with pytest.warns(vj.UnusualValue, match="m/s is far outside .* likely --columns .*m/h") as warned:
        fit_rop(path, columns={"rate_of_penetration": "rate_of_penetration (m/s)"}, progress=False)
    assert len(warned) == 1
    # Of kN called t, those beyond reason would be dropped in silence.
    tonnes = rig(tmp_path / "t.csv", "ROP (m/h),WOB (t)", 3600 * RATES, 100 * FORCE / np.median(FORCE))
    with pytest.warns(vj.UnusualValue, match="980665 N is far .* likely --columns weight_on_bit="):
        fit_rop(tonnes, columns={"threshold": "20 kN"}, progress=False)


def test_rock_gives_the_threshold(tmp_path):
    path = rig(tmp_path / "rig.csv", "rate_of_penetration,mean_force", RATES, FORCE)
    own = fit_rop(path, columns={"threshold": "204.5 kN"}, progress=False)  # Table 4.5
    xr.testing.assert_equal(fit_rop(path, columns={"rock": "granite"}, progress=False), own)
    line = refusal(fit_rop, path, columns={"rock": "granite", "threshold": "1 kN"})
    assert "rock: gives the threshold, and threshold is given too" in line


def test_unit_factors():
    assert factor("m/h", "m s-1") * 3600 == factor("m/s", "m s-1") == factor("m s-1", "m s-1") == 1.0
    assert factor("ft/hr", "m s-1") == pytest.approx(0.3048 / 3600)
    assert factor("klbf", "N") == pytest.approx(4448.2216)  # of 9.80665 m/s2 and 0.45359237 kg
    assert factor("t", "N") == pytest.approx(9806.65) and factor("t", "kg") == 1000.0
    assert factor("KN", "N") == 1e3 and factor("MN", "N") == 1e6 and factor("mN", "N") is None
    assert factor("kN", "kg") is None  # a weight, not a mass
    assert factor("rpm", "s-1") == factor("1/min", "s-1") and factor("rad/s", "min-1") == pytest.approx(30 / np.pi)
    assert not any(is_unit(text) for text in ("point", "bit", "3 m", "9**9**9**9", "m/", "", "mph"))
    spelt = {"F": "m", "METRES": "m", "METERS": "m", "MTS": "m", "lbf-ft": "N m", "lb.ft": "N m", "ft.lbs": "N m"}
    spelt |= {"daN.m": "N m", "kgf.m": "N m", "klbf": "N", "1000 lbf": "N", "MT": "N", "tonne": "N", "KLb": "N"}
    spelt |= {"c/min": "rad s-1", "tr/min": "rad s-1", "rev/min": "rad s-1", "galUS/min": "m3 s-1", "lb.F": "N m"}
    assert [unit for unit, si in spelt.items() if factor(unit, si) is None] == []
    assert factor("lb.ft", "N m") == pytest.approx(1.3558179483314) == factor("lbf-ft", "N m") == factor("lb.F", "N m")
    assert factor("1000 lbf", "N") == factor("klbf", "N") and factor("kN/" * 700 + "m", "N") is None
    assert split_unit("ROP (m/h)") == ("ROP", "m/h") and split_unit("WOB (mean) [kN]") == ("WOB (mean)", "kN")
    assert split_unit("rate_of_penetration") == ("rate_of_penetration", None) and split_unit("x_1") == ("x_1", None)


def test_command_prints_tables_and_writes_fit(here, capsys):
    write_dataset(sweep(), "map.nc")
    assert main(["fit", "map.nc"]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] == "force=200000 N: 8 lanes along frequency"
    assert printed[1].split() == ["form", "C", "[m/s]", "η₀", "exponent", "n", "R2", "AIC"]
    assert printed[4].startswith("  onset") and "0.0013 ± " in printed[4]
    assert "the log law is not rejected in 2 of 2, as onset in 2" in printed
    assert printed[-3] == "  force=200000 N: C = 0.0013 m/s (0.0013 to 0.0013), onset"
    assert printed[-1] == "map-fit.nc; picture map-fit.png"
    stored = open_dataset("map-fit.nc")
    xr.testing.assert_allclose(stored, fit_rop("map.nc", progress=False))
    assert main(["info", "map-fit.nc"]) == 0
    assert "a sweep" in capsys.readouterr().out


def test_fit_without_penetration_is_refused(here, capsys):
    write_dataset(sweep(rate_of_penetration=(("force", "frequency"), np.zeros((2, 8)))), "map.nc")
    reason = "map.nc: nothing penetrates in any of 16 lanes, so there is no rate to fit"
    advice = "vibrojax info map.nc says what would give a rate"
    assert command_refusal(capsys, "fit", "map.nc") == f"{reason}; {advice}" and not Path("map-fit.nc").exists()
