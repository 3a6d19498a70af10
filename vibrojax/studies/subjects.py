"""Analyses by what they analyse: machines (points of a scene), a file of the user's, or the lanes of a sweep.

Reading and computing are two steps: a command checks all input, and looks for a finished result, before it computes.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Generic, Self, TypeVar

import xarray as xr

from vibrojax.errors import Place
from vibrojax.maps.machines import Machines, read_machines
from vibrojax.maps.rerun import orbits, sweep_with_orbits
from vibrojax.maps.sweep import Sweep
from vibrojax.settings.fields import settings_of
from vibrojax.studies.analysis import Analysis, Source, checked_result

Spec = TypeVar("Spec")
"""Class of the checked input: `Machines`, or a class of the analysis."""


class CheckedAnalysis(Analysis, Generic[Spec]):
    """An analysis whose input is checked before it is computed.

    A subclass provides `kind`, `identity` and `compute`. `file` is the default name of the command's file in `--help`.
    """

    file: ClassVar[str] = ""

    def identity(self, spec: Spec) -> dict[str, object]:
        """Return all settings on which the result depends, as flat JSON values."""
        raise NotImplementedError(f"{type(self).__name__}.identity")

    def facts(self, ds: xr.Dataset, spec: Spec) -> Mapping[str, object] | None:
        """Return what `--json` prints; None for the facts of the summary."""
        return None

    def compute(self, spec: Spec, progress: bool = True) -> xr.Dataset:
        """Return the result; raise `InputError` if there is none."""
        raise NotImplementedError(f"{type(self).__name__}.compute")

    def compute_beside(self, spec: Spec, out: Path, resume: bool, progress: bool) -> xr.Dataset:
        """Return the result; an analysis with chunks of lanes keeps finished ones beside `out` until it is written."""
        return self.compute(spec, progress)


class MachineAnalysis(CheckedAnalysis[Spec]):
    """An analysis of machines, whose settings, start and run settings are given together with the parameters.

    A subclass provides `kind` and `compute`. It overrides `machines` to check them, or to read them otherwise.

    - `scenes`: scenes that `--help` names; `terms`: terms of `vibrojax.studies.WORDS` that it defines.
    - `run_settings`: settings of the table [run] that may be given; `always`: those that the analysis needs.
    - `lists`: whether a parameter may have several values, each of a machine of its own.
    - `tolerances`: whether a parameter may be written NAME=VALUE+-HALF_WIDTH.
    """

    subject = "machines"
    scenes: ClassVar[str] = "rotary, vibro-impact, penetration, drilling or coupled-drilling"
    run_settings: ClassVar[tuple[str, ...]] = ("settle", "observe")
    always: ClassVar[Mapping[str, object]] = {}
    lists: ClassVar[bool] = True
    terms: ClassVar[tuple[str, ...]] = ()
    tolerances: ClassVar[bool] = False

    @classmethod
    def words(cls) -> tuple[str, ...]:
        """Return the names that are not parameters on the command line."""
        return ("start", *settings_of(cls), *cls.run_settings)

    @classmethod
    def of_words(cls, values: dict[str, Any]) -> dict[str, Any]:
        """Return the values for `asked` from the values of the command line."""
        return values

    @classmethod
    def asked(cls, scene: object, values: Mapping[str, object], parameters: Mapping[str, object]) -> tuple[Self, Spec]:
        """Return the analysis with its settings, and the checked machines.

        **Arguments:** `values`: settings, `start` and settings of the run by name, None for a default.

        **Raises:** `InputError` with a one-line message at the first error.
        """
        place, beside = Place(cls.command or cls.kind), ("start", *cls.run_settings)
        analysis = cls.read(place, {name: value for name, value in values.items() if name not in beside})
        run = {name: values[name] for name in cls.run_settings if values.get(name) is not None}
        return analysis, analysis.machines(place, scene, parameters, values.get("start"), run | dict(cls.always))

    def machines(
        self, place: Place, scene: object, parameters: Mapping[str, object], start: object, run: Mapping[str, object]
    ) -> Spec:
        """Return the checked machines, the argument of `compute`."""
        machines: Any = read_machines(place, scene, parameters, start, run)
        return machines

    def identity(self, spec: Spec) -> dict[str, object]:
        assert isinstance(spec, Machines)  # else the analysis has its own
        identity = spec.sweep.identity()
        for name, value in self.described().items():
            identity |= {f"{name}_{key}": x for key, x in value.items()} if isinstance(value, dict) else {name: value}
        return identity

    def file_name(self, spec: Spec) -> str:
        """Return the name of the command's file."""
        assert isinstance(spec, Machines)
        return f"{spec.sweep.scene}-{self.kind}.nc"


class FileAnalysis(CheckedAnalysis[Spec]):
    """An analysis of a file of the user's: a TOML file, or a bundled name.

    A subclass provides `kind`, `about`, `asked`, `identity` and `compute`.

    - `about`: what FILE is, in `--help`; `columns`: help of the option `--columns`, empty if there is none.
    - `chunks`: whether finished chunks of its lanes are kept beside the file of the result until that is written.
    """

    subject = "file"
    about: ClassVar[str] = ""
    columns: ClassVar[str] = ""
    chunks: ClassVar[bool] = False

    def asked(self, file: Any, columns: Mapping[str, str] | None = None) -> Spec:
        """Return the checked content of the file; raise `InputError` at the first error."""
        raise NotImplementedError(f"{type(self).__name__}.asked")

    def run(self, source: Any, progress: bool = True) -> xr.Dataset:
        """Return the dataset of the analysis of a file, or of a dict with the same structure."""
        return self.compute(self.asked(source), progress)


class SweepAnalysis(Analysis):
    """An analysis of the lanes of a sweep and their periodic orbits.

    A subclass of `SweepAnalysis` must define `kind` and `of_lanes`. Override the method `sweep` to accept only some
    sweeps, and the method `identity` if the result depends on settings.

    **Example:** the fraction of lanes that settle on a stable orbit

    >>> class StableShare(vj.SweepAnalysis):
    ...     kind = "stable-share"
    ...     def of_lanes(self, sweep, lanes, progress=True):
    ...         return self.dataset({"share": ((), float((lanes.stable == 1).mean()))}, {}, title=sweep.title)
    >>> point = {"beta": 0.4, "gamma": 0.75, "delta": 0.005}
    >>> sweep = {"scene": "vibro-impact", "parameters": point, "starts": ["stuck"]}
    >>> vj.analyse(sweep, StableShare(), progress=False).share.item()
    1.0
    """

    def sweep(self, source: Source) -> Sweep:
        """Return the sweep of `source` with `orbits = true`; raise `InputError` if the sweep cannot be analysed."""
        return sweep_with_orbits(source)

    def identity(self, sweep: Sweep) -> dict[str, object]:
        """Return the settings, other than the sweep, on which the result depends, as flat JSON values."""
        return {self.kind: True}

    def of_lanes(self, sweep: Sweep, lanes: xr.Dataset, progress: bool = True) -> xr.Dataset:
        """Return the dataset of the analysis; `lanes`: dataset of the sweep, with orbits."""
        raise NotImplementedError(f"{type(self).__name__}.of_lanes")

    def run(self, source: Source, progress: bool = True) -> xr.Dataset:
        """Return the dataset of the analysis; unless `source` is a dataset with orbits, its sweep is run first."""
        sweep = self.sweep(source)
        return self.of_lanes(sweep, orbits(source if isinstance(source, xr.Dataset) else sweep, progress), progress)


def answered(
    kind: type[MachineAnalysis[Any]],
    scene: object,
    values: Mapping[str, object],
    parameters: Mapping[str, object],
    progress: bool,
) -> xr.Dataset:
    """Return the dataset of an analysis of machines with these settings; see `MachineAnalysis.asked`."""
    analysis, machines = kind.asked(scene, values, parameters)
    return checked_result(analysis, analysis.compute(machines, progress))
