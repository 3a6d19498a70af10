"""Tests of hidden motions: if starts end in different motions with one label, dataset and map mark it."""

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.errors import counted
from vibrojax.measures.labels import SINGLE_IMPACT, hides_another
from vibrojax.studies.choose import picture
from vibrojax.studies.summary import summarise, summary_lines

STARTS = ["drive", "stuck", "touching"]


def hidden(velocity, error=1e-6, regime=SINGLE_IMPACT, cycles=1):
    lanes = np.size(velocity)
    features = {"impact_velocity": np.array(velocity, float), "cycles": np.full(lanes, cycles)}
    features["error_estimate"] = np.full(lanes, error)
    return hides_another(features, np.full(lanes, regime, np.int8), lanes).tolist()


def test_rule():
    assert hidden([0.67, 3.03, 0.67]) == [1, 1, 1]  # each lane differs from another one
    assert hidden([0.67, 0.675]) == [0, 0]  # one motion, equal to 1 %
    assert hidden([0.67, 0.69]) == [1, 1]
    assert hidden([0.67, 0.69], error=0.05) == [0, 0] and hidden([0.67, 3.0], error=np.inf) == [0, 0]
    assert hidden([0.67, 3.03], cycles=0) == [0, 0]  # irregular lanes have no motion to compare
    assert hidden([np.nan, np.nan]) == [0, 0]
    features = {
        "impact_velocity": np.array([0.67, 3.03, 1.0, 1.0]),
        "cycles": np.ones(4),
        "error_estimate": np.zeros(4),
    }
    labels = np.array([3, 5, 3, 3], np.int8)
    assert hides_another(features, labels, 2).tolist() == [0, 0, 0, 0]  # the labels differ already


@pytest.fixture(scope="module")
def swept():
    grid = {"beta": [0.4, 0.5], "gamma": [0.6, 0.9]}
    return vj.run_sweep(
        {"scene": "vibro-impact", "starts": STARTS, "parameters": {"delta": 0.0}, "grid": grid}, progress=False
    )


def test_three_starts_have_one_label(swept):
    """A plain map would hide this case: 0.67, 3.03 and 0.67 m/s, all of them single impacts."""
    point = swept.sel(beta=0.4, gamma=0.6)
    assert (point.regime == SINGLE_IMPACT).all()
    np.testing.assert_allclose(point.impact_velocity, [0.67, 3.03, 0.67], atol=0.01)
    assert (point.hidden_motion == 1).all()
    points = int(swept.hidden_motion.any("start").sum())
    assert summary_lines(summarise(swept.isel(start=0)))
    assert f"at {counted(points, 'point')} starts end in different motions under one label" in "\n".join(
        summary_lines(summarise(swept))
    )


def test_map_marks_hidden_motions(swept):
    figure = picture(swept)
    panels = [axes for axes in figure.axes if axes.get_title().startswith("start:")]
    for axes, start in zip(panels, STARTS, strict=True):
        marks = next(line for line in axes.lines if line.get_marker() == "o")
        beta, gamma = np.nonzero(swept.hidden_motion.sel(start=start).values)
        expected = sorted(zip(swept.gamma.values[gamma], swept.beta.values[beta], strict=True))
        assert sorted(map(tuple, marks.get_xydata().tolist())) == expected
    labels = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert "same label, other motion\nfrom another start" in labels
