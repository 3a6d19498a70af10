"""Tests of engineering quantities: impact power, blows per minute, stick-slip index, specific energy, two diagrams."""

import numpy as np
import pytest
import xarray as xr
from read_off import legend

import vibrojax as vj
from vibrojax.cli import analyses, main
from vibrojax.errors import InputError, Place
from vibrojax.settings.names import read_names

RUN = {"end_early": False, "settle": 20.0}  # one program for all sweeps of the scene
DRILL = {"scene": "drilling", "parameters": {"k1": 625000.0}, "run": RUN}


@pytest.fixture(scope="module")
def drilling():
    """Return lanes that repeat after one return, after several, and not at all; some do not penetrate."""
    return vj.run_sweep(DRILL | {"grid": {"gamma": [0.6, 0.75, 1.1, 1.2]}}, progress=False)


def test_power_and_energy_match_their_definitions(drilling):
    ds = drilling
    assert {0, 1} < set(ds.cycles.values.ravel().tolist()) and (ds.rate_of_penetration == 0).any()
    repeats = ds.cycles > 0
    power = (ds.impact_energy * ds.impacts / (ds.cycles * ds.period)).where(repeats)
    xr.testing.assert_allclose(ds.impact_power, power.rename("impact_power"))
    np.testing.assert_allclose(ds.blow_frequency, 60 * ds.impacts / (ds.cycles.clip(min=1) * ds.period))
    rate = ds.rate_of_penetration.where(ds.rate_of_penetration > 0)
    np.testing.assert_allclose(ds.specific_energy, power / (np.pi * 0.036**2 * rate))
    assert ds.specific_energy.bit_radius == 0.036
    names = ("impact_power", "blow_frequency", "stick_slip_index", "specific_energy")
    assert [ds[name].units for name in names] == ["W", "min-1", "1", "J m-3"]
    assert all(ds[name].attrs.get("definition") for name in names if name != "blow_frequency")


def test_wider_hole_takes_less_energy_per_volume():
    """The radius may be given alone, on an axis, or with a rotation. The energy refers to the area of that radius."""
    shared, values = DRILL | {"starts": ["stuck"]}, {"k1": 625000.0, "delta": 0.0}
    rotation = {**values, "bit_radius": 0.05, "rpm": 120 / (np.pi * 0.1)}
    runs = [
        shared | {"parameters": {**values, "v": 2.0}, "grid": {"bit_radius": [0.05]}},
        shared | {"parameters": rotation, "grid": {"gamma": [0.75]}},
    ]
    for run in runs:
        ds = vj.run_sweep(run, progress=False).squeeze()
        volume = np.pi * 0.05**2 * float(ds.rate_of_penetration)
        assert volume > 0 and float(ds.specific_energy) == pytest.approx(float(ds.impact_power) / volume)
    assert ds.specific_energy.bit_radius == 0.05
    alone = vj.read_sweep(shared | {"parameters": {**values, "v": 2.0, "bit_radius": 0.05}, "grid": {"gamma": [0.75]}})
    assert alone.hole_radius == 0.05 and alone.parameters["v"] == 2.0
    with pytest.raises(InputError, match="v is given as well"):
        vj.read_sweep(shared | {"parameters": rotation | {"v": 1.0}, "grid": {"gamma": [0.75]}})


@pytest.mark.parametrize("scene", vj.SCENES)
def test_each_parameter_reaches_the_equations_by_every_way(scene, monkeypatch, tmp_path):
    """`vj.simulate`, the command and a sweep of one lane resolve each parameter to the same values."""
    seen = []
    seen_point = lambda self, point, progress: seen.append(point) or xr.Dataset()  # noqa: E731
    monkeypatch.setattr("vibrojax.studies.trajectory.Trajectories.compute", seen_point)
    monkeypatch.setattr(analyses, "answer", lambda options, name, identity, compute, *_, **__: compute())
    names = read_names(Place("test"), scene, {}, Place("test"))
    for name, parameter in names.writable.items():
        given = {name: 1.03 * parameter.default or 0.01}
        given |= {"bit_radius": 0.11} if name == "rpm" else {"rpm": 100.0} if name == "bit_radius" else {}
        ways = [given, {"bit_radius": 0.11}] if name == "bit_radius" and "threshold" in names.parameters else [given]
        for given in ways:
            axis = next(other for other in names.parameters if other not in (name, "v", "k1", "gamma"))
            sweep = vj.read_sweep(
                {"scene": scene, "parameters": given, "grid": {axis: [names.parameters[axis].default]}}
            )
            vj.simulate(scene, progress=False, **given)
            main(["simulate", scene, *(f"{key}={value!r}" for key, value in given.items()), "--quiet"])
            [called, commanded] = seen
            seen.clear()
            expected = {key: float(x[0]) for key, x in sweep.lane_values(0, 1)[0].items()}
            assert called.parameters == commanded.parameters == pytest.approx(expected, rel=1e-15)
            assert called.hole_radius == commanded.hole_radius == sweep.hole_radius


def test_stick_slip_index_of_a_harmonic_motion():
    """Without friction and damping, a mode of amplitude a at the angular frequency w moves the bit at v +- a w."""
    m1, beta, gamma, k1, v, a = 250.0, 0.4, 0.75, 156250.0, 1.5, 0.02
    m2, k2 = beta * m1, beta * gamma**2 * k1
    squares, shapes = np.linalg.eig(np.array([[(k1 + k2) / m1, -k2 / m1], [-k2 / m2, k2 / m2]]))
    squares, shapes = squares.real, shapes.real  # some versions of numpy return complex numbers
    upper = int(np.argmax(squares))
    x1, x2 = a * shapes[:, upper] / shapes[0, upper]
    sweep = {"scene": "rotary", "parameters": {"c2": 0.0, "g": 0.0}, "starts": [[x1, 0.0, x2, 0.0]], "grid": {"v": [v]}}
    sweep["run"] = {"end_early": False, "settle": 5.0, "error": 1e-8}
    ds = vj.run_sweep(sweep, progress=False)
    assert float(ds.stick_slip_index.squeeze()) == pytest.approx(a * np.sqrt(squares[upper]) / v, rel=1e-6)
    assert not {"impact_power", "blow_frequency", "specific_energy"} & set(ds.data_vars)


def test_scenes_have_only_meaningful_variables():
    names = {scene: set(vj.list_variables(scene).index) for scene in ("rotary", "penetration", "coupled-drilling")}
    new = {"impact_power", "blow_frequency", "stick_slip_index", "specific_energy"}
    assert names["rotary"] & new == {"stick_slip_index"} and not names["penetration"] & new
    assert new <= names["coupled-drilling"]


def test_campbell_diagram_over_rotation():
    grid = {"rpm": [60.0, 90.0, 120.0, 150.0]}
    sweep = DRILL | {"starts": ["stuck"], "grid": grid, "parameters": {"bit_radius": 0.12, "delta": 0.005}}
    ds = vj.run_sweep(sweep, progress=False)
    (axes,) = vj.picture(ds, diagram="campbell").axes
    drawn = {line.get_marker(): line for line in axes.lines if line.get_linestyle() == "None"}
    np.testing.assert_allclose(drawn["o"].get_xdata(), grid["rpm"])
    np.testing.assert_allclose(drawn["o"].get_ydata(), 1 / ds.period.squeeze())
    np.testing.assert_allclose(drawn["x"].get_ydata(), ds.blow_frequency.squeeze() / 60)
    modes = vj.frequencies(ds)
    levels = [float(line.get_ydata()[0]) for line in axes.lines if len(line.get_ydata()) == len(grid["rpm"])]
    for name in ("lower_frequency", "upper_frequency"):
        assert np.isclose(levels, float(modes[name])).any()
    assert "2n" in [text.get_text() for text in axes.texts] and axes.get_xlabel() == "rotation [1/min]"


def test_rate_over_force_shows_onset():
    """Twice as many pulses per second need twice the mean force at the onset."""
    grid = {"force": np.linspace(40e3, 300e3, 8).tolist(), "frequency": [10.0, 20.0]}
    sweep = {"scene": "penetration", "parameters": {"rock": "sandstone"}, "grid": grid}
    ds = vj.run_sweep(sweep, progress=False)
    figure = vj.picture(ds, diagram="rate-over-force")
    below = ds.mean_force.where(ds.rate_of_penetration == 0).max("force").values / 1e3
    above = ds.mean_force.where(ds.rate_of_penetration > 0).min("force").values / 1e3
    np.testing.assert_allclose(above[1] / above[0], 2.0, rtol=1e-6)
    texts = " ".join(legend(figure))
    for low, high in zip(below, above, strict=True):
        assert f"onset at {low:.4g} to {high:.4g} kN" in texts
    assert figure.axes[0].get_xlabel() == "mean force P [kN]"


@pytest.mark.parametrize(
    ("call", "line"),
    [
        ({"diagram": "cambell"}, 'diagram: "cambell" is unknown; did you mean "campbell"?'),
        ({"diagram": "campbell", "variable": "impacts"}, "campbell draws its own variables"),
        (
            {"diagram": "campbell", "where": {"gamma": 0.6, "start": "stuck"}},
            "campbell: the dataset holds no lanes over a grid",
        ),
        ({"diagram": "rate-over-force", "where": {"gamma": 0.6}}, "rate-over-force: no number varies"),
    ],
)
def test_undrawable_diagrams_are_refused(drilling, call, line):
    with pytest.raises(InputError) as error:
        vj.picture(drilling, **call)
    assert line in str(error.value) and "\n" not in str(error.value)


def test_chart_shows_best_robust_cell():
    """Compare the cell under the star with the greatest power among cells whose neighbours are single impacts, too."""
    axes = {"beta": np.linspace(0.3, 0.5, 7).tolist(), "gamma": np.linspace(0.65, 0.9, 8).tolist()}
    table = {"scene": "vibro-impact", "parameters": {"delta": 0.005}, "starts": ["stuck"], "grid": axes, "run": RUN}
    ds = vj.run_sweep(table, progress=False)
    figure = vj.picture(ds, diagram="chart")
    single = (ds.regime == 3).isel(start=0).transpose("beta", "gamma").values
    robust = np.pad(single, 1, constant_values=True)
    inner = np.lib.stride_tricks.sliding_window_view(robust, (3, 3)).all(axis=(2, 3))
    power = ds.impact_power.isel(start=0).transpose("beta", "gamma").where(inner)
    best = power.isel(power.argmax(...))
    energy, blows = figure.axes[:2]
    stars = [line for line in energy.lines if line.get_marker() == "*"]
    assert [stars[0].get_xdata()[0], stars[0].get_ydata()[0]] == [float(best.gamma), float(best.beta)]
    assert {"robust: the cells\naround as well", "best robust cell"} <= set(legend(figure))
    assert [text.get_text() for text in blows.get_legend().get_texts()] == ["impact power [W]", "blows [1/min]"]
    boxes = [line.get_xydata() for line in energy.lines if len(line.get_xdata()) == 5]
    assert any(np.ptp(box, axis=0) == pytest.approx([0.2, 0.35]) for box in boxes)  # the source's rectangle
    with pytest.raises(InputError, match="no map: gamma is all that varies"):
        vj.picture(ds, diagram="chart", where={"beta": axes["beta"][0]})
    more = xr.concat([ds.assign_coords(v=v) for v in (1.0, 1.5)], "v")
    with pytest.raises(InputError, match="chart: v varies as well; fix it, as in --where v=VALUE"):
        vj.picture(more, diagram="chart")
