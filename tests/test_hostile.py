"""Datasets from others: every command ends in its result or in one line, soon, and prints nothing that steers."""

import json
import unicodedata

import netCDF4
import pytest
import xarray as xr
from hostile import HUGE, REFUSED, SHOWN, STEERING, longer_sweep

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.errors import InputError, escape_json, printable, shell_assignment
from vibrojax.explorer.document import check_names
from vibrojax.explorer.live import Live
from vibrojax.explorer.motions import LiveMotions

SWEEP = {
    "scene": "vibro-impact",
    "parameters": {"delta": 0.005},
    "grid": {"beta": [0.3, 0.35], "gamma": [0.65, 0.7]},
    "run": {"settle": 1.0, "observe": 1.0},
}
READ = (["info"], ["info", "--json"], ["plot"], ["explore"], ["explore", "--live", "--no-browser"], ["fit"])
RUN = (["orbits"], ["attractors"], ["borders"])
WRITES = {"plot": "png", "explore": "html", "fit": "nc", "orbits": "nc", "attractors": "nc", "borders": "nc"}


@pytest.fixture(scope="module")
def sweep() -> xr.Dataset:
    return vj.run_sweep(SWEEP, progress=False)


@pytest.fixture
def said(tmp_path, monkeypatch, capsys):
    """Return what a command says of a dataset: its status, and its lines on stdout and stderr."""
    monkeypatch.setattr(Live, "wait", lambda self: None)
    monkeypatch.setattr(LiveMotions, "warm", lambda self: None)

    def run(words, ds):
        path = tmp_path / "sent.nc"
        ds.to_netcdf(path)
        command, *options = words
        out = ["-o", str(tmp_path / f"out.{WRITES[command]}")] if command in WRITES and "--live" not in words else []
        status = main([command, str(path), *options, *out])
        printed = capsys.readouterr()
        return status, printed.out, printed.err

    return run


def steers(text):
    """Return the characters of a text that steer a terminal or the direction of writing."""
    return {one for one in text if one != "\n" and unicodedata.category(one) in ("Cc", "Cf", "Cs", "Zl", "Zp")}


@pytest.mark.parametrize(("number", "name"), list(enumerate(REFUSED)), ids=REFUSED)
def test_what_is_malformed_is_refused_in_one_line(sweep, said, number, name):
    """By every command in the same words: one reader checks what is opened, so that two commands at a time will do."""
    change, about = REFUSED[name]
    ds = change(sweep)
    commands = (*READ, *RUN)
    for words in (commands[0], commands[number % len(commands)]):
        status, out, err = said(words, ds)
        assert (status, out, err.count("\n")) == (2, "", 1), words
        assert f"sent.nc: {about}" in err or about in err, err
        assert len(err) < 500 and not steers(err) and "does not fit together" not in err


@pytest.mark.parametrize("name", SHOWN)
def test_what_is_unusual_is_shown_or_refused(sweep, said, name):
    """Shortened, without what steers a terminal; nothing is simulated for longer than it may."""
    alone = sweep.copy()
    del alone.attrs["sweep"]
    ds = SHOWN[name](alone).assign_attrs(source=sweep.attrs["source"])
    for words in READ:
        status, out, err = said(words, ds)
        assert status in (0, 2), (words, err)
        assert err.count("\n") <= 1 and len(err) < 5000, (words, err)
        assert len(out) < 100_000 and not steers(out + err), words
        assert "Traceback" not in err


@pytest.mark.parametrize("words", [["explore"], *RUN], ids=lambda words: words[0])
def test_a_sweep_that_hardly_ends_is_not_run_for_a_dataset(sweep, said, words, tmp_path):
    status, _, err = said(words, longer_sweep(sweep))
    why = "4 lanes of 1e+09 s, more than is run for a dataset"
    if words == ["explore"]:
        assert status == 0 and "lanes of 1e+09 s, more than is run" in (tmp_path / "out.html").read_text()
    else:
        assert status == 2 and err.count("\n") == 1 and why.removeprefix("4 ") in err


def test_a_dataset_names_no_sweep_of_other_lanes(sweep, said, tmp_path):
    """A small file has nobody compute a large sweep."""
    text = sweep.attrs["sweep"].replace("beta = [0.3, 0.35]", "beta = {start = 0.3, stop = 0.6, num = 1000}")
    assert text != sweep.attrs["sweep"]
    ds = sweep.assign_attrs(sweep=text, identity="{}")
    assert said(["explore"], ds)[0] == 0
    assert "other lanes than the sweep that it names" in (tmp_path / "out.html").read_text()


def test_content_that_does_not_fit_together_is_refused_in_one_line(sweep, said):
    """In ways that no check foresees, too."""
    ds = sweep.drop_vars("cycles").assign(share=1.0, share_stderr=1.0, lane_attractor=3)
    ds = ds.assign_attrs(kind="attractors")
    status, _, err = said(["info"], ds)
    assert status == 2 and err.count("\n") == 1 and "sent.nc: its content does not fit together (" in err


@pytest.mark.parametrize("words", READ[:3], ids=lambda words: words[-1])
def test_sizes_that_are_only_claimed_are_refused(tmp_path, capsys, words):
    """A file of some kilobytes with a dimension of 10^12."""
    path = tmp_path / "sent.nc"
    with netCDF4.Dataset(path, "w") as file:
        file.source = "vibrojax 0"
        for name in ("beta", "gamma"):
            file.createDimension(name, 10**6)
        file.createVariable("regime", "i1", ("beta", "gamma"), chunksizes=(1000, 1000))
    assert main([words[0], str(path), *words[1:]]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "claims 1e+03 GB" in err


def test_checks_hold_for_datasets_in_memory(sweep):
    ds = sweep.assign_attrs(differing="[1]")
    with pytest.raises(InputError, match="attribute differing"):
        vj.write_page(ds, "page.html", progress=False)
    with pytest.raises(InputError, match="attribute differing"):
        vj.picture(ds)
    with pytest.raises(InputError, match="__proto__"):
        check_names(sweep.rename(period="__proto__"))


def test_a_picture_leaves_the_dataset_as_it_is(sweep):
    ds = sweep.assign_attrs(title="costs $1, or $2")
    ds["period"].attrs["long_name"] = "a $ and a $"
    before = ds.copy(deep=True)
    figure = vj.picture(ds)
    assert "$1, or" in figure.get_suptitle()
    xr.testing.assert_identical(ds, before)


def test_numbers_of_json_keep_their_kinds(sweep, said):
    status, out, _ = said(["info", "--json"], sweep)
    facts = json.loads(out)
    assert status == 0 and facts["lanes"] == 8 and type(facts["certified"]["lanes"]) is int
    assert facts["parameters"]["delta"] == 0.005 and facts["run"]["settle"] == 1.0


def test_texts():
    assert not steers(printable(STEERING)) and printable(STEERING).endswith("b")
    assert len(printable(HUGE, 200)) == 200 and printable(HUGE, 200).endswith("…")
    assert printable("  a \t b ") == "a b" and printable("β, Δ = 5 mm") == "β, Δ = 5 mm"
    text = json.dumps({"a": STEERING, "b": "\U000e0041 é"}, ensure_ascii=False)
    assert json.loads(escape_json(text)) == json.loads(text) and not steers(escape_json(text))


@pytest.mark.parametrize("value", ["ROP (m/h)", "$(touch x)", "`x`", 'a"b', "a'b", "a\\b", "$HOME", "a;b", "!x", ""])
def test_a_value_is_one_word_of_a_shell(value):
    import shlex

    assert shlex.split(shell_assignment("mean_force", value)) == [f"mean_force={value}"]
    word = shell_assignment("mean_force", value)
    assert "'" in word or not set(value) & set('$`"\\!')


def test_columns_that_are_advised_are_one_word_of_a_shell(tmp_path, capsys):
    """The names of a CSV's columns come from its author."""
    path = tmp_path / "rig.csv"
    path.write_text('"ROP $(touch hacked) [m/h]",relief\n1.0,0.5\n')
    assert main(["fit", str(path)]) == 2
    err = capsys.readouterr().err
    assert "'rate_of_penetration=ROP $(touch hacked)" in err and err.count("\n") == 1
