"""The smallest push out of the working cycle: it leaves, the next smaller returns, and a fine scan finds no other."""

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.analyses.push.analysis import push_lines
from vibrojax.cli import main
from vibrojax.errors import InputError
from vibrojax.measures.labels import IRREGULAR, SINGLE_IMPACT, SUBHARMONIC

AT = {"beta": 0.4, "delta": 0.005}
STATES = ("x1", "v1", "x2", "v2")


def pushed(scan=32, **more):
    return vj.smallest_push("vibro-impact", start="stuck", scan=scan, progress=False, **(AT | more))


@pytest.fixture(scope="module")
def strong():
    """Of the strong single impact, beside which there is a rattle."""
    return pushed(gamma=0.75)


def after(cycle, state, pushes, **parameters):
    """Impact velocities of motions that begin on the cycle, one state pushed; every lane stepped to its end."""
    at = np.array([float(cycle[f"orbit_{name}"]) if f"orbit_{name}" in cycle else 0.0 for name in STATES])
    starts = [(at + push * np.eye(4)[STATES.index(state)]).tolist() for push in pushes]
    asked = {"scene": "vibro-impact", "parameters": AT | parameters, "starts": starts}
    return vj.run_sweep(asked | {"run": {"settle": 120.0, "end_early": False}}, progress=False)


def test_what_is_in_it(strong):
    assert strong.push_x1.dims == ("sign",) and strong.sign.values.tolist() == [-1, 1]
    assert int(strong.regime) == SINGLE_IMPACT and strong.push_v2.attrs["units"] == "m s-1"
    assert all({"units", "long_name"} <= set(one.attrs) for one in strong.variables.values())
    for name in STATES:
        found = np.isfinite(strong[f"push_{name}"].values)
        np.testing.assert_array_equal(strong[f"regime_{name}"].values > 0, found)
        push, bracket = strong[f"push_{name}"].values[found], strong[f"bracket_{name}"].values[found]
        assert (push > 0).all() and (push <= float(strong[f"bound_{name}"])).all()
        assert (bracket > 0).all() and (bracket <= 1e-3 * push).all()


def test_it_leaves_and_the_next_smaller_returns(strong):
    """Only a push of the bit against the drive leaves, into the rattle; by full runs, three times as long."""
    found = {name: np.isfinite(strong[f"push_{name}"].values).tolist() for name in STATES}
    assert found == {"x1": [False, True], "v1": [False] * 2, "x2": [False] * 2, "v2": [False] * 2}
    push, bracket = float(strong.push_x1[1]), float(strong.bracket_x1[1])
    assert int(strong.regime_x1[1]) == IRREGULAR
    velocity = after(strong, "x1", [0.0, push - bracket, push], gamma=0.75).impact_velocity.values
    assert velocity[1] == pytest.approx(velocity[0], rel=1e-6) and velocity[2] < 0.3 * velocity[0]


def test_brute_force_finds_no_smaller_one(strong):
    """A fine scan of the direction, every motion stepped to its end: all smaller pushes are returned from."""
    push = float(strong.push_x1[1])
    fine = np.linspace(0.0, 1.1 * push, 221)
    velocity = after(strong, "x1", fine, gamma=0.75).impact_velocity.values
    left = np.abs(velocity / velocity[0] - 1) > 0.01
    assert left.any() and push - float(strong.bracket_x1[1]) <= fine[left][0] <= push + np.diff(fine)[0]


def test_several_machines_at_once(strong):
    both = pushed(gamma=[0.3, 0.75])
    assert both.push_x1.dims == ("point", "sign") and both.gamma.values.tolist() == [0.3, 0.75]
    assert both.regime.values.tolist() == [SUBHARMONIC, SINGLE_IMPACT]
    for name in STATES:
        np.testing.assert_allclose(both[f"push_{name}"][1], strong[f"push_{name}"], rtol=2e-3)
    velocity = after(both.isel(point=0), "v2", [0.0, float(both.push_v2[0, 1])], gamma=0.3).impact_velocity.values
    assert np.isfinite(velocity[0]) and np.isnan(velocity[1])  # it strikes no more


def test_the_picture(strong):
    figure = vj.picture(strong)
    panel = figure.axes[0]
    heights = [bar.get_height() for bar in panel.patches]
    bound, push = 1e3 * float(strong.bound_x1), 1e3 * float(strong.push_x1[1])  # mm
    assert heights == pytest.approx([bound, push])  # up to the greatest push tried where every push returns
    assert [bool(bar.get_hatch()) for bar in panel.patches] == [True, False]
    assert [text.get_text() for text in panel.texts] == ["returns", f"{push:.3g}"]
    assert panel.get_ylabel() == "push in x₁ [mm]" and len(figure.axes) == 4
    both = strong.expand_dims(point=2).assign_coords(gamma=("point", [0.7, 0.75]))
    down, none_down, up, none_up, _ = (line.get_ydata() for line in vj.picture(both).axes[0].lines)
    np.testing.assert_allclose(up, [push] * 2)
    np.testing.assert_allclose(none_down, [bound] * 2)  # hollow markers at the greatest push tried
    assert np.isnan(down).all() and not none_up.size


def test_a_machine_that_no_push_leaves_has_no_empty_panel(strong):
    pushes = [name for name in strong.data_vars if str(name).startswith("push_")]
    figure = vj.picture(strong.assign({name: strong[name] * np.nan for name in pushes}))
    for panel in figure.axes:
        assert [text.get_text() for text in panel.texts] == ["returns", "returns"]
        assert all(bar.get_height() > 0 and bar.get_hatch() for bar in panel.patches)
    assert "No push up to the greatest tried leaves" in figure.get_supxlabel()


def test_the_bound_is_what_is_asked_for():
    found = pushed(gamma=0.75, most={"x1": 0.04})
    assert float(found.bound_x1) == 0.04 and np.isnan(found.push_x1.values).all()
    swing = float(found.bound_x2)
    motion = vj.simulate("vibro-impact", start="stuck", gamma=0.75, duration=60.0, **AT).sel(time=slice(50.0, None))
    assert swing == pytest.approx(float(np.ptp(motion.x2.values)), rel=1e-2)


@pytest.mark.parametrize(
    ("scene", "more", "says"),
    [
        ("penetration", {}, "has no working cycle to push"),
        ("coupled-drilling", {}, "compression, v3 of it cannot be given as a start"),
        (
            "vibro-impact",
            AT | {"gamma": 0.75, "start": "drive"},
            "irregular after 40 s.: no cycle to push; give another start",
        ),
        ("vibro-impact", {"scan": 1}, "scan: 1 is not a whole number from 2 to 10000"),
        ("vibro-impact", {"most": {"x9": 1.0}}, '"x9" is no state of a start'),
        ("vibro-impact", {"most": {"x1": -1.0}}, "most.x1"),
        ("vibro-impact", {"gamma": []}, "gamma: is empty"),
        ("vibro-impact", {"gamme": 0.7}, "gamma"),
    ],
)
def test_what_cannot_be_pushed_is_refused(scene, more, says):
    with pytest.raises(InputError, match=says) as error:
        vj.smallest_push(scene, progress=False, **more)
    assert "\n" not in str(error.value)


def test_the_command(strong, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["beta=0.4", "gamma=0.75", "delta=0.005", "start=stuck", "scan=32"]
    assert main(["push", "vibro-impact", *words]) == 0
    said = capsys.readouterr().out
    assert f"x1 +  {float(strong.push_x1[1]):.4g} m (within" in said and "irregular" in said and "none up to" in said
    again = vj.open_dataset(tmp_path / "vibro-impact-push.nc")
    np.testing.assert_array_equal(again.push_x1, strong.push_x1)
    assert push_lines(again) == push_lines(strong)
    assert main(["info", "vibro-impact-push.nc"]) == 0
    monkeypatch.setattr("vibrojax.analyses.push.run.find_pushes", lambda *_, **__: strong)
    capsys.readouterr()
    assert main(["push", "vibro-impact", *words]) == 0
    assert capsys.readouterr().out.splitlines()[:-1] == said.splitlines()[:-1]
    other = ["push", "vibro-impact", *words[:-1], "scan=16"]
    assert main([*other, "-o", "vibro-impact-push.nc"]) == 2  # what is there is of others
    assert "--fresh" in capsys.readouterr().err
    assert main(other) == 0 and (tmp_path / "vibro-impact-push-2.nc").exists()
