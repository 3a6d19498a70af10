"""The interface of an analysis: how it runs, and how its datasets are drawn, summarised and explored."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import xarray as xr

from vibrojax.errors import InputError
from vibrojax.io.kinds import dataset_attributes, kind_of
from vibrojax.io.variables import Variable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from vibrojax.plot.contents import Contents

Source = Any
"""Input of an analysis: a dataset, or a sweep as `run_sweep` accepts it (path, bundled name, dict or `Sweep`)."""


class SummaryPart(NamedTuple):
    """One part of a summary: `lines` of text printed under `name`, and the same content as `facts` by JSON key.

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
    - `fits`: function that returns whether the rule applies. Its argument has facts about the dataset as attributes:
      the names of its `variables` and `dimensions`, its `axes`, and others.
    - `draw`: function that takes the dataset and returns a matplotlib figure.

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
    draw: Callable[..., "Figure"]


class Analysis:
    """An analysis, whose settings are attributes of the object and whose result is a dataset.

    A subclass provides `kind` and `run`, and usually `variables`, `picture` or `pictures`, and `summary`. If the
    subclass is a dataclass, its fields become command-line options: `along: str = "v"` becomes `--along`, and
    `field(metadata={"help": ...})` sets the help text. Pass an instance to [vibrojax.analyses.registry.analyse][], or
    register the class under the entry point `vibrojax.analyses`. A registered class adds the command
    `vibrojax KIND FILE`, and `plot`, `info`, `explore` and `list_variables` support its datasets.

    **Example:** the fraction of lanes in each regime

    >>> class Shares(vj.Analysis):
    ...     kind = "shares"
    ...     variables = {"share": vj.Variable("1", "share of lanes")}
    ...     def run(self, source, progress=True):
    ...         regime = vj.run_sweep(source, progress=progress).regime
    ...         flags = regime.attrs["flag_values"]
    ...         share = [float((regime == flag).mean()) for flag in flags]
    ...         return self.dataset({"share": ("flag", share)}, {"flag": flags}, title="Shares of regimes")
    >>> sweep = {"scene": "vibro-impact", "starts": ["stuck"], "grid": {"gamma": [0.7, 0.75, 0.8]}}
    >>> ds = vj.analyse(sweep, Shares(), progress=False)
    >>> ds.share.attrs["long_name"], float(ds.share.sum())
    ('share of lanes', 1.0)
    """

    kind: ClassVar[str] = ""
    """Attribute `kind` of the analysis's datasets, and name of its command."""

    variables: ClassVar[Mapping[str, Variable]] = {}
    """Variables by name that sweeps do not have: units, meaning, type and flags of each."""

    pictures: ClassVar[Sequence[PictureRule]] = ()
    """Picture rules for the analysis's datasets; the first rule that fits is used."""

    counted: ClassVar[str] = ""
    """Dimension of the analysis's datasets whose size the command prints."""

    view: ClassVar[str] = "map"
    """View in the explorer: "map", "curves" (drawn over the map of a sweep), "families", "motion" or "none"."""

    no_view: ClassVar[str] = ""
    """Reason why the explorer cannot show the analysis's datasets, if `view` is "none"."""

    def run(self, source: Source, progress: bool = True) -> xr.Dataset:
        """Analyse `source` and return the resulting dataset.

        **Raises:** `InputError` if `source` cannot be analysed.
        """
        raise NotImplementedError(f"{type(self).__name__}.run")

    def picture(self, ds: xr.Dataset, over: Sequence[xr.Dataset] = ()) -> "Figure":
        """Draw a dataset of this kind, with the datasets `over` drawn on top.

        **Raises:** `InputError` if the dataset holds nothing to draw, or its picture accepts no overlays.
        """
        from vibrojax.plot.contents import Contents
        from vibrojax.plot.overlays import refuse_overlays

        if over:
            refuse_overlays(over, "the dataset holds none")
        held = Contents(ds)
        rule = next((rule for rule in self.pictures if rule.fits(held)), None)
        if rule is None and type(self) is Analysis and kind_of(ds):
            raise InputError(
                f'nothing to draw: no analysis of kind "{kind_of(ds)}" is known here; install the package that made it'
            )
        if rule is None:
            names = ", ".join(str(name) for name in ds.data_vars) or "no variable"
            raise InputError(
                "nothing to draw: a picture needs regime, rate_of_penetration, C along form, or a motion along time; "
                f"the dataset holds {names}"
            )
        return rule.draw(ds)

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        """Return the parts of a dataset's summary that are specific to this kind; `info` prints them."""
        return []

    def dataset(self, variables: Mapping[Any, Any], coords: Mapping[Any, Any], **attributes: object) -> xr.Dataset:
        """Return a dataset of this kind with title, provenance and history; known variables get units and meanings.

        **Arguments:** `variables`: (dimensions, values) by name, or (dimensions, values, attributes) for variables that
        the class attribute `variables` does not describe; `coords`: coordinates in the same form; `attributes`: further
        dataset attributes, among them `title`.
        """
        title = str(attributes.pop("title", self.kind))
        described = {name: _described(self.variables, name, given) for name, given in variables.items()}
        axes = {name: _described(self.variables, name, given) for name, given in coords.items()}
        return xr.Dataset(described, axes, dataset_attributes(self.kind, title, self.kind, **attributes))


def _described(variables: Mapping[str, Variable], name: object, given: Any) -> Any:
    known = variables.get(str(name))
    if known is None or not isinstance(given, tuple) or len(given) != 2:
        return given
    return (*given, known.attributes())


def check_analysis(analysis: object) -> None:
    """Raise `InputError` if an object is not an analysis with a usable kind."""
    if not isinstance(analysis, Analysis):
        raise InputError(f"analyse: {analysis!r} is not an Analysis; give an object of a subclass of vj.Analysis")
    kind = analysis.kind
    if not kind.isprintable() or not kind.replace("-", "").isalnum() or kind != kind.lower():
        raise InputError(f"analyse: kind {kind!r} of {type(analysis).__name__} is not a name of small letters and -")
