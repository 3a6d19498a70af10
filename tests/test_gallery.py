"""Tests of the gallery: each short script runs as it is and saves one picture, and the page shows all of them."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from matplotlib.image import imread

ROOT = Path(__file__).parents[1]
GALLERY = ROOT / "notebooks" / "gallery"
SCRIPTS = sorted(GALLERY.glob("*.py"))
PAGE = (GALLERY.parent / "gallery.md").read_text()
RUN = SCRIPTS[::6]
"""The scripts that run here. The build of the site runs all of them, and an error in one of them ends it."""

RUNS_ALL = """
import os, runpy, sys, traceback
for script in sys.argv[2:]:
    folder = os.path.join(sys.argv[1], os.path.basename(script)[:-3])
    os.mkdir(folder)
    os.chdir(folder)
    try:
        runpy.run_path(script, run_name="__main__")
    except Exception:
        traceback.print_exc()
"""


@pytest.fixture(scope="module")
def output(tmp_path_factory):
    """Run the scripts in one process, to compile once; return a folder with a folder of each script."""
    folder = tmp_path_factory.mktemp("gallery")
    command = [sys.executable, "-W", "error", "-c", RUNS_ALL, folder, *RUN]
    process = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert process.returncode == 0 and process.stdout == process.stderr == "", process.stdout + process.stderr
    return folder


def test_page_shows_every_script_with_its_picture():
    names = [script.stem for script in SCRIPTS]
    assert len(names) >= 12
    assert sorted(re.findall(r"\{literalinclude\} gallery/(\w+)\.py", PAGE)) == names
    assert sorted(re.findall(r'^made_by\("(\w+)"\)$', PAGE, re.MULTILINE)) == names
    assert len(re.findall(r'^    alt: "[^"]+"$', PAGE, re.MULTILINE)) == len(names)


@pytest.mark.parametrize("script", RUN, ids=lambda script: script.stem)
@pytest.mark.long
def test_script_saves_one_picture(script, output):
    (picture,) = (output / script.stem).iterdir()
    assert picture.name == f"{script.stem}.png"
    pixels = imread(picture)
    assert min(pixels.shape[:2]) > 400 and pixels.std() > 0.05  # 0 for a single colour
