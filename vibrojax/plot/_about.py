"""Where in the space of parameters a dataset lies, as far as it says so."""

import json

import xarray as xr

from vibrojax.plot._labels import number, value_text

# The parameters worth a word on a picture: symbol, factor and unit.
_NAMED = {"beta": ("β", 1.0, ""), "gamma": ("γ", 1.0, ""), "v": ("v", 1.0, " m/s"), "delta": ("Δ", 1e3, " mm")}


def point_text(ds: xr.Dataset) -> str:
    """What is the same all over `ds`: its scalar coordinates, and parameters and start in its attributes."""
    scalars = {str(name): data for name, data in ds.coords.items() if data.ndim == 0}
    parts = [value_text(data, data.values.item()) for data in scalars.values()]
    given = {name: value for name, value in parameters_of(ds).items() if name in _NAMED and name not in ds.coords}
    for name, (symbol, factor, unit) in _NAMED.items():
        if name in given:
            parts.append(f"{symbol} = {number(factor * given[name])}{unit}")
    if "start" in ds.attrs and "start" not in ds.coords:
        parts.append(f"start: {ds.attrs['start']}")
    return ", ".join(parts)


def parameters_of(ds: xr.Dataset) -> dict[str, float]:
    """The numbers in the attribute `parameters`, a mapping or its JSON text."""
    given = ds.attrs.get("parameters", {})
    if isinstance(given, str):
        try:
            given = json.loads(given)
        except ValueError:
            given = {}
    pairs = given.items() if isinstance(given, dict) else ()
    return {str(name): float(value) for name, value in pairs if isinstance(value, (int, float))}
