"""The rate of penetration in the summary of a sweep, or why there is none."""

import json

import numpy as np
import pytest
import xarray as xr

import vibrojax as vj
from vibrojax.analyses.summary import summarise
from vibrojax.cli import main

PENETRATION = {"scene": "penetration", "run": {"settle": 0.5, "observe": 0.5}}


def part(ds):
    [rates] = [part for part in summarise(ds) if part.name == "rates"]
    return rates.lines, dict(rates.facts).get("rates")


def test_the_rate_its_greatest_place_and_the_lanes_without(tmp_path, capsys):
    """Of pulses below D nothing penetrates; the rate is in proportion to their frequency."""
    axes = {"force": [30e3, 300e3], "frequency": [10.0, 20.0]}
    ds = vj.run_sweep({**PENETRATION, "grid": axes}, progress=False)
    lines, facts = part(ds)
    least, most = (ds.rate_of_penetration.sel(force=300e3, frequency=f).item() for f in (10.0, 20.0))
    assert most == pytest.approx(2 * least, rel=1e-6)
    assert lines == [
        f"{least:.4g} to {most:.4g} m/s ({3600 * least:.4g} to {3600 * most:.4g} m/h) in 2 of 4 lanes",
        "largest at force=300000 frequency=20",
        "without a rate, the largest peak force of the pulses is 30 kN, 0.2 of the threshold D",
        "a softer rock (lower threshold) or a larger force can give a rate",
    ]
    assert facts == {"lanes": 2, "least": least, "greatest": most, "peak_over_threshold": pytest.approx(0.2)}
    vj.write_dataset(ds, tmp_path / "pen.nc")
    assert main(["info", str(tmp_path / "pen.nc"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rates"]["lanes"] == 2


def drilling(rate, peak, **more):
    variables = {"rate_of_penetration": (("v", "rock"), rate), "peak_impact_force": (("v", "rock"), peak)}
    axes = {"v": [1.0, 2.0], "rock": ["sandstone", "granite"]}
    return xr.Dataset(
        variables, axes | more, {"source": "vibrojax 0", "kind": "sweep", "title": "t", "parameters": "{}"}
    )


@pytest.mark.parametrize(
    ("rate", "peak", "lines"),
    [
        (
            [[0.0, 0.0], [0.0, 0.0]],
            [[30.95e3, 40.9e3], [np.nan, 20e3]],  # 61.9 kN and 204.5 kN, Table 4.5
            [
                "none: the hole does not grow in any of 4 lanes",
                "lanes without impacts: 1",
                "without a rate, the largest peak contact force is 30.95 kN, 0.5 of the threshold D",
                "a softer rock (lower threshold) or harder impacts (another v, beta, gamma or delta) can give a rate",
            ],
        ),
        (
            [[1e-3, 1e-3], [2e-3, 3e-3]],
            [[9e4] * 2] * 2,
            ["0.001 to 0.003 m/s (3.6 to 10.8 m/h) in 4 of 4 lanes", "largest at v=2 rock=granite"],
        ),
        (
            [[np.nan, np.nan], [0.0, np.nan]],
            [[np.nan] * 2] * 2,
            ["none: the hole does not grow in any of 4 lanes", "lanes without impacts: 4"],
        ),
    ],
)
def test_the_reason_is_the_peak_contact_force_over_the_threshold(rate, peak, lines):
    assert part(drilling(rate, peak))[0] == lines


def test_a_sweep_without_rock_has_no_rates():
    ds = xr.Dataset({"period": ("v", [1.0])}, {"v": [1.0]}, {"source": "vibrojax 0", "kind": "sweep"})
    assert part(ds) == ([], None)
