"""Where in the space of parameters a dataset lies, as far as it says so."""

import json

import xarray as xr

from vibrojax.plot._labels import number, value_text

# The parameters worth a word on a picture: symbol, factor and unit.
_NAMED = {
    "beta": ("β", 1.0, ""),
    "gamma": ("γ", 1.0, ""),
    "v": ("v", 1.0, " m/s"),
    "delta": ("Δ", 1e3, " mm"),
    "force": ("A", 1e-3, " kN"),
    "bias": ("B", 1e-3, " kN"),
    "frequency": ("f", 1.0, " Hz"),
    "pulse_width": ("w", 1e3, " ms"),
    "threshold": ("D", 1e-3, " kN"),
    "k3": ("k₃", 1e-6, " MN/m"),
    "zeta": ("ζ", 1.0, ""),
}


def point_text(ds: xr.Dataset) -> str:
    """What is the same all over `ds`: its scalar coordinates, and parameters and start in its attributes."""
    scalars = {str(name): data for name, data in ds.coords.items() if data.ndim == 0}
    parts = [value_text(data, data.values.item()) for data in scalars.values()]
    known = {*ds.coords, *(("threshold", "k3") if "rock" in ds.coords else ())}
    given = {name: value for name, value in parameters_of(ds).items() if name in _NAMED and name not in known}
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
