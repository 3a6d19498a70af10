"""Test measures of rig logs: specific energies, known founder points, the stick-slip index, and the command."""

import numpy as np
import pandas as pd
import pytest
from drawn import sheet_of

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.studies.rig_analysis import torque_stick_slip

HEADER = "YYYY/MM/DD,Depth (ft),WOB (klbf),ROP (ft/h),Rotary Speed (rpm),Torque (ft lbf)"


@pytest.fixture
def log(tmp_path):
    rng = np.random.default_rng(0)
    weight = rng.uniform(10, 40, 120)
    rate = 2.0 * np.minimum(weight, 25) + 0.2 * np.maximum(weight - 25, 0) + 0.3 * rng.standard_normal(120)
    rows = np.stack([1000 + np.arange(120), weight, rate, np.full(120, 100.0), np.full(120, 5000.0)], axis=1)
    lines = [",".join(["2026/01/02", *(f"{x:.8g}" for x in row)]) for row in rows]
    (tmp_path / "log.csv").write_text("\n".join([HEADER, *lines, ""]))
    return tmp_path / "log.csv", rows


def test_specific_energy_matches_teale_in_field_units(log):
    """Compare with 4 WOB/(pi D²) + 480 TOR RPM/(D² ROP) in psi, with lbf, ft lbf, ft/h and inches."""
    path, rows = log
    ds = vj.rig(path, columns={"bit_diameter": "8.5 in", "impact_power": "12 kW"})
    _, weight, rate, speed, torque = rows.T
    assert not any("together" in note for note in ds.attrs["notes"].split("; "))
    mixed = vj.rig(pd.read_csv(path).assign(Formation=["a b", "c"] * 60))
    assert 'all 2 values of Formation together: --where Formation="a b" keeps one' in mixed.attrs["notes"]
    field = 4 * 1e3 * weight / (np.pi * 8.5**2) + 480 * torque * speed / (8.5**2 * rate)
    assert ds.specific_energy.values == pytest.approx(6894.757 * field, rel=1e-4)
    area = np.pi / 4 * (8.5 * 0.0254) ** 2
    assert ds.percussive_specific_energy.values == pytest.approx(12e3 / (area * rate * 0.3048 / 3600), rel=1e-6)


def test_stick_slip_of_a_sine_is_its_relative_amplitude():
    time = np.arange(0.0, 120.0, 0.5)
    index = torque_stick_slip(time, 5e3 * (1 + 0.3 * np.sin(2 * np.pi * time / 4)))
    assert index[60:-60] == pytest.approx(0.3, rel=2e-2)  # windows do not hold whole numbers of periods
    assert np.isnan(torque_stick_slip(10 * time, np.ones_like(time))).all()


def test_command_draws_tracks_and_tells_the_planted_founder_point(log, tmp_path, capsys):
    out = tmp_path / "rig.nc"
    assert main(["rig", str(log[0]), "--columns", "bit_diameter=8.5 in", "-o", str(out), "--quiet"]) == 0
    ds = vj.open_dataset(out)
    assert ds.sizes["row"] == 120 and out.with_suffix(".png").exists()
    assert float(ds.founder_weight) == pytest.approx(25 * 4448.2216, rel=0.05)
    assert abs(float(ds.slope_above)) < 0.2 * float(ds.slope_below)
    for units, labels in (("driller", "[m/h] [kN] [rpm] [kN m] [MPa]"), ("si", "[m/s] [N] [rad/s] [N m] [J/m³]")):
        tracks = sheet_of(ds.assign_attrs(drawn_in=units)).plots[1:]
        assert " ".join(track.x.label.split("\n")[0].strip() for track in tracks) == labels
        assert all(track.y.reversed and track.y.label == "depth [m]" for track in tracks)  # depth grows downwards
    assert main(["info", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "founder point" in printed and "not percussive data" in printed
    for command in ("rig", "fit"):
        assert main([command, str(log[0]), "-o", str(out)]) == 2
        assert "rig.nc: holds another result: " in capsys.readouterr().err
