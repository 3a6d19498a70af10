"""Tests of objects of users and of other packages: friction laws, scenes, steppers, measures, and analyses."""

import io
import json
import subprocess
import sys
from contextlib import chdir, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from textwrap import dedent
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from refusals import refusal

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.io.kinds import kind_of
from vibrojax.scenes.vibro_impact import VibroImpact
from vibrojax.studies.analysis import analysis_of, offered_analyses

RUN = {"settle": 6.0, "observe": 6.0}


def sweep(scene="vibro-impact", parameters=None, **run):
    tables = {"scene": scene, "parameters": parameters or {}, "grid": {"gamma": [0.65, 0.7]}, "run": RUN | run}
    return vj.run_sweep(tables, progress=False)


@pytest.fixture(scope="module")
def usual():
    return sweep()


def test_own_friction_law(usual):
    """It is the law of eq. 5.9 under another name."""
    stribeck = vj.FRICTION_LAWS["stribeck"]
    law = vj.FrictionLaw("mine", "eq. 5.9", stribeck.parameters, stribeck.mu, stribeck.mu_impact)
    own = sweep(parameters={"friction": law})
    assert own.attrs["friction"] == "mine" and 'friction = "mine"' in own.attrs["sweep"]
    for name in usual.data_vars:
        np.testing.assert_array_equal(own[name], usual[name], err_msg=name)
    point = {"beta": 0.4, "gamma": 0.7, "duration": 1.0, "progress": False}
    motion, known = vj.simulate("vibro-impact", friction=law, **point), vj.simulate("vibro-impact", **point)
    np.testing.assert_array_equal(motion.x2, known.x2)


def test_own_stepper(usual):
    """A stepper of higher order gives the same motion, within the accepted errors of both."""
    finer = sweep(method=vj.Located(order=12))
    assert '"order": 12' in finer.attrs["solver"]
    np.testing.assert_array_equal(finer.regime, usual.regime)
    np.testing.assert_allclose(finer.period, usual.period, rtol=1e-6)
    assert np.any(finer.period != usual.period)


@dataclass(frozen=True)
class MeanSpeed(vj.Gauge):
    """Mean of |x2'| over whole returns [m/s]: the striker's way up and down, per time."""

    summed: ClassVar[tuple[str, ...]] = ("way",)
    variables: ClassVar[dict[str, tuple[str, str]]] = {"striker_mean_speed": ("m s-1", "mean speed of the striker")}

    def increments(self, scene, c, moment):
        place = scene.place("x2")
        return {"way": jnp.abs(moment.step.after[place] - moment.step.before[place])}

    def read(self, scene, c, carry, whole):
        return {"striker_mean_speed": whole.sums["way"] / whole.time}


@dataclass(frozen=True)
class Measured(VibroImpact):
    measures = (*VibroImpact.measures, MeanSpeed())


def test_own_measure(usual):
    """The measure is in the dataset with its unit. In a period the striker goes up and down by its swing, because steps
    end at its turning points."""
    own = sweep(Measured())
    assert own.striker_mean_speed.attrs["units"] == "m s-1"
    clean = (own.cycles == 1) & (own.striker_turns == 1)
    assert clean.any()
    swings = 4 * own.striker_amplitude / own.period
    np.testing.assert_allclose(own.striker_mean_speed.where(clean), swings.where(clean), rtol=1e-2)
    np.testing.assert_allclose(own.impact_velocity, usual.impact_velocity, rtol=1e-9)


def install(folder, name, group, entry_points):
    """Make a package known as pip does."""
    about = folder / f"{name}-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("\n".join([f"[vibrojax.{group}]", *entry_points, ""]))


WRONG = {
    'Mine sums "stick", and so does Shares; give its sum another name': {"summed": ("stick",)},
    'gauge Mine: increments gave no "way", which is in `summed` of the gauge': {"summed": ("way",)},
    "gauge Mine: increments fails with TypeError": {"increments": lambda self, moment: {}},
    "Mine declares period, which is a variable of vibrojax; give it another": {"variables": {"period": ("m", "speed")}},
}


@pytest.mark.parametrize("message", WRONG)
def test_wrong_gauges_end_in_one_line(message):
    """The unit of a variable would take the place of the package's, which keeps the values."""
    own = {"increments": lambda *_: {}, "read": lambda *_: {"period": 1.0}} | WRONG[message]
    measures = (*VibroImpact.measures, type("Mine", (vj.Gauge,), own)())
    assert message in refusal(sweep, dataclass(frozen=True)(type("Wrong", (VibroImpact,), {"measures": measures}))())


def test_objects_of_installed_package(tmp_path):
    """Its law, scene, stepper and gauge have names. Unusable objects are left out, each with a line that says why."""
    (tmp_path / "mine.py").write_text(
        dedent("""
        import vibrojax as vj

        law = vj.FrictionLaw("mine", "eq. 0", {}, lambda speed, p: 0.2 + 0.0 * speed)
        taken = vj.FrictionLaw("coulomb", "eq. 0", {}, law.mu)

        class Scene(vj.SCENES["vibro-impact"]):
            name = "my-scene"
            measures = (*vj.SCENES["vibro-impact"].measures, "my-gauge")

        class Stepper(vj.Located):
            name = "my-stepper"

        class Gauge(vj.Gauge):
            def read(self, scene, c, carry, whole):
                return {}

        stepper, gauge = Stepper(), Gauge()
        field = lambda t, y, p: {"x": -p["k"] * y["x"] + vj.elementary.cos(t)}
        system = vj.System("my-system", states={"x": "m"}, parameters={"k": 1.0}, field=field, period=6.283185307179586)
        """)
    )
    names = {"a": "law", "b": "taken", "d": "Scene", "f": "system", "g": "stepper", "my-gauge": "gauge"}
    install(tmp_path, "mine", "objects", [f"{name} = mine:{thing}" for name, thing in names.items()])
    code = """
        import warnings
        import vibrojax as vj
        from vibrojax.measures import recorder_for
        with warnings.catch_warnings(record=True) as left_out:
            warnings.simplefilter("always")
            grid = {"gamma": [0.7]}
            run = {"method": "my-stepper"}
            sweep = vj.read_sweep({"scene": "my-scene", "parameters": {"friction": "mine"}, "grid": grid, "run": run})
        own = vj.read_sweep({"scene": "my-system", "grid": {"k": [1.0, 2.0]}})
        gauge = recorder_for(sweep.system).gauges[-2]
        print(sweep.scene, sweep.friction, sweep.run.stepper.name, type(gauge).__name__, own.system.name)
        print(*(one.message for one in left_out), sep="\\n")
        """
    process = subprocess.run([sys.executable, "-c", dedent(code)], capture_output=True, text=True, cwd=tmp_path)
    assert process.stdout.splitlines() == [
        "my-scene mine my-stepper Gauge my-system",
        'mine: vibrojax.objects: b: the name "coulomb" is taken; it is left out',
    ], process.stderr


def own_law(mu):
    slow = vj.parameters.table(vj.parameters.positive("vs", 1.0, "m s-1", "speed scale", "v_s"))
    return vj.FrictionLaw("mine", "own", slow, mu)


@pytest.mark.parametrize(
    ("mu", "message"),
    [
        (lambda u, p: p["vx"] * u, "friction law mine: mu asks for 'vx'; there is vs"),
        (lambda u, p: "0.3", "friction law mine: mu gave str; it must give a number"),
        (lambda u, p: u / np.exp(p["vs"]), "friction law mine: mu uses a function of np"),
        (lambda u, p: p["vs"] * jnp.tanh(u), "friction law mine: mu uses a function that steps cannot expand; use "),
    ],
)
def test_wrong_laws_end_in_one_line(mu, message):
    with pytest.raises(vj.InputError, match=message):
        vj.simulate("rotary", friction=own_law(mu), duration=2.0, progress=False)


def test_lanes_with_negative_friction_have_a_reason():
    law = own_law(lambda u, p: 0.4 - 0.2 * p["vs"])
    ds = vj.run_sweep({"scene": "rotary", "parameters": {"friction": law}, "grid": {"vs": [1.0, 3.0]}}, progress=False)
    names = ds.reason.attrs["flag_meanings"].split()
    assert [names[int(k)] for k in ds.reason.values[:, 0]] == ["none", "negative-friction-at-rest"]


OUTSIDE = Path(__file__).parent / "outside"
SWEEP = """scene = "rotary"
[grid]
v = [0.5, 1.0, 1.5]
[run]
settle = 10.0
observe = 8.0
"""


@pytest.fixture(scope="module")
def campbell(tmp_path_factory):
    """Return a folder with an installed package that registers a Campbell diagram, and the dataset of its command."""
    folder = tmp_path_factory.mktemp("outside")
    entry_points = ["campbell = campbell:Campbell", "broken = campbell:SAMPLES", "faulty = faulty:Campbell"]
    install(folder, "campbell", "analyses", entry_points)
    text = (OUTSIDE / "campbell.py").read_text()
    (folder / "campbell.py").write_text(text)
    faults = {'kind = "campbell"': 'kind = "faulty"', "np.hanning": "np.haning", ".4g": ".4q"}
    for right, wrong in faults.items():
        assert right in text
        text = text.replace(right, wrong)
    (folder / "faulty.py").write_text(text)
    (folder / "speeds.toml").write_text(SWEEP)
    with pytest.MonkeyPatch.context() as patch, chdir(folder), redirect_stdout(io.StringIO()) as printed:
        patch.syspath_prepend(folder)
        offered_analyses.cache_clear()
        assert main(["campbell", "speeds.toml", "--orders", "3"]) == 0
    assert "picture" in printed.getvalue()
    return folder


@pytest.fixture
def command(campbell, monkeypatch, capsys):
    """Return a function that runs a command with the package installed and returns its stdout, or stderr on failure."""
    monkeypatch.chdir(campbell)
    monkeypatch.syspath_prepend(campbell)
    offered_analyses.cache_clear()

    def run(*words, status=0):
        assert main(words) == status
        printed = capsys.readouterr()
        return printed.err if status else printed.out

    yield run
    offered_analyses.cache_clear()


def test_command_of_another_package_writes_dataset_and_picture(campbell):
    """Friction feeds the upper linear mode; a window of 8 s resolves 1/8 Hz."""
    assert (campbell / "speeds-campbell.png").stat().st_size > 10_000
    upper = vj.modes.natural_frequencies(vj.read_sweep(campbell / "speeds.toml").parameters)[1] / (2 * np.pi)
    with xr.open_dataset(campbell / "speeds-campbell.nc") as ds:
        assert ds.attrs["kind"] == "campbell" and ds.attrs["Conventions"] == "CF-1.11"
        assert np.abs(ds["fundamental"] - float(upper)).max() < 1 / 8


def test_help_info_and_plot_include_analysis_of_another_package(command):
    assert "campbell" in command("--help")
    own = " ".join(command("campbell", "--help").split())
    assert "Draw the spectrum of the bit over the axis of a sweep" in own and "highest frequency, Hz" in own
    assert own.index("--highest") < own.index("--orders")
    assert "spectrum  fundamental frequency from" in command("info", "speeds-campbell.nc")
    assert "strongest frequency of the bit" in command("scenes", "rotary")
    facts = json.loads(command("info", "speeds-campbell.nc", "--json"))
    assert facts["kind"] == "campbell" and len(facts["fundamental"]) == 2
    assert command("plot", "speeds-campbell.nc", "-o", "again.png") == "again.png\n" and Path("again.png").exists()


def test_broken_entry_point_is_refused_in_one_line(command):
    refused = command("broken", "speeds.toml", status=2)
    assert refused.count("\n") == 1 and "entry point vibrojax.analyses: broken" in refused
    command("scenes")  # does not import analyses that it does not need


def test_fault_of_an_analysis_is_not_that_of_the_file(command):
    vj.write_dataset(vj.open_dataset("speeds-campbell.nc").assign_attrs(kind="faulty"), "faulty.nc")
    for words, error in ((("info", "faulty.nc"), "ValueError"), (("faulty", "speeds.toml"), "AttributeError")):
        refused = command(*words, status=2)
        assert refused.count("\n") == 1 and f"{words[0]}: the code of faulty fails ({error}" in refused


class Medians(vj.Analysis):
    """The median of each variable over the axes of a sweep."""

    kind = "medians"

    def run(self, source, progress=True):
        return vj.run_sweep(source, progress=progress)[["period", "bit_amplitude"]].median()

    def summary(self, ds):
        return [vj.SummaryPart("medians", [f"period {ds.period:.3g} s"])]


def test_unregistered_analysis_object_runs():
    ds = vj.analyse({"scene": "rotary", "grid": {"v": [1.0, 1.5]}}, Medians(), progress=False)
    assert ds.attrs["kind"] == kind_of(ds) == "medians" and ds.attrs["source"].startswith("vibrojax")
    assert isinstance(analysis_of(ds), Medians)


@pytest.mark.parametrize("wrong", [Medians, 3, None])
def test_object_that_is_not_an_analysis_is_refused(wrong):
    assert "is not an Analysis" in refusal(vj.analyse, "regime-map", wrong)
    with pytest.raises(vj.InputError, match="Bare has no method run"):
        vj.analyse("regime-map", type("Bare", (vj.Analysis,), {"kind": "bare"})())
