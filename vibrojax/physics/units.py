"""Units of lengths, speeds, forces and rates: conversion factors to SI (by pint), and guesses of mistaken units."""

import re
from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import TYPE_CHECKING, Any

from vibrojax.errors import InputError, shown

if TYPE_CHECKING:
    import pint

UNITS: dict[str, tuple[str, ...]] = {
    "1": ("1", "%"),
    "m": ("m", "mm", "cm", "um", "in", "ft"),
    "m s-1": ("m/s", "m/h", "ft/h", "mm/s", "mm/min", "m/min", "cm/min", "ft/min", "in/min"),
    "m s-2": ("m/s2", "cm/s2"),
    "N": ("N", "kN", "MN", "lbf", "klbf", "t", "kgf"),
    "N m-1": ("N/m", "N/mm", "kN/m", "kN/mm", "MN/m"),
    "N s m-1": ("N s/m", "kN s/m"),
    "kg": ("kg", "t", "lb"),
    "s": ("s", "ms", "us", "min"),
    "s-1": ("1/s", "1/min"),
    "s-2": ("1/s2",),
    "Hz": ("Hz", "1/min", "rad/s"),
    "min-1": ("1/min", "1/s", "rad/s"),
    "rad s-1": ("rad/s", "rpm", "rev/s"),
    "N m": ("N m", "kN m", "ft lbf", "kft lbf"),
    "Pa": ("Pa", "kPa", "MPa", "bar", "psi"),
    "W": ("W", "kW", "hp"),
    "J": ("J", "kJ"),
    "m3 s-1": ("m3/s", "L/min", "gal/min"),
}
"""Common units of each physical dimension. The keys are SI units as in datasets; the first unit of each tuple is the SI
unit as people usually write it."""

# A full revolution is the dimensionless 1, so that frequencies and rotation speeds convert into each other. There are
# no prefixes, because mN (milli) and MN (mega) are easily confused. pint's own list of units is not used, because it
# contains words that are also column names ("bit", "point").
_DEFINITIONS = """
    m = [length] = m = meter = meters = metre = metres = mts
    s = [time] = s = sec
    kg = [mass]
    [force] = [mass] * [length] / [time] ** 2
    percent = 0.01
    rad = 0.15915494309189535
    mm = 1e-3 m
    cm = 1e-2 m
    um = 1e-6 m = um = µm
    inch = 0.0254 m = in
    foot = 0.3048 m = ft = feet
    kft = 1e3 foot
    km = 1e3 m
    ms = 1e-3 s
    us = 1e-6 s = us = µs
    min = 60 s
    hour = 3600 s = h = hr
    fph = foot / hour
    tonne = 1e3 kg = t = ton = tons = tonnes = tf = mt
    pound = 0.45359237 kg = lb = lbs
    N = kg * m / s ** 2
    kN = 1e3 N
    MN = 1e6 N
    kgf = 9.80665 N
    lbf = 4.4482216152605 N
    klbf = 1e3 lbf = klbf = klb = klbs = kip = kips
    dan = 10 N
    kdan = 1e4 N
    kkgf = 9806.65 N
    knm = 1e3 N * m
    nm = N * m
    ftlbf = 1.3558179483314004 N * m = ftlbf = ftlb = ftlbs
    kftlbf = 1e3 ftlbf = kftlbf = kftlb = kftlbs
    pascal = N / m ** 2 = pa
    kpa = 1e3 pa
    mpa = 1e6 pa
    bar = 1e5 pa
    joule = N * m = j
    kj = 1e3 joule
    watt = N * m / s = w
    kw = 1e3 w
    hp = 745.6998715822702 w
    psi = lbf / inch ** 2
    liter = 1e-3 m ** 3 = l = liters = litre = litres
    gal = 3.785411784e-3 m ** 3 = gal = galus
    bbl = 42 gal
    gpm = gal / min
    lpm = liter / min
    hertz = 1 / s = Hz
    rev = 1 = rev = cycle = cycles = tr
    rpm = 1 / min = rpm = bpm
"""
_STANDARD_GRAVITY = 9.80665  # m/s2, for tonnes and pounds that are used as units of force

# A string that does not match, such as a power of a power, is not passed to pint's parser.
_UNIT = re.compile(r"(?:1|%|[a-zµ]+(?:-?[1-4]|[²³])?)(?:[ */·](?:%|[a-zµ]+(?:-?[1-4]|[²³])?))*", re.IGNORECASE)
_DRAWN = re.compile(r"[A-Za-zµ°Ω][A-Za-z0-9µ°Ω /*·-]*|1/[A-Za-zµ°Ω][A-Za-z0-9µ°Ω]*")
_powers = partial(re.compile(r"(?<=[A-Za-zµ])(?=-?\d)").sub, "**")  # "m s-1" is m*s**-1
_MILLI = re.compile(r"\bm([nN]|[pP]a)\b")
_PER = re.compile("_per_", re.IGNORECASE)  # of "ft_per_hr"
_SEPARATORS = re.compile(r"(?<=[A-Za-z])[-_.](?=[A-Za-z])")  # of "k-lbs", "ft_lb" and "kN.m"
_THOUSAND = re.compile(r"1000[ .*]?(?=[a-z])", re.IGNORECASE)  # of "1000 lbf"
_CYCLES = re.compile(r"\bc/(?=s\b|min\b)", re.IGNORECASE)  # of "c/min"
_ABBREVIATED = {("m", "f"): "ft", ("N m", "lb.f"): "ft*lbf"}
"""Abbreviations of logs that mean this for one SI unit only."""
_LONGEST_UNIT = 40


@cache
def _registry() -> "pint.UnitRegistry":
    """Return the pint registry of the units above; pint is imported here because few commands parse units."""
    import pint

    registry: pint.UnitRegistry = pint.UnitRegistry(None, case_sensitive=False, preprocessors=[_powers])
    registry.load_definitions([line.strip() for line in _DEFINITIONS.splitlines()])
    gravity = registry.Quantity(_STANDARD_GRAVITY, "m/s**2")

    def weight(ureg: Any, value: Any, **_: Any) -> Any:
        return value * gravity

    context = pint.Context("weight")
    context.add_transformation("[mass]", "[force]", weight)
    context.add_transformation("[mass] * [length]", "[force] * [length]", weight)  # of "lb.ft"
    registry.add_context(context)
    return registry


@cache
def factor(unit: str, si: str) -> float | None:
    """Return the factor that converts a number in `unit` to the SI unit `si`, or None if the dimensions differ.

    Case does not matter, except that mN and mPa are rejected. If `si` is a force, a unit of mass stands for its weight,
    also in a torque. Spellings of rig data such as `ft_per_hr`, `k-lbs`, `kN.m` and `1000 lbf` are known.
    """
    unit = "1" if unit.strip() == "-" else unit.strip().replace("·", "*").replace("\N{GREEK SMALL LETTER MU}", "µ")
    unit = _ABBREVIATED.get((si, unit.casefold()), unit)
    if len(unit) > _LONGEST_UNIT:  # pint's parser is recursive
        return None
    if _THOUSAND.match(unit):
        scale = factor(_THOUSAND.sub("", unit), si)
        return None if scale is None else 1e3 * scale
    unit = _CYCLES.sub("rev/", _PER.sub("/", unit))
    import pint

    for mark in ("", "*"):  # "kN.m" is in the list above; "lb.ft" is a product
        text = _SEPARATORS.sub(mark, unit)
        if not _UNIT.fullmatch(text) or _MILLI.search(text):
            return None
        try:
            return float(_registry().Quantity(1.0, text).to(si, "weight").magnitude)
        except pint.PintError:
            continue
    return None


def stated_unit(value: Any) -> str | None:
    """Return the unit that an array states, None if it states none.

    Arrays of xarray and series of pandas state it as the attribute `units`, quantities of pint as their unit.
    """
    attributes = getattr(value, "attrs", None)
    unit = attributes.get("units") if isinstance(attributes, Mapping) else None
    if magnitude(value) is not value:
        unit = format(value.units, "~").replace(" ", "").replace("**", "")
    return None if unit is None else str(unit) or "1"


def magnitude(value: Any) -> Any:
    """Return the number or array of a quantity of pint; any other value as it is."""
    return value.magnitude if hasattr(value, "magnitude") and hasattr(value, "units") else value


def stated_scale(refuse: Callable[[str], InputError], unit: str, si: str | None) -> float:
    """Return the factor from a stated unit to the unit `si`, which may be any SI unit if it is None.

    Raise `refuse(problem)` if the dimensions differ, or if it is not known to be 1.
    """
    if unit == si or (si is None and any(factor(unit, known) == 1.0 for known in UNITS)):
        return 1.0
    scale = None if si is None else factor(unit, si)
    if scale is None:
        needed = "a number in SI units is" if si is None else f"a unit of {UNITS.get(si, (si,))[0]} is"
        raise refuse(f"is in {shown(unit)}; {needed} needed")
    return scale


@cache
def is_unit(text: str) -> bool:
    """Return whether `text` is a known unit of any dimension."""
    return text in UNITS or any(factor(text, si) is not None for si in UNITS)


@cache
def is_drawn_unit(text: str) -> bool:
    """Return whether `text` is "1" or a unit that pint knows, such as "deg" or "N m rad-1", and that can be drawn."""
    if text == "1" or is_unit(text):
        return True
    if not _DRAWN.fullmatch(text):
        return False
    import pint

    try:
        pint.UnitRegistry(preprocessors=[_powers]).parse_units(text)
    except (pint.PintError, ValueError):
        return False
    return True


def likely_units(value: float, si: str, usual: tuple[float, float]) -> dict[str, float]:
    """Return up to three units, with their factors to SI, that would bring `value` into the `usual` range.

    `usual`: least and greatest usual value in the SI unit `si`. The most common units come first.
    """
    likely: dict[str, float] = {}
    for name in UNITS.get(si, ()):
        scale = factor(name, si)
        if scale and scale != 1.0 and usual[0] <= value * scale <= usual[1] and scale not in likely.values():
            likely[name] = scale
    return dict(list(likely.items())[:3])
