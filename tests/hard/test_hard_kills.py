"""Tests that a killed sweep loses no finished chunk; `python tests/hard/kills.py` kills it two hundred times."""

from kills import Kills


def test_three_kills(tmp_path):
    kills = Kills(tmp_path)
    assert kills.run_once(most=3) >= 1
    assert kills.counts["chunks lost"] == kills.counts["chunks computed twice"] == 0
