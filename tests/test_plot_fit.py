"""Test the picture of a fit, which shows its data, by artists and labels, not by pixels."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex
from read_off import axis_labels, legend, note, titles
from test_plot_rock import FORMS, law

import vibrojax as vj
from vibrojax.pictures.choose import picture
from vibrojax.pictures.colours import FORM_COLOURS
from vibrojax.studies.rop_law import FORMS as LAWS

SIZES = {"literal": 1, "percent": 1, "onset": 2, "line": 2, "power": 2}
FORMULAS = {form.name: form.rate for form in LAWS}


def rig(path, columns=("rpm",), per_group=12, groups=3):
    """Write noisy rig data and return the path: C ln(eta/1.1) above an onset of 1.1, with C proportional to rpm."""
    draw = np.random.default_rng(7)
    lines = [",".join([*columns, "relief", "rate_of_penetration"])]
    for group in range(groups):
        keys = [str(80 + 40 * group), "AB"[group % 2]][: len(columns)]
        for eta in np.linspace(0.6, 3.0, per_group):
            rate = 2e-5 * (80 + 40 * group) * max(np.log(eta / 1.1), 0.0) * (1 + 0.05 * draw.standard_normal())
            lines.append(",".join([*keys, f"{eta:.4f}", f"{rate:.8f}"]))
        lines.append(",".join([*keys, "2.0", "-0.001"]))  # negative, so left out: a hole never becomes shallower
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def fit(tmp_path):
    return vj.fit_rop(rig(tmp_path / "rig.csv"), by="rpm", progress=False)


def line_points(axes, label):
    (line,) = (line for line in axes.lines if line.get_label() == label)
    return line.get_xydata()


def test_fit_stores_its_data_and_their_use(fit):
    assert fit["data_use"].attrs["flag_meanings"] == "no-lane fitted censored left-out"
    use = fit["data_use"].values
    assert ((use > 0).sum(axis=1) == fit["used"].isel(form=0) + fit["left_out"].isel(form=0)).all()
    assert (fit["data_rate_of_penetration"].values[use == 2] == 0).all()
    assert (fit["data_rate_of_penetration"].values[use == 3] == -0.001).all() and (use == 3).sum() == 3


def test_shorter_groups_are_padded(tmp_path):
    path = rig(tmp_path / "rig.csv")
    path.write_text(path.read_text() + "300,2.0,0.004\n300,2.5,0.005\n")
    fit = vj.fit_rop(path, by="rpm", progress=False)
    assert (fit["data_use"].values[-1, 2:] == 0).all() and np.isnan(fit["data_relief"].values[-1, 2:]).all()
    picture(fit).draw_without_rendering()


@pytest.mark.parametrize("form", SIZES)
def test_aic_agrees_with_drawn_curves(fit, form):
    for group in range(3):
        group_fit = fit.sel(form=form).isel(group=group)
        used = np.isin(group_fit["data_use"], (1, 2))
        eta, rate = group_fit["data_relief"].values[used], group_fit["data_rate_of_penetration"].values[used]
        predicted = FORMULAS[form](eta, *(float(group_fit[name]) for name in ("C", "eta0", "exponent")))
        residual = np.where((rate == 0) & (predicted <= 0), 0.0, predicted - rate)
        aic = rate.size * np.log(np.sum(residual**2) / rate.size) + 2 * SIZES[form]
        assert float(group_fit["aic"]) == pytest.approx(aic, abs=1e-6)


def test_each_group_has_panel_with_data_and_curves(fit):
    figure = picture(fit)
    assert titles(figure) == ["rpm = 80", "rpm = 120", "rpm = 160"]
    for group, axes in enumerate(axes for axes in figure.axes if axes.get_title("left")):
        group_fit = fit.isel(group=group)
        for use, label in ((1, "_fitted"), (2, "_censored"), (3, "_left-out")):
            selected = group_fit["data_use"].values == use
            expected = np.column_stack([group_fit["data_relief"], 1e3 * group_fit["data_rate_of_penetration"]])[
                selected
            ]
            assert np.array_equal(line_points(axes, label), expected)
        for form in FORMS:
            eta, rate = line_points(axes, form).T
            coefficients = (float(group_fit[name].sel(form=form)) for name in ("C", "eta0", "exponent"))
            assert np.allclose(rate, 1e3 * FORMULAS[form](eta, *coefficients))
            (line,) = (line for line in axes.lines if line.get_label() == form)
            assert to_hex(line.get_color()).upper() == FORM_COLOURS[form]
    hollow = next(line for line in axes.lines if line.get_label() == "_censored")
    assert hollow.get_markerfacecolor() == "white"
    assert {"data", "no penetration (censored)", "left out of the fit"} <= set(legend(figure))
    assert {"relief P/D", "rate of penetration [mm/s]", "rpm"} <= axis_labels(figure)


def test_groups_of_one_column_form_axis(fit):
    figure = picture(fit)
    coefficient = next(axes for axes in figure.axes if axes.get_ylabel() == "C [mm/s]")
    bars = {container.get_label(): container for container in coefficient.containers}
    line, *_ = bars["onset"]
    assert np.allclose(line.get_xydata(), np.column_stack([[80, 120, 160], 1e3 * fit["C"].sel(form="onset")]))


def test_titles_list_all_columns_of_groups(tmp_path):
    fit = vj.fit_rop(rig(tmp_path / "rig.csv", ("rpm", "bit"), groups=8), by=("rpm", "bit"), progress=False)
    figure = picture(fit)
    assert "rpm = 80, bit: A" in titles(figure) and "rpm = 360, bit: B" in titles(figure)
    assert not [title for title in titles(figure) if "group" in title]
    assert len(titles(figure)) == 6 + 4
    assert "Data and curves of 6 of 8 groups" in note(figure).replace("\n", " ")
    assert figure.get_figheight() <= 20.0


def test_map_of_fits_shows_data_of_some_groups(tmp_path):
    axes = {"force": np.linspace(2e5, 3e5, 9), "k3": np.linspace(1e8, 5e8, 9), "frequency": np.linspace(10.0, 40.0, 8)}
    force, k3, frequency = np.meshgrid(*axes.values(), indexing="ij")
    relief = force * frequency / 5e6
    data = xr.Dataset({"relief": (tuple(axes), relief), "rate_of_penetration": (tuple(axes), 1e5 * relief / k3)}, axes)
    figure = picture(vj.fit_rop(data, progress=False))
    assert "Data and curves of 6 of 81 groups" in note(figure)
    shown = [axes for axes in figure.axes if any(line.get_label() == "_fitted" for line in axes.lines)]
    assert len(shown) == 6 and all(len(line_points(axes, "_fitted")) == 8 for axes in shown)
    assert {"data", "onset\nC ln(η/η₀)"} <= set(legend(figure))


def test_fit_without_data_is_drawn():
    figure = picture(law({"force": [2e5, 3e5]}))
    assert len(figure.axes) == 2


def test_group_without_data_to_fit_is_drawn(tmp_path):
    path = tmp_path / "rig.csv"
    path.write_text("rpm,relief,rate_of_penetration\n80,,\n80,,\n120,1.5,0.001\n120,2.0,0.002\n120,3.0,0.003\n")
    picture(vj.fit_rop(path, by="rpm", progress=False)).draw_without_rendering()
