"""Test the input of a fit: datasets, files, rig data, the command, and refusals."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from vibrojax.cli import main
from vibrojax.errors import InputError
from vibrojax.io.dataset import open_dataset
from vibrojax.io.writers import write_dataset
from vibrojax.studies.rop_law import fit_rop
from vibrojax.studies.rop_results import tables

C, ETA0 = 1.3e-3, 0.21
RELIEF = np.linspace(0.25, 1.5, 8)
RATE = C * np.log(RELIEF / ETA0)


def sweep(**more):
    """Return a dataset like that of a penetration sweep, with a rate of the onset form along frequency."""
    force = np.array([2e5, 3e5])
    variables = {
        "rate_of_penetration": (("force", "frequency"), np.outer([1.0, 2.0], RATE)),
        "relief": (("force", "frequency"), np.stack([RELIEF, RELIEF])),
        "status": (("force", "frequency"), np.zeros((2, 8), np.int8)),
    }
    coordinates = {"force": ("force", force, {"units": "N"}), "frequency": np.linspace(10, 40, 8), "k3": 3e8}
    attributes = {"source": "vibrojax 0", "title": "a sweep", "scene": "penetration", "history": "made"}
    return xr.Dataset(variables, coordinates, attributes).assign(**more)


def rows(*names, **columns):
    """Return the text of a CSV file."""
    lines = zip(*(np.broadcast_to(columns[name], RELIEF.shape) for name in names), strict=True)
    return "\n".join([",".join(names), *(",".join(str(cell) for cell in line) for line in lines)]) + "\n"


def refused(data, *arguments, **named) -> str:
    with pytest.raises(InputError) as caught:
        fit_rop(data, *arguments, **named)
    line = str(caught.value)
    assert "\n" not in line
    return line


# datasets


@pytest.mark.parametrize(
    ("data", "named", "line"),
    [
        (sweep().drop_vars("relief"), {}, "fit_rop: relief: missing; a sweep of a scene with rock has it, this holds"),
        (sweep(), {"along": "frequncy"}, 'along: "frequncy" is not an axis of the data; did you mean "frequency"?'),
        (sweep().isel(force=0, frequency=0), {}, "along: there is one lane only; a law needs an axis of several"),
        (3, {}, "fit_rop: 3 is not data; give a dataset or a path"),
    ],
)
def test_wrong_data_are_refused(data, named, line):
    assert line in refused(data, **named)


# rig data


def test_rig_data_match_dataset(tmp_path):
    path = tmp_path / "rig.csv"
    path.write_text(
        rows("depth", "relief", "rate_of_penetration", depth="3 m", relief=RELIEF, rate_of_penetration=RATE)
    )
    fit = fit_rop(path, progress=False)
    assert fit.C.sizes == {"form": 6} and fit.attrs["along"] == "point"
    expected = fit_rop(sweep().isel(force=0), progress=False)
    np.testing.assert_allclose(fit.C.sel(form="onset"), expected.C.sel(form="onset"), rtol=1e-9)


def test_missing_relief_is_computed_from_force_and_threshold(tmp_path):
    path = tmp_path / "rig.csv"
    columns = {"mean_force": RELIEF * 1.5e5, "threshold": 1.5e5, "rate_of_penetration": RATE}
    path.write_bytes(b"\xef\xbb\xbf" + rows(*columns, **columns).replace("\n", "\r\n").encode())
    assert fit_rop(path, progress=False).sel(form="onset").eta0.item() == pytest.approx(ETA0)


def test_columns_define_groups(tmp_path):
    """The rows have two forces and rocks in unequal numbers. Each group gives the same fit as alone."""
    path = tmp_path / "rig.csv"
    lines = [f"{f:.17g},{e:.17g},{r:.17g},granite,1e5" for f, e, r in zip(range(8), RELIEF, RATE, strict=True)]
    lines += [f"{f},{e:.17g},{2 * r:.17g},chalk,2e5" for f, e, r in zip(range(6), RELIEF, RATE, strict=False)]
    lines.insert(3, "9,0.5,nan,granite,1e5")
    path.write_text("frequency,relief,rate_of_penetration,rock,force\n" + "\n".join(lines) + "\n")
    for named in ({"along": "frequency"}, {"by": ("rock", "force")}, {"by": "rock"}):
        fit = fit_rop(path, progress=False, **named).sel(form="onset")
        assert fit.C.sizes == {"group": 2} and list(fit.rock.values) == ["chalk", "granite"]
        assert list(fit.used.values) == [6, 8] and list(fit.left_out.values) == [0, 1]
        np.testing.assert_allclose(fit.C, [2 * C, C], rtol=1e-10)
    assert "rock=chalk, force=200000" in "\n".join(tables(fit_rop(path, "frequency", progress=False)))
    assert fit_rop(path, progress=False).sel(form="onset").used.item() == 14
    assert 'by: "rok" is not a column of the data; did you mean "rock"?' in refused(path, by="rok")
    assert 'by: "force" is not a column of the data: the data are not a table' in refused(sweep(), by="force")


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("relief,rate_of_penetration\n", "rig.csv: no rows; add a line for each measurement"),
        (
            "relief,rate_of_penetraton\n1,2\n",
            'rig.csv: column rate_of_penetration [m/s] is missing; if "rate_of_penetraton" is it',
        ),
        ("relief,rate_of_penetration\n1\n", "rig.csv: line 2 has 1 cell; 2 are needed"),
        ("relief,rate_of_penetration\n1,2\n\nx,1\n", 'rig.csv: line 4, column relief: "x" is not a number'),
        (b"\xff\xfe", "rig.csv: not UTF-8 text (byte 0)"),
    ],
)
def test_wrong_rig_data_are_refused(tmp_path, text, line):
    path = tmp_path / "rig.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    assert line in refused(path).replace(f"{tmp_path}/", "")


# the command


def test_command_prints_tables_and_writes_fit(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_dataset(sweep(), "map.nc")
    assert main(["fit", "map.nc"]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] == "force=200000 N: 8 lanes along frequency"
    assert printed[1].split() == ["form", "C", "[m/s]", "eta0", "exponent", "R2", "AIC"]
    assert printed[4].startswith("  onset") and "0.0013 ± " in printed[4]
    assert printed[9] == "force=300000 N: 8 lanes along frequency"
    assert "all groups together: the data support onset" in printed
    assert "the log law holds in 2 of 2, as onset in 2" in printed
    assert printed[-3] == "  force=200000 N: C = 0.0013 m/s (0.0013 to 0.0013), onset"
    assert printed[-1] == "map-fit.nc; picture map-fit.png"
    stored = open_dataset("map-fit.nc")
    xr.testing.assert_allclose(stored, fit_rop("map.nc", progress=False))
    assert list(stored.form.values) == ["literal", "percent", "onset", "line", "power", "constant"]
    assert stored.reason.dtype == np.int8 and stored.attrs["Conventions"] == "CF-1.11"
    assert main(["info", "map-fit.nc"]) == 0
    assert "a sweep" in capsys.readouterr().out


def test_fit_without_penetration_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_dataset(sweep(rate_of_penetration=(("force", "frequency"), np.zeros((2, 8)))), "map.nc")
    assert main(["fit", "map.nc"]) == 2
    out, err = capsys.readouterr()
    reason = "map.nc: nothing penetrates in any of 16 lanes, so there is no rate to fit"
    assert err == f"vibrojax: {reason}; vibrojax info map.nc says what would give a rate\n"
    assert not out and not Path("map-fit.nc").exists()


@pytest.mark.parametrize(
    ("argv", "line"),
    [
        (["fit", "map.nc", "-o", "a.png"], '-o: "a.png" does not end in .nc'),
        (["fit", "map.nc", "--along", "k3"], 'map.nc: along: "k3" is not an axis of the data; '),
    ],
)
def test_command_refuses_bad_input_in_one_line(tmp_path, monkeypatch, capsys, argv, line):
    monkeypatch.chdir(tmp_path)
    write_dataset(sweep(), "map.nc")
    assert main(argv) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1 and line in captured.err
    assert not list(tmp_path.glob("*-fit.nc"))
