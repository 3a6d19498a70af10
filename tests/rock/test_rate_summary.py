"""Test the rate of penetration in the summary of a sweep, or the reason why there is none."""

import json

import pytest

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.studies.summary import summarise

PENETRATION = {"scene": "penetration", "run": {"settle": 0.5, "observe": 0.5}}

BELOW_D = "without a rate, the rock force never reaches the threshold D, at which the rock yields"


def rate_part(ds):
    [rates] = [section for section in summarise(ds) if section.name == "rates"]
    return rates.lines, dict(rates.facts).get("rates")


def test_summary_lists_range_maximum_and_lanes_without_rate(tmp_path, capsys):
    """Pulses below D do not penetrate. The rate is proportional to the frequency of the pulses."""
    axes = {"force": [30e3, 300e3], "frequency": [10.0, 20.0]}
    ds = vj.run_sweep({**PENETRATION, "grid": axes}, progress=False)
    lines, facts = rate_part(ds)
    least, most = (ds.rate_of_penetration.sel(force=300e3, frequency=f).item() for f in (10.0, 20.0))
    assert most == pytest.approx(2 * least, rel=1e-6)
    assert lines == [
        f"{least:.4g} to {most:.4g} m/s ({3600 * least:.4g} to {3600 * most:.4g} m/h) in 2 of 4 lanes",
        "largest at force=300000 frequency=20",
        BELOW_D,
        "the largest force of the pulses there is 30 kN, 0.2 of D; the inertia of the bit takes a part of it",
        "a softer rock (lower threshold) or a larger force can give a rate",
    ]
    assert facts == {"lanes": 2, "least": least, "greatest": most, "peak_over_threshold": pytest.approx(0.2)}
    vj.write_dataset(ds, tmp_path / "pen.nc")
    assert main(["info", str(tmp_path / "pen.nc"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rates"]["lanes"] == 2
