"""Families of autonomous systems without events: branch points, hopf points and doublings."""

import numpy as np
import pytest

import vibrojax as vj

E = vj.elementary


def points(family, kind):
    """Return the special points of a kind as (branch, value), in the order of the dataset."""
    names = np.array(family.special_kind.attrs["flag_meanings"].split())[family.special_kind.values]
    own = names == kind
    return list(zip(family.special_branch.values[own].tolist(), family.special_value.values[own].tolist(), strict=True))


def kinds(family):
    return set(np.array(family.special_kind.attrs["flag_meanings"].split())[family.special_kind.values])


def test_circles_cross_at_a_branch_point():
    """Two limit cycles, the circles r = a and r = 2 with the period 1, cross at a = 2."""

    def field(t, y, p):
        square = y["x"] ** 2 + y["y"] ** 2
        pull = square - (p["a"] + 2.0) * E.sqrt(square) + 2.0 * p["a"]
        return {"x": -y["x"] * pull - 2 * np.pi * y["y"], "y": -y["y"] * pull + 2 * np.pi * y["x"]}

    circles = vj.System("circles", states={"x": "1", "y": "1"}, parameters={"a": 1.0}, field=field, section="y")
    family = vj.follow(
        circles, along="a", at=1.0, span=(0.5, 3.0), start=[2.1, 0.0], settle=50.0, observe=15.0, cycles=1,
        progress=False,
    )  # fmt: skip
    assert kinds(family) == {"branch-point", "end"}
    found = points(family, "branch-point")
    assert [branch for branch, _ in found] == [0, 1]
    assert [value for _, value in found] == pytest.approx([2.0, 2.0], abs=1e-9)
    for branch in (0, 1):
        own = family.branch.values == branch
        radius = np.abs(family.orbit_x.values[own])
        circle = 2.0 if np.ptp(radius) < 1e-6 else family.a.values[own]
        assert radius == pytest.approx(circle, abs=1e-8)
        assert family.period.values[own] == pytest.approx(1.0, abs=1e-9)


def test_pair_of_mirrored_orbits_meets_the_symmetric_one():
    """The pair of orbits of the Lorenz system is born at a pitchfork near rho = 313, where it turns back."""
    lorenz = vj.System(
        "lorenz",
        states={"x": "1", "y": "1", "z": "1"},
        parameters={"rho": 280.0},
        field=lambda t, y, p: {
            "x": 10.0 * (y["y"] - y["x"]),
            "y": p["rho"] * y["x"] - y["y"] - y["x"] * y["z"],
            "z": y["x"] * y["y"] - 8.0 / 3.0 * y["z"],
        },
        section="x",
    )
    family = vj.follow(
        lorenz, along="rho", at=280.0, span=(200.0, 330.0), start=[30.0, 30.0, 280.0], settle=60.0, observe=20.0,
        cycles=1, progress=False,
    )  # fmt: skip
    assert kinds(family) == {"branch-point", "period-doubling", "end"}
    pair, symmetric = (value for _, value in points(family, "branch-point"))
    assert pair == pytest.approx(symmetric, rel=1e-8)
    assert pair == pytest.approx(312.97353, abs=1e-5)
    doublings = [value for branch, value in points(family, "period-doubling") if branch == 0]
    assert doublings == pytest.approx([229.4067086] * 2, abs=1e-7)  # AUTO: 229.40671; once for each of the pair
    assert family.rho.values[family.branch.values == 0].max() == pytest.approx(pair, abs=1e-9)
    beyond = (family.branch.values == 1) & (family.rho.values > pair)
    assert beyond.any() and family.stable.values[beyond].all()


def test_predators_and_prey_begin_to_oscillate():
    """Bazykin's harvested prey (demo pp2 of AUTO): the equilibrium has imaginary eigenvalues at quota 0.671593847."""
    prey = vj.System(
        "prey",
        states={"fish": "1", "sharks": "1"},
        parameters={"quota": 0.7},
        field=lambda t, y, p: {
            "fish": 3.0 * y["fish"] * (1 - y["fish"])
            - y["fish"] * y["sharks"]
            - p["quota"] * (1 - E.exp(-5.0 * y["fish"])),
            "sharks": -y["sharks"] + 3.0 * y["fish"] * y["sharks"],
        },
        section=("fish", 1 / 3),
    )
    family = vj.follow(
        prey, along="quota", at=0.7, span=(0.5, 0.8), start=[0.35, 0.3], settle=500.0, observe=160.0, progress=False
    )
    assert kinds(family) == {"hopf", "end"}
    assert points(family, "hopf") == [(0, pytest.approx(0.67159384748, abs=1e-11))]
