"""Natural frequencies, blows per minute and rotation speed of the lanes of a sweep or of one motion."""

import tomllib
from math import pi
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.io.attributes import parameters_of
from vibrojax.measures.labels import blow_frequency
from vibrojax.physics.modes import natural_frequencies, uncoupled_frequencies
from vibrojax.physics.parameters import REPLACED, resolved
from vibrojax.pictures.axes import pretty_unit
from vibrojax.studies.analysis import SummaryPart

_WORDS = {
    "bit_frequency": ("natural frequency of the bit alone", "Hz"),
    "striker_frequency": ("of the striker alone", "Hz"),
    "lower_frequency": ("lower mode", "Hz"),
    "upper_frequency": ("upper mode", "Hz"),
    "blow_frequency": ("blows", "min-1"),
    "rpm": ("rotation", "min-1"),
}
"""For each quantity, its wording in a summary and its unit."""

_DRILL = ("m1", "k1", "beta", "gamma")
_USED = (*_DRILL, *REPLACED, "v")


def frequencies(ds: xr.Dataset) -> dict[str, xr.DataArray]:
    """Return a dict with the frequencies [Hz], blows per minute and rotation speed [1/min] of a sweep or a trajectory.

    - `bit_frequency`, `striker_frequency`: natural frequencies of bit and striker alone, each on its own spring.
    - `lower_frequency`, `upper_frequency`: natural frequencies of the coupled bit and striker, without impact and
      friction (Batako's thesis, eq. 5.16).
    - `blow_frequency`: impacts per minute, for lanes that have a period.
    - `rpm`: rotation speed that corresponds to the drive speed, for sweeps with a bit radius.

    The dict leaves out quantities that the dataset does not determine.

    **Example:**

    >>> motion = vj.simulate("vibro-impact", delta=0.005, start="stuck", progress=False)
    >>> outputs = vj.frequencies(motion)
    >>> f"{float(outputs['striker_frequency']):.3f} Hz, {float(outputs['blow_frequency']):.1f} blows per minute"
    '2.984 Hz, 261.3 blows per minute'
    """
    known = {**_of_sweep(ds), **parameters_of(ds), **{str(name): x for name, x in ds.coords.items()}}
    arrays = {name: xr.DataArray(x) for name, x in known.items() if name in _USED}
    given = {name: x.astype(float) for name, x in arrays.items() if x.dtype.kind in "fiu"}
    with np.errstate(all="ignore"):  # a dataset from elsewhere may hold any numbers
        computed = _computed(ds, given)
    about = {name: {"units": unit, "long_name": words} for name, (words, unit) in _WORDS.items()}
    return {name: x.rename(name).assign_attrs(about[name]) for name, x in computed.items()}


def _computed(ds: xr.Dataset, given: dict[str, xr.DataArray]) -> dict[str, xr.DataArray]:
    values, found = resolved(given), {}
    if values.keys() >= set(_DRILL):
        found["bit_frequency"], found["striker_frequency"] = uncoupled_frequencies(values)
        columns = xr.broadcast(*(values[name] for name in _DRILL))
        modes = natural_frequencies({name: x.values for name, x in zip(_DRILL, columns, strict=True)}, np)
        for k, name in enumerate(("lower_frequency", "upper_frequency")):
            found[name] = columns[0].copy(data=modes[..., k] / (2 * pi))
    if all(name in ds and ds[name].dtype.kind in "fiu" for name in ("impacts", "period", "cycles")):
        found["blow_frequency"] = blow_frequency(*(ds[name] for name in ("impacts", "cycles", "period")))
    if "bit_radius" in given and ("rpm" in given or "v" in values):
        found["rpm"] = given["rpm"] if "rpm" in given else 60 * values["v"] / (2 * pi * given["bit_radius"])
    return found


def _of_sweep(ds: xr.Dataset) -> dict[str, Any]:
    """Return the rotation that a sweep file specifies, which is not among the parameters of the scene."""
    try:
        table = tomllib.loads(str(ds.attrs.get("sweep", ""))).get("parameters", {})
    except tomllib.TOMLDecodeError:
        return {}
    return {name: x for name, x in table.items() if name in ("rpm", "bit_radius") and isinstance(x, (int, float))}


def frequency_part(ds: xr.Dataset) -> SummaryPart:
    """Return the range of each of the `frequencies` over the lanes; quantities without a finite value are left out."""
    facts, texts = {}, []
    for name, x in frequencies(ds).items():
        finite = x.values[np.isfinite(x.values)]
        if not finite.size:
            continue
        words, unit = _WORDS[name]
        least, most = float(finite.min()), float(finite.max())
        facts[name] = {"least": least, "greatest": most, "units": unit}
        ends = dict.fromkeys((f"{least:.4g}", f"{most:.4g}"))
        texts.append(f"{words} {' to '.join(ends)} {pretty_unit(unit)}")
    masses, others = texts[:4], texts[4:]
    lines = [", ".join(part) for part in (masses, others) if part]
    return SummaryPart("frequency", lines, {"frequencies": facts})
