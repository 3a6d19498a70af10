"""Where quantities are foretold to vanish: straight lines and roots to the last digit, curves ever better."""

import numpy as np
import pytest

from vibrojax.analyses.continuation.brackets import predict_zero, push_history

ZERO = 0.3


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("power", [1.0, 0.5])
def test_lines_and_roots_are_foretold_exactly(power, sign):
    at = ZERO + sign * np.array([[0.1, 0.4, 0.7]])
    zero, doubt = predict_zero(at, 2.5 * np.abs(at - ZERO) ** power)
    assert abs(zero[0] - ZERO) < 1e-14 and doubt[0] < 1e-14


def test_two_points_make_a_line_that_is_doubted():
    zero, doubt = predict_zero(np.array([[0.4, 0.7, np.nan]]), np.array([[0.1, 0.4, np.nan]]))
    assert abs(zero[0] - ZERO) < 1e-14 and 0 < doubt[0] < 0.1


def test_of_a_single_point_nothing_is_predict_zero():
    assert np.isnan(predict_zero(np.array([[0.4, np.nan, np.nan]]), np.array([[0.1, np.nan, np.nan]]))).all()


@pytest.mark.parametrize("value", [np.sin, lambda x: np.expm1(x) * (1 + x), lambda x: np.sqrt(x) * (1 + 0.3 * x)])
def test_a_few_points_beside_a_zero_lead_to_it_and_the_doubt_is_honest(value):
    """Asked beside the zero by as much as is in doubt, as arcs are."""
    at, known = np.full((2, 1, 3), np.nan)
    for x in (0.5, 0.35):
        push_history(at, np.array([0]), np.array([x]))
        push_history(known, np.array([0]), value(np.array([x])))
    for asked in range(9):
        zero, doubt = predict_zero(at, known)
        assert asked < 2 or abs(zero[0]) < 3 * doubt[0] + 1e-15
        if doubt[0] < 1e-12:
            break
        x = abs(zero + doubt)
        push_history(at, np.array([0]), x)
        push_history(known, np.array([0]), value(x))
    assert abs(zero[0]) < 1e-12 and asked <= 7
