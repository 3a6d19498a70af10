"""Tests that a killed sweep loses no finished chunk; `python tests/hard/kills.py` kills it two hundred times."""

import pytest
from kills import Kills


@pytest.mark.long
@pytest.mark.parametrize("backend", ["alone", "pool"])
def test_kills(tmp_path, backend):
    kills = Kills(tmp_path)
    assert kills.run_once(1, backend) >= 1
    assert kills.counts["chunks lost"] == kills.counts["chunks computed twice"] == 0
