"""Tests of multipliers against the exact integrator by two methods; tests/benchmarks/multipliers.py does 64 orbits."""

from random_orbits import drawn, off_by_differences, off_by_volumes


def test_multipliers_at_random_points():
    """Compare with central differences, which have errors of about 1e-8 themselves, and with volumes.

    Most saltations that change volumes are of a bit that turns without sticking, where friction changes its sign.
    A missing saltation would show as a factor like 0.01.
    """
    orbits = drawn("stribeck", 64, 2)
    for orbit in orbits[:3]:
        assert off_by_differences(orbit) < 1e-6
    sliding = [off_by_volumes(orbit) for orbit in [candidate for candidate in orbits if candidate.stick == 0][:6]]
    assert len(sliding) >= 5
    assert all(off < 1e-7 for off, _ in sliding)
    assert sum(jumps < 0.9 for _, jumps in sliding) >= 2
