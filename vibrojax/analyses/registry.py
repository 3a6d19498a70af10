"""All analyses by their kind: the package's own, those that installed packages offer, and those of this process."""

from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points

import xarray as xr

from vibrojax.analyses.analysis import Analysis, Source, check_analysis
from vibrojax.errors import InputError, printable, shown
from vibrojax.io.kinds import KIND, dataset_attributes, kind_of
from vibrojax.io.structure import check_structure
from vibrojax.io.variables import Variable

GROUP = "vibrojax.analyses"
"""The entry point under which an installed package offers its analyses, `NAME = "module:Class"`."""

_HOMES = {
    "sweep": "sweep.analysis:Sweeps",
    "trajectory": "trajectory.analysis:Trajectories",
    "family": "continuation.analysis:Families",
    "borders": "borders.analysis:Borders",
    "attractors": "attractors.analysis:Attractors",
    "push": "push.analysis:Pushes",
    "fit": "rop_law.analysis:Fits",
    "accuracy": "accuracy.analysis:AccuracyStudy",
    "derivatives": "sensitivity.analysis:Derivatives",
}
"""Where each of the package's own analyses is defined; they are imported when they are needed."""

_USED: dict[str, Analysis] = {}
"""Analyses given to `analyse` in this process."""


def analyse(source: Source, analysis: Analysis, progress: bool = True) -> xr.Dataset:
    """Run an analysis, and return its dataset.

    **Arguments:**

    - `source`: what the analysis starts from: a dataset, or a sweep as `run_sweep` takes it.
    - `analysis`: an object of a subclass of [vibrojax.analyses.analysis.Analysis][]. `picture` and `vibrojax` know its
      datasets from then on, in this process; an installed package registers under the entry point `vibrojax.analyses`.
    - `progress`: whether to report progress on stderr.

    **Returns:** the dataset, with the attribute `kind`.

    **Raises:** `InputError` where `analysis` is not one, or `source` cannot be analysed.

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
    ds = analysis.run(source, progress)
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
    """Return the analysis of a dataset's kind; the base class's if nobody here knows the kind."""
    return analysis_named(kind_of(ds)) or Analysis()


def analysis_named(kind: str) -> Analysis | None:
    """Return the analysis of a kind; None if nobody here knows it.

    **Raises:** `InputError` where an installed package offers it, but it cannot be loaded.
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
    """Return the analyses that installed packages offer, by kind; the package's own kinds cannot be replaced."""
    return {entry.name: entry for entry in entry_points(group=GROUP) if entry.name not in _HOMES}


def load_analysis(entry: EntryPoint) -> type[Analysis]:
    """Return the class that a package offers.

    **Raises:** `InputError`, one line, where it cannot be imported, or is not an analysis of that kind.
    """
    place = f"entry point {GROUP}: {entry.name}"
    try:
        offered = entry.load()
    except Exception as error:  # a package of others may fail in any way
        raise InputError(f"{place}: cannot be imported ({printable(error, 200)})") from error
    if not (isinstance(offered, type) and issubclass(offered, Analysis) and offered.kind == entry.name):
        raise InputError(f"{place}: {shown(entry.value)} is not a subclass of Analysis with kind {shown(entry.name)}")
    return offered


def offered_variables() -> dict[str, Mapping[str, Variable]]:
    """Return the variables of each analysis that an installed package offers, except those that cannot be loaded."""
    variables = {}
    for kind, entry in offered_analyses().items():
        with suppress(InputError):  # the command of that analysis says what is wrong
            variables[kind] = load_analysis(entry).variables
    return variables
