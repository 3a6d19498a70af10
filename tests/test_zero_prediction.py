"""Test the prediction of zeros: exact for lines and square roots, convergent for curves."""

import numpy as np
import pytest

from vibrojax.periodic.brackets import predict_zero, push_history

ZERO = 0.3


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("power", [1.0, 0.5])
def test_lines_and_square_roots_are_predicted_exactly(power, sign):
    positions = ZERO + sign * np.array([[0.1, 0.4, 0.7]])
    zero, uncertainty = predict_zero(positions, 2.5 * np.abs(positions - ZERO) ** power)
    assert abs(zero[0] - ZERO) < 1e-14 and uncertainty[0] < 1e-14


def test_two_points_give_line_with_large_uncertainty():
    zero, uncertainty = predict_zero(np.array([[0.4, 0.7, np.nan]]), np.array([[0.1, 0.4, np.nan]]))
    assert abs(zero[0] - ZERO) < 1e-14 and 0 < uncertainty[0] < 0.1


def test_single_point_gives_no_prediction():
    assert np.isnan(predict_zero(np.array([[0.4, np.nan, np.nan]]), np.array([[0.1, np.nan, np.nan]]))).all()


@pytest.mark.parametrize("value", [np.sin, lambda x: np.expm1(x) * (1 + x), lambda x: np.sqrt(x) * (1 + 0.3 * x)])
def test_prediction_converges_and_uncertainty_bounds_error(value):
    """Each new point lies beside the predicted zero by the uncertainty, as in continuation."""
    positions, values = np.full((2, 1, 3), np.nan)
    for x in (0.5, 0.35):
        push_history(positions, np.array([0]), np.array([x]))
        push_history(values, np.array([0]), value(np.array([x])))
    for evaluations in range(9):
        zero, uncertainty = predict_zero(positions, values)
        assert evaluations < 2 or abs(zero[0]) < 3 * uncertainty[0] + 1e-15
        if uncertainty[0] < 1e-12:
            break
        x = abs(zero + uncertainty)
        push_history(positions, np.array([0]), x)
        push_history(values, np.array([0]), value(x))
    assert abs(zero[0]) < 1e-12 and evaluations <= 7
