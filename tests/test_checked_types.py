"""Test that the package's annotations are checked: an argument or result of wrong type or shape is an error."""

import numpy as np
import pytest
from checked_types import CALLS_PER_CHECK

from vibrojax.lanes.drift import _means
from vibrojax.periodic.return_map import Segments, in_calls
from vibrojax.scenes import SCENES

SEGMENTS = Segments(SCENES["rotary"]())


@pytest.mark.parametrize(
    "call",
    [
        lambda: in_calls(3, "many", 5),
        lambda: SEGMENTS({}, np.zeros(3)),
        lambda: _means(np.zeros((3, 4)), None, np.zeros(5, int), np.zeros((2, 4), int)),  # 4 lanes, then 5
    ],
    ids=["function", "method", "dimension"],
)
def test_wrong_argument_is_an_error(call):
    errors = [error_of(call) for _ in range(CALLS_PER_CHECK)]
    assert any("violates type hint" in str(error) for error in errors)


def error_of(call):
    try:
        return call()
    except Exception as error:
        return error
