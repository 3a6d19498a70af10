"""The study: every setting of every scene, one after the other."""

import time

import numpy as np
import xarray as xr

from vibrojax.accuracy._dataset import dataset_of
from vibrojax.accuracy._errors import errors_of, usable
from vibrojax.accuracy._lanes import SCENES, lanes_of
from vibrojax.accuracy._measure import Measured, Programs, is_supported, measure, unsupported
from vibrojax.accuracy._settings import REFERENCE, SECOND_REFERENCE, settings_of
from vibrojax.accuracy._told import Told
from vibrojax.errors import InputError, suggestion

REPEATS, QUICK_REPEATS = 5, 2
QUICK_SCENES = ("vibro-impact", "penetration")


def run_accuracy(scenes=None, quick: bool = False, progress: bool = True) -> xr.Dataset:
    """Measure speed against error.

    **Arguments:**

    - `scenes`: names of the scenes; None: all, or two where it is to be quick.
    - `quick`: few settings and lanes, some seconds: shows that it works, and little more.
    - `progress`: whether to say on stderr how far it is.

    **Returns:** a dataset along `setting`: string coordinates scene, method, precision and varied, with the `value` of
    what is varied; times, errors, and what failed and why.

    **Raises:** `InputError` where a scene is not one.
    """
    scenes = tuple(scenes or (QUICK_SCENES if quick else SCENES))
    for scene in scenes:
        if scene not in SCENES:
            raise InputError(f'accuracy: "{scene}" is no scene; {suggestion(scene, SCENES)}')
    began = time.monotonic()
    told = Told(sum(len(settings_of(scene, quick)) for scene in scenes), progress)
    measured, floors = [], {}
    for scene in scenes:
        of_scene, floors[scene] = _measured(scene, quick, told)
        measured += of_scene
    return dataset_of(measured, floors, time.monotonic() - began)


def _measured(scene: str, quick: bool, told: Told) -> tuple[list[Measured], float]:
    """What came of the settings of `scene`, and how far down errors can be told."""
    programs = Programs(lanes_of(scene, quick))
    reference, trusted, floor = _reference(programs)
    repeats = QUICK_REPEATS if quick else REPEATS
    found = []
    for setting in settings_of(scene, quick):
        if is_supported(setting):
            program, compile_time = programs.of(setting.method, setting.precision, setting.accuracy)
            result = measure(setting, program, compile_time, reference, trusted, repeats)
        else:
            result = unsupported(setting, int(trusted.sum()))
        found.append(result)
        told.add(result)
    return found, floor


def _reference(programs: Programs) -> tuple[dict, np.ndarray, float]:
    """Features at far finer tolerance, which lanes can be compared with them, and their own worst difference."""
    program, _ = programs.of("located", "float64", REFERENCE)
    fine, second = (program.features(one, program.run(one)) for one in (REFERENCE, SECOND_REFERENCE))
    trusted = usable(fine, second)
    return fine, trusted, float(errors_of(second, fine)["overall"][trusted].max())
