"""The study: every setting of every scene, one after the other."""

import time
from collections.abc import Sequence

import numpy as np
import xarray as xr
from jaxtyping import Bool

from vibrojax.analyses.accuracy.cases import REFERENCE, SCENES, SECOND_REFERENCE, lanes_of, settings_of
from vibrojax.analyses.accuracy.programs import Features, Programs
from vibrojax.analyses.accuracy.report import dataset_of
from vibrojax.analyses.accuracy.timing import Measured, errors_of, is_supported, measure, unsupported, usable
from vibrojax.errors import InputError, suggestion
from vibrojax.progress import Progress

REPEATS, QUICK_REPEATS = 5, 2
QUICK_SCENES = ("vibro-impact", "penetration")


def run_accuracy(scenes: Sequence[str] | None = None, quick: bool = False, progress: bool = True) -> xr.Dataset:
    """Measure speed against error.

    **Arguments:**

    - `scenes`: names of the scenes; None: all, or two where it is to be quick.
    - `quick`: few settings and lanes, some seconds: shows that it works, and little more.
    - `progress`: whether to say on stderr how far it is.

    **Returns:** a dataset along `setting`: string coordinates scene, method, precision and varied, with the `value` of
    what is varied; times, errors, and what failed and why.

    **Raises:** `InputError` where a scene is not one.

    **Example:**

    >>> study = vj.run_accuracy(["penetration"], quick=True, progress=False)
    >>> located = study.isel(setting=study.method == "located")
    >>> bool((located.error_worst[located.precision == "float64"] < 1e-6).all())
    True
    """
    scenes = tuple(scenes or (QUICK_SCENES if quick else SCENES))
    for scene in scenes:
        if scene not in SCENES:
            raise InputError(f'accuracy: "{scene}" is no scene; {suggestion(scene, SCENES)}')
    began = time.monotonic()
    shown = Progress(sum(len(settings_of(scene, quick)) for scene in scenes), "settings", progress, pace=False)
    measured: list[Measured] = []
    floors = {}
    for scene in scenes:
        of_scene, floors[scene] = _measured(scene, quick, shown)
        measured += of_scene
    return dataset_of(measured, floors, time.monotonic() - began)


def _measured(scene: str, quick: bool, progress: Progress) -> tuple[list[Measured], float]:
    """What came of the settings of `scene`, and the least error that can be measured."""
    programs = Programs(lanes_of(scene, quick))
    reference, trusted, floor = _reference(programs)
    repeats = QUICK_REPEATS if quick else REPEATS
    measured = []
    for setting in settings_of(scene, quick):
        if is_supported(setting):
            program, compile_time = programs.of(setting.method, setting.precision, setting.accuracy)
            result = measure(setting, program, compile_time, reference, trusted, repeats)
        else:
            result = unsupported(setting, int(trusted.sum()))
        measured.append(result)
        progress.add(1, _outcome(result))
    return measured, floor


def _reference(programs: Programs) -> tuple[Features, Bool[np.ndarray, " lanes"], float]:
    """Features at far finer tolerance, which lanes can be compared with them, and their own worst difference."""
    program, _ = programs.of("located", "float64", REFERENCE)
    fine, second = (program.features(one, program.run(one)) for one in (REFERENCE, SECOND_REFERENCE))
    trusted = usable(fine, second)
    return fine, trusted, float(errors_of(second, fine)["overall"][trusted].max())


def _outcome(result: Measured) -> str:
    """What came of a setting, in a line."""
    one = result.setting
    name = f"{one.scene}: {one.method}, {one.precision}, {one.varied} {one.value:g}: "
    if not result.agreeing:
        return name + result.reason
    return f"{name}error {result.errors['overall'].max():.1e}, {1e6 * np.median(result.seconds):.3g} µs/lane-s"
