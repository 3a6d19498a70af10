"""Tell what a dataset holds: scene, grid, regimes, failures, accuracy, provenance; or how far a sweep is."""

from argparse import ArgumentParser
from collections.abc import Hashable
from pathlib import Path
from typing import TYPE_CHECKING

from vibrojax.analyses.glossary import WORDS
from vibrojax.cli._command import Options
from vibrojax.cli._complete import files, with_completer
from vibrojax.cli._facts import facts
from vibrojax.cli._family_lines import family_lines
from vibrojax.cli._found import found_lines
from vibrojax.cli._json import HELP, flags, print_json
from vibrojax.cli._orbit_lines import orbit_lines
from vibrojax.cli._standing import folder_of, standing_facts, standing_lines
from vibrojax.cli.attractors import attractor_lines
from vibrojax.cli.borders import border_lines
from vibrojax.errors import printable
from vibrojax.progress import timed

if TYPE_CHECKING:
    import numpy as np
    import xarray

_FAILURES_SHOWN = 3
_LONGEST_LINE = 2000
"""Characters of a line that are shown."""
_ACCEPTED = 1e-4
"""Accepted relative error if the dataset does not say: the sweep file's default."""


def arguments(parser: ArgumentParser) -> None:
    """Add the command's arguments to `parser`."""
    file = parser.add_argument(
        "file", metavar="OUT.nc", help="a dataset written by vibrojax, or the folder of one that is underway"
    )
    with_completer(file, files(".nc"))
    parser.add_argument("--json", action="store_true", help=HELP)


def run(options: Options) -> None:
    """Run the command."""
    from vibrojax.io.dataset import open_dataset

    folder = folder_of(Path(options.file))
    if folder is not None:
        from vibrojax.io.standing import standing

        found = standing(folder)
        if options.json:
            print_json(standing_facts(found))
        else:
            print("\n".join(standing_lines(found)))
        return
    with timed("read"):
        dataset = open_dataset(Path(options.file))
    if options.json:
        print_json(facts(dataset, options.file))
    else:
        print("\n".join(describe(dataset)))


def describe(dataset: "xarray.Dataset") -> list[str]:
    """The lines that tell what `dataset` holds; what it lacks is left out."""
    from vibrojax.analyses.rop_law.columns import columns_lines
    from vibrojax.io.attributes import attribute_of, history_of, text_of, title_of

    lines = [("title", [title_of(dataset)]), ("scene", [text_of(dataset, "scene")])]
    lines = [(name, texts) for name, texts in lines if any(texts)]
    lines.append(("grid", _grid(dataset)))
    if "lanes" in dataset.attrs:
        lines.append(("lanes", [f"{attribute_of(dataset, 'lanes')} (a lane: {WORDS['lane']})"]))
    lines.append(("friction", [text_of(dataset, "friction")] if "friction" in dataset.attrs else []))
    lines.append(("fixed", _fixed(dataset)))
    lines.append(("run", _times(dataset)))
    lines.append(("columns", columns_lines(dataset)))
    lines += [
        ("found", found_lines(dataset)),
        ("regimes", _regimes(dataset) + _hidden(dataset)),
        ("orbits", orbit_lines(dataset)),
        ("natures", _natures(dataset)),
        ("families", family_lines(dataset)),
        ("borders", border_lines(dataset)),
        ("shares", attractor_lines(dataset)),
        ("failures", _failures(dataset)),
        ("accuracy", _accuracy(dataset) + _flips(dataset)),
    ]
    lines.append(("variables", [", ".join(str(name) for name in dataset.data_vars)]))
    provenance = [name for name in ("solver", "source", "jax") if name in dataset.attrs]
    lines += [(name, [str(dataset.attrs[name])]) for name in provenance]
    lines.append(("history", history_of(dataset) if "history" in dataset.attrs else []))
    if "wall_time_s" in dataset.attrs:
        lines.append(("wall time", [f"{attribute_of(dataset, 'wall_time_s'):.3g} s"]))
    shown = (f"{'' if index else name:<10}{_line(text)}" for name, texts in lines for index, text in enumerate(texts))
    return [line.rstrip() for line in shown]


def _line(text: str) -> str:
    """Return a line as it is shown: its columns as they are, but nothing that steers a terminal."""
    words = text.lstrip(" ")
    return text[: len(text) - len(words)] + printable(words, _LONGEST_LINE, keep_spaces=True)


def _fixed(dataset: "xarray.Dataset") -> list[str]:
    """Return the fixed parameters: those that are not the defaults one by one, then the others."""
    from vibrojax.io.attributes import differing_of, parameters_of

    changed = {
        one["name"]: f"{_with_unit(one['value'], one['units'])} (default {one['default']:g})"
        for one in differing_of(dataset)
    }
    others = [f"{name} = {value:g}" for name, value in parameters_of(dataset).items() if name not in changed]
    if "parameters" not in dataset.attrs:
        return []
    lines = [f"{name} = {text}" for name, text in changed.items()]
    if others:
        lines.append(("by default: " if "differing" in dataset.attrs else "") + ", ".join(others))
    return lines


def _with_unit(value: float, unit: str) -> str:
    return f"{value:g}" if unit == "1" else f"{value:g} {unit}"


def _times(dataset: "xarray.Dataset") -> list[str]:
    """Return how long lanes settled and were observed, on which their labels depend."""
    from vibrojax.io.attributes import run_of

    run = run_of(dataset)
    known = {"settle", "observe"} <= set(run)
    return [f"settled for {run['settle']:g} s, observed for {run['observe']:g} s"] if known else []


def _grid(dataset: "xarray.Dataset") -> list[str]:
    """Each dimension: its range and size."""
    return [_dimension(dataset, name, size) for name, size in dataset.sizes.items()]


def _dimension(dataset: "xarray.Dataset", name: Hashable, size: int) -> str:
    if name not in dataset.coords or not size:
        return f"{name}: {size}"
    values = dataset[name].values
    if values.dtype.kind not in "fiu":
        few = ", ".join(str(value) for value in values[:8])
        return f"{name}: {few}{', ...' if size > 8 else ''} ({size})"
    unit = dataset[name].attrs.get("units", "1")
    return f"{name}: {values[0]:g} to {values[-1]:g}{'' if unit == '1' else f' {unit}'} ({size})"


def _regimes(dataset: "xarray.Dataset") -> list[str]:
    if not _of_lanes(dataset):
        return []
    regime = dataset["regime"]
    total = max(regime.size, 1)
    counted = [(meaning, int((regime.values == value).sum())) for value, meaning in flags(regime).items()]
    return [f"{meaning:<14}{count:>9}{100 * count / total:>7.1f} %" for meaning, count in counted if count]


def _of_lanes(dataset: "xarray.Dataset") -> bool:
    """Whether regimes are those of lanes, rather than of one motion or of attractors."""
    return "regime" in dataset and not {"time", "attractor"} & set(dataset.dims)


def _natures(dataset: "xarray.Dataset") -> list[str]:
    """How many lanes are periodic, chaotic and so on, and how many of them those labels call irregular."""
    if "nature" not in dataset or "regime" not in dataset:
        return []
    nature = dataset["nature"]
    labels = [flag for flag, name in flags(dataset["regime"]).items() if name == "irregular"]
    irregular = dataset["regime"].isin(labels).values
    counted = ((name, nature.values == flag) for flag, name in flags(nature).items())
    return [
        f"{name:<14}{int(here.sum()):>9}{int((here & irregular).sum()):>9} of them irregular"
        for name, here in counted
        if here.any()
    ]


def _hidden(dataset: "xarray.Dataset") -> list[str]:
    """At how many points starts end in different motions under one label."""
    if "hidden_motion" not in dataset or "start" not in dataset["hidden_motion"].dims:
        return []
    points = int(dataset["hidden_motion"].any("start").sum())
    return [f"at {points} points starts end in different motions under one label"] if points else []


def _failures(dataset: "xarray.Dataset") -> list[str]:
    """How many lanes failed, and of each reason how many and the first few."""
    import numpy as np

    if _of_lanes(dataset):
        failing = [value for value, meaning in flags(dataset["regime"]).items() if meaning == "failed"]
        mask = dataset["regime"].isin(failing)
    elif "status" in dataset:
        mask = dataset["status"] != 0
    else:
        return []
    lines = [str(int(mask.sum()))]
    reasoned = "reason" in dataset and dataset["reason"].dims == mask.dims
    reasons = dataset["reason"].values if reasoned else np.zeros(mask.shape, int)
    meanings = flags(dataset["reason"]) if reasoned else {}
    for reason in np.unique(reasons[mask.values]).tolist():
        where = np.argwhere(mask.values & (reasons == reason))
        lines += [f"{len(where)} {meanings[reason]}"] if reason in meanings else []
        lines += [_failure(dataset, mask.dims, index) for index in where[:_FAILURES_SHOWN].tolist()]
    return lines


def _failure(dataset: "xarray.Dataset", dims: tuple[Hashable, ...], index: list[int]) -> str:
    point = dataset.isel(dict(zip(dims, index, strict=True)))
    names = [name for name in point.coords if point[name].ndim == 0]
    values = [f"{name}={_number(point[name].item())}" for name in names]
    reason = flags(point["reason"]).get(point["reason"].item()) if "reason" in point else None
    return "at " + " ".join(values) + (f": {reason}" if reason else "")


def _number(value: object) -> str:
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def _accuracy(dataset: "xarray.Dataset") -> list[str]:
    """Median and largest error estimate, and the share of lanes that keep what the caller accepts."""
    import numpy as np

    from vibrojax.io.attributes import run_of

    if "error_estimate" not in dataset:
        return []
    errors = dataset["error_estimate"].values
    errors = errors[~np.isnan(errors)]  # infinite where the two resolutions disagree
    if not errors.size:
        return ["no periodic lanes, so no error estimates"]
    accepted = run_of(dataset).get("error", _ACCEPTED)
    within = dataset["error_estimate"].values <= accepted
    sensitive = _sensitive(dataset)
    share = 100 * float((within & ~sensitive).sum()) / errors.size
    return [
        f"error_estimate median {np.median(errors):.2g}, largest {errors.max():.2g}",
        f"{share:.4g} % of {errors.size} periodic lanes within the accepted {accepted:g}",
        *_still_settling(dataset, accepted),
        f"{sensitive.sum()} lanes are sensitive: rounding decides which attractor they reach",
    ]


def _sensitive(dataset: "xarray.Dataset") -> "np.ndarray":
    """Return the lanes of which rounding decides the attractor, along the dimensions of `error_estimate`."""
    import numpy as np

    if "sensitive" not in dataset:
        return np.zeros(dataset["error_estimate"].shape, bool)
    return dataset["sensitive"].transpose(*dataset["error_estimate"].dims).values == 1


def _still_settling(dataset: "xarray.Dataset", accepted: float) -> list[str]:
    """How many lanes that repeat are still on their way to where they settle."""
    if "cycles" not in dataset:
        return []
    if "drift_estimate" not in dataset:
        return ["how far lanes still are from where they settle is no part of it: made before version 0.1.1"]
    still = int((dataset["drift_estimate"] > accepted).sum())
    return [f"{still} of them are farther than that from where they settle; a longer settle brings them there"]


def _flips(dataset: "xarray.Dataset") -> list[str]:
    """Of how many lanes the regime is another one at a coarser resolution."""
    if "regime" not in dataset or "check_regime" not in dataset:
        return []
    flips = int((dataset["regime"].values != dataset["check_regime"].values).sum())
    return [f"{flips} of {dataset['regime'].size} regimes are others at the check run's coarser resolution"]
