"""The interface of an analysis, and the lookup of analyses by kind.

Known are the package's own analyses, those of installed packages, and those used in this process.
"""

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import xarray as xr

from vibrojax.errors import InputError, Place, printable, shown
from vibrojax.io.kinds import KIND, check_structure, dataset_attributes, kind_of
from vibrojax.io.variables import Variable, described
from vibrojax.settings.fields import Settings
from vibrojax.studies import GROUP, HOMES, offered_analyses

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from vibrojax.maps.sweep import Sweep
    from vibrojax.pictures.contents import Contents
    from vibrojax.pictures.plots import Picture

Source = Any
"""Input of an analysis: a dataset, or a sweep as `run_sweep` accepts it (path, bundled name, dict or `Sweep`)."""


class SummaryPart(NamedTuple):
    """One part of a summary: its `name`, its text as `lines`, and the same content as `facts`, a dict for JSON.

    **Example:**

    >>> part = vj.SummaryPart("spectrum", ["fundamental frequency 2.1 Hz"], {"fundamental": 2.1})
    >>> part.name, part.facts["fundamental"]
    ('spectrum', 2.1)
    """

    name: str
    lines: Sequence[str]
    facts: Mapping[str, object] = {}


class PictureRule(NamedTuple):
    """A rule that assigns a picture to datasets with certain contents.

    - `shows`: short description of the picture.
    - `fits`: function that returns whether the rule applies to a dataset. The argument of `fits` describes the dataset;
      its attributes `variables` and `dimensions` are sets of names, and `axes` lists the axes to draw along.
    - `draw`: function that takes the dataset and returns a matplotlib figure, or plots of
      [vibrojax.pictures.plots][], which the explorer page draws itself.

    **Example:**

    >>> from matplotlib.figure import Figure
    >>> def draw(ds):
    ...     figure = Figure()
    ...     figure.subplots().plot(ds["v"], ds["period"])
    ...     return figure
    >>> rule = vj.PictureRule("period over v", lambda contents: "v" in contents.dimensions, draw)
    >>> rule.shows
    'period over v'
    """

    shows: str
    fits: Callable[["Contents"], bool]
    draw: Callable[..., "Picture | Figure"]


class Analysis(Settings):
    """An analysis: an object with settings as attributes, and with a dataset as result.

    A subclass of `Analysis` must define `kind` and `run`; most also define `variables`, `picture` or `pictures`, and
    `summary`. If the subclass of `Analysis` is a dataclass, the fields become command-line options: `along: str = "v"`
    becomes `--along`, and `field(metadata={"help": ...})` sets the help text. Pass an instance of the subclass to
    [vibrojax.studies.analysis.analyse][], or register the class under the entry point `vibrojax.analyses`, which adds
    the command `vibrojax KIND FILE`.

    - `kind`: value of the attribute `kind` of the analysis's datasets, and name of the command; `command`: name of the
      command, if it differs.
    - `subject`: input of the command: "sweep", "machines" (a scene and its parameters, SCENE NAME=VALUE) or "file".
    - `variables`: the variables that the analysis adds to its datasets by name, with unit, meaning, type and flags.
    - `pictures`: rules that choose the picture of a dataset; the first rule that fits applies.
    - `counted`: dimension of the analysis's datasets whose size the command prints.
    - `view`: view in the explorer: "map", "curves" (over the map of a sweep), "families", "orbits", "motion", or
      "plots" (only the picture and the summary).

    **Example:** the fraction of lanes in each regime

    >>> import xarray as xr
    >>> class Shares(vj.Analysis):
    ...     kind = "shares"
    ...     variables = {"share": vj.Variable("1", "share of lanes")}
    ...     def run(self, source, progress=True):
    ...         lanes = source if isinstance(source, xr.Dataset) else vj.run_sweep(source, progress=progress)
    ...         regime = lanes.regime
    ...         flags = regime.attrs["flag_values"]
    ...         share = [float((regime == flag).mean()) for flag in flags]
    ...         return self.dataset({"share": ("flag", share)}, {"flag": flags}, title="Shares of regimes")
    >>> sweep = {"scene": "vibro-impact", "starts": ["stuck"], "grid": {"gamma": [0.7, 0.75, 0.8]}}
    >>> ds = vj.analyse(sweep, Shares(), progress=False)
    >>> ds.share.attrs["long_name"], float(ds.share.sum())
    ('share of lanes', 1.0)
    """

    subject: ClassVar[str] = "sweep"
    kind: ClassVar[str] = ""
    command: ClassVar[str] = ""
    variables: ClassVar[Mapping[str, Variable]] = {}
    pictures: ClassVar[Sequence[PictureRule]] = ()
    counted: ClassVar[str] = ""
    view: ClassVar[str] = "map"

    def view_of(self, ds: xr.Dataset) -> str:
        """Return the view of a dataset in the explorer."""
        return self.view

    def run(self, source: Source, progress: bool = True) -> xr.Dataset:
        """Analyse `source` and return the resulting dataset.

        **Raises:** `InputError` if `source` cannot be analysed.
        """
        raise InputError(f"analyse: {type(self).__name__} has no method run(source, progress)")

    def picture(self, ds: xr.Dataset, over: Sequence[xr.Dataset] = ()) -> "Figure":
        """Draw a dataset of this kind; `over`: datasets that are drawn on top.

        **Raises:** `InputError` if the dataset holds nothing to draw, or if `over` is given and the picture accepts no
        overlays.
        """
        from vibrojax.pictures.draw import draw
        from vibrojax.pictures.style import drawable

        layers = [drawable(layer) if isinstance(layer, xr.Dataset) else layer for layer in over]
        return draw(self.plots(drawable(ds), layers))

    def plots(self, ds: xr.Dataset, over: Sequence[xr.Dataset] = ()) -> "Picture | Figure":
        """Return the plots that form the picture of a dataset, or a figure; raise an error where `picture` does."""
        from vibrojax.pictures.contents import Contents
        from vibrojax.pictures.overlays import refuse_overlays

        if over:
            refuse_overlays(over, "the dataset holds none")
        held, kind = Contents(ds), kind_of(ds)
        if rule := next((rule for rule in self.pictures if rule.fits(held)), None):
            return rule.draw(ds)
        needed = "a picture needs regime, rate_of_penetration, C along form, or a motion along time; the dataset holds "
        needed += ", ".join(str(name) for name in ds.data_vars) or "no variable"
        if type(self) is Analysis and kind:
            needed = f'no analysis of kind "{kind}" is known here; install the package that made it'
        raise InputError(f"nothing to draw: {needed}")

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        """Return the parts of a summary that only this kind of dataset has; `vibrojax info` prints them."""
        return []

    def page_cells(self, ds: xr.Dataset) -> "tuple[xr.Dataset, Sweep | None] | None":
        """Return the cells that the explorer page shows beside the plots, and their sweep; by default none.

        Without a sweep, cells have no motions, and are chosen in the plots alone.
        """
        return None

    def page_text(self, ds: xr.Dataset) -> Sequence[SummaryPart]:
        """Return the texts that the explorer page shows of a dataset; by default its summary."""
        return self.summary(ds)

    def dataset(
        self,
        variables: Mapping[Any, Any],
        coords: Mapping[Any, Any],
        *,
        of: "Sweep | None" = None,
        **attributes: object,
    ) -> xr.Dataset:
        """Return a dataset of this kind, with title, provenance and history.

        **Arguments:** `variables`: (dimensions, values) by name, which receive the units and meanings in the class
        attribute `variables`; a variable that is not described there needs (dimensions, values, attributes). `coords`:
        coordinates, in the same form as `variables`. `of`: a sweep, whose scene and parameters are recorded in the
        dataset. `attributes`: further dataset attributes, such as `title`.
        """
        title, command = str(attributes.pop("title", self.kind)), self.command or self.kind
        if of is None:
            attrs = dataset_attributes(self.kind, title, command, **attributes)
        else:
            from vibrojax.maps.dataset import shared_attributes  # imports jax

            attrs = shared_attributes(of, self.kind, title, command) | attributes
        return xr.Dataset(described(variables, self.variables), described(coords, self.variables), attrs)


_USED: dict[str, Analysis] = {}
"""Analyses by kind that were passed to `analyse` in this process."""


def analyse(source: Source, analysis: Analysis | Any, progress: bool = True) -> xr.Dataset:
    """Run an analysis, and return its dataset.

    **Arguments:**

    - `source`: input of the analysis: a dataset, or a sweep as `run_sweep` accepts it.
    - `analysis`: instance of a subclass of [vibrojax.studies.analysis.Analysis][]. Once `analyse` has been called,
      functions such as `picture` accept the datasets of the analysis, within the same process.

    **Returns:** the dataset, with the attribute `kind`.

    **Raises:** `InputError` if `analysis` is not an `Analysis`, or if it cannot analyse `source`.

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
    if not isinstance(analysis, Analysis):
        raise InputError(f"analyse: {analysis!r} is not an Analysis; give an object of a subclass of vj.Analysis")
    kind = analysis.kind
    if not kind.isprintable() or not kind.replace("-", "").isalnum() or kind != kind.lower():
        raise InputError(f"analyse: kind {kind!r} of {type(analysis).__name__} is not a name of small letters and -")
    return checked_result(analysis, analysis.checked(Place(kind)).run(source, progress))


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
    if kind not in HOMES:
        _USED[kind] = analysis
    return ds


def analysis_of(ds: xr.Dataset) -> Analysis:
    """Return the analysis of a dataset's kind, or a plain `Analysis` if the kind is unknown."""
    return analysis_named(kind_of(ds)) or Analysis()


def analysis_named(kind: str) -> Analysis | None:
    """Return the analysis of a kind, or None if the kind is unknown.

    **Raises:** `InputError` if an installed package registers the kind, but its class cannot be loaded.
    """
    if kind in HOMES:
        module, _, name = HOMES[kind].partition(":")
        own: Analysis = getattr(import_module(f"vibrojax.studies.{module}"), name)()
        return own
    if kind in _USED:
        return _USED[kind]
    entry = offered_analyses().get(kind)
    if entry is None:
        return None
    place = f"entry point {GROUP}: {kind}"
    try:
        offered = entry.load()
    except Exception as error:  # third-party code may raise any exception
        raise InputError(f"{place}: cannot be imported ({printable(error, 200)})") from error
    if not (isinstance(offered, type) and issubclass(offered, Analysis) and offered.kind == kind):
        raise InputError(f"{place}: {shown(entry.value)} is not a subclass of Analysis with kind {shown(kind)}")
    return offered()
