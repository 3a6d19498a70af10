"""Test the fit of mu and v_cr to a velocity: its derivatives against the sharp motion, and recovered parameters."""

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
import xarray as xr

import vibrojax as vj
from vibrojax.errors import InputError, Place
from vibrojax.scenes.rotary import Rotary
from vibrojax.studies.friction_fit import _velocity, fit_friction
from vibrojax.studies.friction_recording import contact_free_parts, open_recording
from vibrojax.studies.rop_least_squares import REASONS

TRUTH = {"mu": 0.35, "v_cr": 2.5}
INTERVAL = 4e-3


def measured(duration=0.5, start="stuck", error=1e-6, **parameters):
    """Return the located, event-exact motion."""
    given = TRUTH | parameters
    return vj.simulate(
        "rotary", start=start, duration=duration, sampling=INTERVAL, error=error, progress=False, **given
    )


@pytest.fixture(scope="module")
def history():
    return measured(1.0)


@pytest.fixture
def noise():
    return np.random.default_rng(20260102)


def sharp_derivatives(duration):
    """Return d x1'/d ln mu and d x1'/d ln v_cr (samples, 2) by central differences of the converged motion."""
    share = 1e-5
    columns = []
    for name, value in TRUTH.items():
        up, down = (measured(duration, error=1e-9, **{name: value * (1 + sign * share)}) for sign in (1, -1))
        columns.append((up.v1.values - down.v1.values) / (2 * share))
    return np.stack(columns, axis=1)


def smoothed_derivatives(duration, width, substeps=20):
    fixed = {name: jnp.asarray(parameter.default) for name, parameter in Rotary().parameters().items()}
    fixed["state"] = jnp.asarray([0.0, -fixed["v"].item(), 0.0, 0.0])
    fixed |= {"interval": jnp.asarray(INTERVAL), "width": jnp.asarray(width)}
    log_parameters = jnp.log(jnp.asarray(list(TRUTH.values())))
    samples = round(duration / INTERVAL) + 1
    return np.asarray(jax.jacfwd(lambda theta: _velocity(theta, fixed, substeps, samples))(log_parameters))


def test_derivatives_match_sharp_motion_over_short_window():
    """The error is proportional to the smoothing, and falls below 1 %. Over a window four times as long it is large."""

    short = round(0.5 / INTERVAL) + 1
    expected = sharp_derivatives(2.0)

    def relative_error(derivatives):
        first = expected[: len(derivatives)]
        return np.linalg.norm(derivatives - first, axis=0) / np.linalg.norm(first, axis=0)

    long = smoothed_derivatives(2.0, 0.001, substeps=40)
    wide, narrow = relative_error(smoothed_derivatives(0.5, 0.004, substeps=10)), relative_error(long[:short])
    assert (narrow < 0.01).all() and (narrow < 0.4 * wide).all()
    assert (relative_error(long) > 3 * narrow).all()


def test_smoothing_is_the_only_error_without_noise(history):
    """The error is of the order of the change from halving the smoothing, and falls by about half with it."""
    fits = [fit_friction(history, (0.0, 0.5), "stuck", width) for width in (0.008, 0.004)]
    for name, truth in TRUTH.items():
        errors = [abs(fit[name].item() - truth) for fit in fits]
        assert errors[1] < 0.02 * truth and errors[1] < 0.75 * errors[0]
        assert errors[1] < 4 * abs(fits[1][f"{name}_change"].item())
    assert fits[1].rms.item() < 3e-3 and REASONS[fits[1].reason.item()] == "identified"


@pytest.mark.parametrize(("start", "window"), [("stuck", (0.0, 0.5)), (None, (0.0, 1.0))], ids=["known", "sought"])
def test_parameters_are_recovered_from_noisy_velocity(history, noise, start, window):
    """In twelve draws with noise of 0.02 m/s, the deviations are about as large as the standard errors.

    The wide smoothing is fast, and its effect is small compared with these errors.
    """
    deviations = []
    for _ in range(12):
        noisy = history[["v1"]].assign(v1=history.v1 + 0.02 * noise.standard_normal(history.sizes["time"]))
        fit = fit_friction(noisy, window, start, smoothing=0.008)
        assert fit.rms.item() == pytest.approx(0.02, rel=0.3) and fit.mu_stderr.item() < 0.05
        deviations.append([(fit[name].item() - truth) / fit[f"{name}_stderr"].item() for name, truth in TRUTH.items()])
    spread = np.sqrt(np.mean(np.square(deviations), axis=0))
    assert (spread > 0.5).all() and (spread < 1.6).all()


def test_search_converges_from_other_values_and_uses_given_parameters(history):
    heavier = measured(m1=300.0, beta=0.3)
    named = {"start": "stuck", "mu": 0.5, "v_cr": 4.0}
    fit = fit_friction(heavier, **named)
    assert fit.mu.item() == pytest.approx(0.35, rel=0.01) and fit.v_cr.item() == pytest.approx(2.5, rel=0.02)
    bare = heavier[["v1"]].drop_attrs()
    given = fit_friction(bare, **named, m1=300.0, beta=0.3)
    assert given.mu.item() == fit.mu.item()
    # parameters of another drill; the fit may not exist
    assert not abs(fit_friction(bare, **named).mu.item() - 0.35) < 0.05


def test_later_window_and_missing_samples(history):
    later = history.copy(deep=True)
    later["v1"][200:210] = np.nan
    fit = fit_friction(later, window=(0.5, 1.0))
    assert (fit.used.item(), fit.left_out.item()) == (116, 10)
    assert fit.mu.item() == pytest.approx(0.35, rel=0.03) and fit.v_cr.item() == pytest.approx(2.5, rel=0.03)
    np.testing.assert_allclose(fit.state, [later[name].values[125] for name in ("x1", "v1", "x2", "v2")], atol=0.02)


def test_undetermined_parameters_are_nan_with_a_reason(history, noise):
    """A sticking bit does not slide, so the velocity does not determine how friction falls with speed."""
    stuck = measured(v=0.0)
    fit = fit_friction(stuck, start="stuck")
    assert REASONS[fit.reason.item()] in ("confounded", "not-converged")
    assert np.isnan([fit[name].item() for name in ("mu", "mu_stderr", "v_cr", "v_cr_stderr", "rms")]).all()
    noisy = history.assign(v1=history.v1 + 1.0 * noise.standard_normal(history.sizes["time"]))
    vague = fit_friction(noisy[["v1"]], window=(0.0, 0.5))
    assert REASONS[vague.reason.item()] in ("confounded", "not-converged") and np.isnan(vague.v_cr.item())
    few = fit_friction(history, window=(0.0, 2 * INTERVAL))
    assert REASONS[few.reason.item()] == "too-few-lanes" and np.isnan(few.mu.item())


@pytest.mark.parametrize(
    ("change", "named", "line"),
    [
        (lambda d: d.drop_vars("v1"), {}, "fit_friction: v1: missing along time"),
        (lambda d: 3, {}, "fit_friction: 3 is not data; give a dataset, a table, a path, or arrays (time, v1)"),
        (lambda d: (d.time,), {}, "fit_friction: 1 arrays; two are needed, (time, v1) in s and m/s"),
        (lambda d: (d.time, d.v1[1:]), {}, "fit_friction: v1: has 250 values; 251 are needed, as in time"),
        (lambda d: {"time": d.time}, {}, "fit_friction: v1: missing; columns time [s] and v1 [m/s] are needed"),
        (lambda d: {"time": d.time, "v1 (kg)": d.v1}, {}, 'v1 (kg): "kg" is not a unit of v1'),
        (lambda d: {"time": d.time, "v1": ["a"] * 251}, {}, "fit_friction: v1: does not hold numbers"),
        (lambda d: "recording.txt", {}, "recording.txt: ends in neither .nc nor .csv"),
        (lambda d: d, {"contacts": [0.1]}, "contacts: [0.1] are not pairs (begin, end) [s]"),
        (lambda d: d, {"contacts": [(0.2, 0.1)]}, "contacts: (0.2, 0.1) does not end after it begins"),
        (lambda d: d, {"window": (3.0, 4.0)}, "window: 3 to 4 s holds 0 samples; two or more are needed"),
        (lambda d: d.isel(time=[0, 1, 3, 7]), {}, "time: is not evenly spaced"),
        (lambda d: d.assign(impact_force=d.v1 * 0 + 1.0), {}, "window: holds impacts; choose one between them"),
        (lambda d: d, {"start": "stock"}, 'start: "stock" is unknown; did you mean "stuck"?'),
        (lambda d: d, {"start": (0.0, 1.0)}, "start: [0.0, 1.0] is not x1, x1', x2, x2'"),
        (lambda d: d, {"mu": 0.0}, "mu: is 0; it must be above 0"),
        (lambda d: d, {"m1": -1.0}, "m1: is -1; it must be above 0 kg"),
        (lambda d: d, {"m2": 100.0}, "m2: is not a parameter of the rotary scene; did you mean"),
        (lambda d: d, {"smoothing": 0.0}, "smoothing: is 0.0; it must be above 0"),
        (lambda d: d, {"smoothing": 1e-6}, "shorten the window"),
    ],
)
def test_bad_input_is_refused_in_one_line(history, change, named, line):
    with pytest.raises(InputError) as caught:
        fit_friction(change(history), **named)
    assert line in str(caught.value) and "\n" not in str(caught.value)


def as_csv(path, history, separator):
    rows = [separator.join(["time (ms)", "note", "v1 (mm/s)"])]
    rows += [separator.join([f"{1e3 * t:.9g}", "1.5", f"{1e3 * v!r}"]) for t, v in history]
    text = "\n".join(rows)
    path.write_text(text.replace(".", ",") if separator == ";" else text)
    return path


@pytest.mark.filterwarnings("ignore:.*semicolons separate the columns, commas are decimal marks")
def test_recordings_of_all_forms_are_read(history, tmp_path):
    """Read arrays, a dict, DataFrames with columns or an index, and CSV files, in other units."""
    time, v1 = history.time.values, history.v1.values
    rows = np.stack([time, v1], axis=1).tolist()
    forms = (
        (time, v1),
        np.stack([time, v1]),
        {"time": time, "v1": v1, "note": ["a"] * len(time)},
        pd.DataFrame({"time": time, "v1 (mm/s)": 1e3 * v1}),
        pd.DataFrame({"v1": v1}, index=pd.Index(1e3 * time, name="time [ms]")),
        as_csv(tmp_path / "a.csv", rows, ","),
        str(as_csv(tmp_path / "b.csv", rows, ";")),
    )
    for form in forms:
        _, ds = open_recording(form, "fit_friction")
        np.testing.assert_allclose(ds.time, time, rtol=1e-8)
        np.testing.assert_allclose(ds.v1, v1, rtol=1e-12)
        few = fit_friction(form, window=(0.0, 2.0001 * INTERVAL))
        assert REASONS[few.reason.item()] == "too-few-lanes" and few.used.item() == 3


EVENTS = {"event_time": ("event", [0.5, 2.5, 4.2, 4.4]), "event_kind": ("event", [4, 3, 3, 4], {})}
KINDS = {"flag_values": np.arange(6), "flag_meanings": "none stick slip impact release section"}


@pytest.mark.parametrize(
    ("force", "contacts", "parts"),
    [
        (None, [], [(0, 8)]),
        ([0, 0, 1, 1, 0, 0, 0, 2], [], [(0, 2), (4, 7)]),
        (None, [(2.0, 3.5)], [(0, 2), (4, 8)]),
        (None, [(2.2, 2.4)], [(0, 3), (3, 8)]),  # between two samples
        ([0, 0, 1, 0, 0, 0, 0, 0], [(2.5, 2.8), (6.9, 9.0)], [(0, 2), (3, 7)]),
        (None, "events", [(1, 3), (5, 8)]),
    ],
)
def test_parts_are_between_contacts(force, contacts, parts):
    ds = xr.Dataset(coords={"time": np.arange(8.0)})
    if force is not None:
        ds["impact_force"] = ("time", np.array(force, float))
    if contacts == "events":  # one contact lasts until 0.5, another from 2.5 to 4.4, within which a third begins
        ds, contacts = ds.assign(EVENTS), []
        ds["event_kind"].attrs.update(KINDS)
    result = contact_free_parts(Place("fit"), ds, np.ones(8, bool), contacts)
    assert [(part.start, part.stop) for part in result] == parts


def test_parameters_are_recovered_from_window_with_impacts():
    """The states after impacts are fitted too, so mu is less certain than from a single part."""
    motion = vj.simulate(
        "vibro-impact",
        **TRUTH,
        **{"delta": 0.005, "start": "stuck", "duration": 0.6, "sampling": INTERVAL, "error": 1e-6, "progress": False},
    )
    assert (motion.impact_force > 0).sum() >= 2
    fit = fit_friction(motion, (0.0, 0.6), "stuck")
    assert fit.mu.item() == pytest.approx(0.35, rel=0.03) and fit.v_cr.item() == pytest.approx(2.5, rel=0.03)
    assert fit.state.dims == ("part", "quantity") and fit.sizes["part"] == 3 and fit.part[0].item() == 0.0
    assert fit.used.item() + fit.left_out.item() == 151
    assert int(np.isnan(fit.fitted).sum()) == fit.left_out.item() and fit.rms.item() < 3e-3
