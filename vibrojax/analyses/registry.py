"""Lookup of analyses by kind: the package's own, those of installed packages, and those used in this process."""

from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points

import xarray as xr

from vibrojax.analyses.analysis import Analysis, Source, check_analysis
from vibrojax.errors import InputError, printable, shown
from vibrojax.io.kinds import KIND, check_structure, dataset_attributes, kind_of
from vibrojax.io.variables import Variable

GROUP = "vibrojax.analyses"
"""Entry-point group in which an installed package registers its analyses, as `NAME = "module:Class"`."""

_HOMES = {
    "sweep": "sweep.analysis:Sweeps",
    "trajectory": "trajectory.analysis:Trajectories",
    "family": "continuation.analysis:Families",
    "borders": "borders.analysis:Borders",
    "attractors": "attractors.analysis:Attractors",
    "push": "push.analysis:Pushes",
    "tolerance": "tolerance.analysis:Tolerances",
    "fit": "rop_law.picture:Fits",
    "accuracy": "accuracy.picture:AccuracyStudy",
    "derivatives": "sensitivity.run:Derivatives",
}
"""Module and class of each of the package's own analyses, which are imported when they are needed."""

_USED: dict[str, Analysis] = {}
"""Analyses by kind that were passed to `analyse` in this process."""


def analyse(source: Source, analysis: Analysis, progress: bool = True) -> xr.Dataset:
    """Run an analysis, and return its dataset.

    **Arguments:**

    - `source`: input of the analysis: a dataset, or a sweep as `run_sweep` accepts it.
    - `analysis`: instance of a subclass of [vibrojax.analyses.analysis.Analysis][]. From then on, `picture` and the
      other functions support its datasets in this process. For all processes, register the class under the entry point
      `vibrojax.analyses` of an installed package.
    - `progress`: whether to report progress on stderr.

    **Returns:** the dataset, with the attribute `kind`.

    **Raises:** `InputError` if `analysis` is not an `Analysis`, or `source` cannot be analysed.

    **Example:**

    >>> class Median(vj.Analysis):
    ...     kind = "median"
    ...     def run(self, source, progress=True):
    ...         ds = vj.run_sweep(source, progress=progress)
    ...         return ds[["period"]].median("gamma")
    >>> ds = vj.analyse({"scene": "rotary", "grid": {"gamma": [0.6, 0.7, 0.8]}}, Median(), progress=False)
    >>> ds.attrs["kind"]
    'median'
    """
    check_analysis(analysis)
    return checked_result(analysis, analysis.run(source, progress))


def checked_result(analysis: Analysis, ds: xr.Dataset) -> xr.Dataset:
    """Return the dataset that an analysis made, with its kind and provenance; `picture` supports the kind from then on.

    **Raises:** `InputError` if the analysis returned something else than a well-formed dataset.
    """
    if not isinstance(ds, xr.Dataset):
        raise InputError(f"analyse: {type(analysis).__name__}.run returned {type(ds).__name__}, not an xarray.Dataset")
    kind = analysis.kind
    if ds.attrs.get(KIND) != kind:
        ds = ds.assign_attrs(dataset_attributes(kind, str(ds.attrs.get("title", kind)), kind) | ds.attrs | {KIND: kind})
    check_structure(ds)
    if kind not in _HOMES:
        _USED[kind] = analysis
    return ds


def analysis_of(ds: xr.Dataset) -> Analysis:
    """Return the analysis of a dataset's kind, or a plain `Analysis` if the kind is unknown."""
    return analysis_named(kind_of(ds)) or Analysis()


def analysis_named(kind: str) -> Analysis | None:
    """Return the analysis of a kind, or None if the kind is unknown.

    **Raises:** `InputError` if an installed package registers the kind, but its class cannot be loaded.
    """
    if kind in _HOMES:
        module, _, name = _HOMES[kind].partition(":")
        own: Analysis = getattr(import_module(f"vibrojax.analyses.{module}"), name)()
        return own
    if kind in _USED:
        return _USED[kind]
    entry = offered_analyses().get(kind)
    return None if entry is None else load_analysis(entry)()


@cache
def offered_analyses() -> dict[str, EntryPoint]:
    """Return the entry points of analyses in installed packages, by kind; vibrojax's own kinds cannot be replaced."""
    return {entry.name: entry for entry in entry_points(group=GROUP) if entry.name not in _HOMES}


def load_analysis(entry: EntryPoint) -> type[Analysis]:
    """Import the analysis class of an entry point.

    **Raises:** `InputError` with a one-line message if the class cannot be imported or is not an analysis of that kind.
    """
    place = f"entry point {GROUP}: {entry.name}"
    try:
        offered = entry.load()
    except Exception as error:  # third-party code may raise any exception
        raise InputError(f"{place}: cannot be imported ({printable(error, 200)})") from error
    if not (isinstance(offered, type) and issubclass(offered, Analysis) and offered.kind == entry.name):
        raise InputError(f"{place}: {shown(entry.value)} is not a subclass of Analysis with kind {shown(entry.name)}")
    return offered


def offered_variables() -> dict[str, Mapping[str, Variable]]:
    """Return the variables of each analysis in installed packages, by kind; unloadable analyses are left out."""
    variables = {}
    for kind, entry in offered_analyses().items():
        with suppress(InputError):  # the command of that analysis reports the error
            variables[kind] = load_analysis(entry).variables
    return variables
