"""Test measures of rig logs: specific energies, known founder points, the stick-slip index, and the command."""

import numpy as np
import pytest
import xarray as xr

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.studies.rig_measures import FOUNDER_REASONS, founder_point, torque_stick_slip

HEADER = "YYYY/MM/DD,Depth (ft),WOB (klbf),ROP (ft/h),Rotary Speed (rpm),Torque (ft lbf)"


def _log(path, rows):
    path.write_text("\n".join([HEADER, *(",".join(["2026/01/02", *(f"{x:.8g}" for x in row)]) for row in rows)]) + "\n")
    return path


@pytest.fixture
def log(tmp_path):
    rng = np.random.default_rng(0)
    weight = rng.uniform(10, 40, 120)
    rate = 2.0 * np.minimum(weight, 25) + 0.2 * np.maximum(weight - 25, 0) + 0.3 * rng.standard_normal(120)
    rows = np.stack([1000 + np.arange(120), weight, rate, np.full(120, 100.0), np.full(120, 5000.0)], axis=1)
    return _log(tmp_path / "log.csv", rows), rows


def test_specific_energy_matches_teale_in_field_units(log):
    """Compare with 4 WOB/(pi D²) + 480 TOR RPM/(D² ROP) in psi, with lbf, ft lbf, ft/h and inches."""
    path, rows = log
    ds = vj.rig(path, columns={"bit_diameter": "8.5 in", "impact_power": "12 kW"})
    _, weight, rate, speed, torque = rows.T
    field = 4 * 1e3 * weight / (np.pi * 8.5**2) + 480 * torque * speed / (8.5**2 * rate)
    assert ds.specific_energy.values == pytest.approx(6894.757 * field, rel=1e-4)
    area = np.pi / 4 * (8.5 * 0.0254) ** 2
    assert ds.percussive_specific_energy.values == pytest.approx(12e3 / (area * rate * 0.3048 / 3600), rel=1e-6)
    assert float(ds.founder_weight) == pytest.approx(25e3 * 4.448222, rel=0.02)


def test_missing_quantities_are_noted(log):
    ds = vj.rig(log[0])
    assert np.isnan(ds.specific_energy).all()
    assert 'no bit_diameter, which columns may give, like bit_diameter="8.5 in"' in ds.attrs["notes"]


@pytest.mark.parametrize("correlation", [0.0, 0.8])
def test_straight_line_has_no_founder_point(correlation):
    rng, false_positives = np.random.default_rng(1), 0
    for _ in range(100):
        weight = rng.uniform(5e4, 2e5, 200)
        noise = rng.standard_normal(200)
        for k in range(1, 200):
            noise[k] = correlation * noise[k - 1] + np.sqrt(1 - correlation**2) * noise[k]
        false_positives += (
            FOUNDER_REASONS[founder_point(weight, 1e-8 * weight + 2e-4 * noise).founder_reason] == "found"
        )
    assert false_positives <= 5  # 1 % is expected, and only bends to a flatter slope count


def test_too_few_rows_have_no_founder_point():
    few = founder_point(np.linspace(1, 2, 5), np.linspace(1, 2, 5))
    assert FOUNDER_REASONS[few.founder_reason] == "too-few-rows" and np.isnan(few.founder_weight)
    missing = founder_point(np.full(50, np.nan), np.ones(50))
    assert FOUNDER_REASONS[missing.founder_reason] == "no-weight"


def test_stick_slip_of_a_sine_is_its_relative_amplitude():
    time = np.arange(0.0, 120.0, 0.5)
    index = torque_stick_slip(time, 5e3 * (1 + 0.3 * np.sin(2 * np.pi * time / 4)))
    assert index[60:-60] == pytest.approx(0.3, rel=2e-2)  # windows do not hold whole numbers of periods
    assert np.isnan(torque_stick_slip(10 * time, np.ones_like(time))).all()


def test_command_draws_log(log, tmp_path, capsys):
    out = tmp_path / "rig.nc"
    assert main(["rig", str(log[0]), "--columns", "bit_diameter=8.5 in", "-o", str(out), "--quiet"]) == 0
    assert isinstance(vj.open_dataset(out), xr.Dataset) and out.with_suffix(".png").exists()
    assert main(["info", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "founder point at a weight of" in printed and "not percussive data" in printed
