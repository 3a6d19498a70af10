"""Test the titles and notes around panels, and the bands that replace dense lines over time, by texts and artists."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from read_off import panel, texts
from test_plot import lanes, returns, run, square

from vibrojax.pictures.choose import picture
from vibrojax.pictures.curves import is_band
from vibrojax.pictures.hole import pulses
from vibrojax.pictures.sheet import write_margins
from vibrojax.pictures.style import new_figure, settings
from vibrojax.pictures.time_history import trajectory


def artist(axes, label):
    """Return the only artist of `axes` with this label."""
    (match,) = (candidate for candidate in (*axes.lines, *axes.collections) if candidate.get_label() == label)
    return match


def pulse_run(count, amplitude=1.0):
    """Return a run of the bit on rock with `count` pulses in 10 s, sampled 60 times per pulse."""
    time = np.linspace(0.0, 10.0, 60 * count + 1)
    force = 1e5 * amplitude * (np.sin(2 * np.pi * count / 10.0 * time) > 0)
    depth = 1e-3 * time
    variables = {"x3": depth, "x4": depth, "applied_force": force, "rock_force": 0.5 * force}
    return xr.Dataset({name: ("time", values) for name, values in variables.items()}, {"time": time})


def test_few_pulses_are_drawn_through_every_sample():
    ds = pulse_run(20)
    line = artist(pulses(ds).axes[1], "given I")
    assert np.array_equal(line.get_ydata(), 1e-3 * ds["applied_force"])


def test_more_pulses_than_pixels_become_band_between_extremes():
    ds = pulse_run(2000)
    ds["applied_force"][ds["time"] > 5.0] *= 2.0  # the band follows this change
    figure = pulses(ds)
    band = artist(figure.axes[1], "given I")
    assert is_band(band)
    (path,) = band.get_paths()
    early, late = (path.vertices[(path.vertices[:, 0] > a) & (path.vertices[:, 0] < b)] for a, b in ((1, 4), (6, 9)))
    assert (early[:, 1].min(), early[:, 1].max()) == (0.0, 100.0)
    assert (late[:, 1].min(), late[:, 1].max()) == (0.0, 200.0)
    assert len(path.vertices) < 3000 < ds.sizes["time"]
    assert not is_band(artist(figure.axes[0], "hole x₄"))  # monotonic, so a line is enough
    assert not is_band(artist(figure.axes[3], "given I"))  # shows only the last two blows
    assert "Bands: from the least to the greatest" in figure.get_supxlabel()


def test_long_run_has_band_in_overview_and_lines_at_end():
    figure = trajectory(run(duration=400.0))
    overview, displacement = panel(figure, ylabel="whole run"), panel(figure, ylabel="displacement")
    assert sum(map(is_band, overview.collections)) == 2
    assert not any(map(is_band, displacement.collections))
    assert "Bands" not in trajectory(run()).get_supxlabel()


def test_notes_stay_within_page_at_notebook_resolutions():
    words = "Attractors 2, 3, 4 pass the section outside the picture; twenty lanes of 400 end in none. "
    ds = returns({"gamma": np.linspace(0.3, 1.2, 15)}, keep=4)
    for length in range(0, len(words), 5):
        with settings():  # a notebook draws the picture later, with its own settings
            figure = new_figure(6.6, 4.4)
            write_margins(figure, ds, (2 * words)[length : length + len(words)] * 2, point="")
        for dpi in (72, 100, 150):
            figure.set_dpi(dpi)
            (note,) = (text for text in figure.texts if text.get_text() == figure.get_supxlabel())
            assert note.get_window_extent(FigureCanvasAgg(figure).get_renderer()).x1 <= figure.bbox.x1


def test_title_that_fits_beside_legend_stays_on_one_line():
    title = "Impact velocity at each return over the frequency ratio"
    figure = picture(returns({"gamma": np.linspace(0.3, 1.2, 15)}, keep=4).assign_attrs(title=title))
    assert figure.get_suptitle() == title


@pytest.mark.parametrize("title", ["word " * 900, "w" * 900])
def test_very_long_title_is_cut_and_stays_on_page(title):
    figure = picture(lanes(square(5)).assign_attrs(title=title))
    assert figure.get_suptitle().endswith("…") and figure.get_suptitle().count("\n") <= 2
    assert figure.get_figheight() < 20
    whole = figure.bbox.padded(1)
    assert all(whole.x0 <= box.x0 and box.x1 <= whole.x1 for _, box in texts(figure))
