"""Units that lengths, speeds, forces and rates are given in, by their factors to SI; and which a number is likely in.

A small table: what stands in rig data, and what is mistaken for SI. Names are as people write them.
"""

from collections.abc import Iterable
from math import pi

_FOOT, _INCH, _POUND, _POUND_FORCE, _TONNE_FORCE = 0.3048, 0.0254, 0.45359237, 4.4482216152605, 9806.65
_MINUTE, _HOUR = 60.0, 3600.0

UNITS: dict[str, dict[str, float]] = {
    "1": {"1": 1.0, "%": 0.01},
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "in": _INCH, "ft": _FOOT},
    "m s-1": {
        "m/s": 1.0,
        "m/h": 1 / _HOUR,
        "ft/h": _FOOT / _HOUR,
        "mm/s": 1e-3,
        "mm/min": 1e-3 / _MINUTE,
        "m/min": 1 / _MINUTE,
        "cm/min": 1e-2 / _MINUTE,
        "ft/min": _FOOT / _MINUTE,
        "in/min": _INCH / _MINUTE,
    },
    "m s-2": {"m/s2": 1.0, "cm/s2": 1e-2},
    "N": {
        "N": 1.0,
        "kN": 1e3,
        "MN": 1e6,
        "lbf": _POUND_FORCE,
        "klbf": 1e3 * _POUND_FORCE,
        "t": _TONNE_FORCE,  # tonne-force
        "kgf": _TONNE_FORCE / 1e3,
    },
    "N m-1": {"N/m": 1.0, "N/mm": 1e3, "kN/m": 1e3, "kN/mm": 1e6, "MN/m": 1e6},
    "N s m-1": {"N s/m": 1.0, "kN s/m": 1e3},
    "kg": {"kg": 1.0, "t": 1e3, "lb": _POUND},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": _MINUTE},
    "s-1": {"1/s": 1.0, "1/min": 1 / _MINUTE},
    "s-2": {"1/s2": 1.0},
    "min-1": {"1/min": 1.0, "1/s": _MINUTE, "rad/s": 30 / pi},
}
"""By SI unit (as datasets write it) the units of its kind, each by the factor that turns it into SI."""

_ALIASES = {
    "m/hr": "m/h",
    "m/hour": "m/h",
    "ft/hr": "ft/h",
    "ft/hour": "ft/h",
    "fph": "ft/h",
    "lbs": "lbf",
    "klb": "klbf",
    "klbs": "klbf",
    "kip": "klbf",
    "kips": "klbf",
    "tf": "t",
    "ton": "t",
    "tonne": "t",
    "tonnes": "t",
    "tons": "t",
    "hz": "1/s",
    "rpm": "1/min",
    "bpm": "1/min",
    "percent": "%",
    "-": "1",
    "µm": "um",
    "m/s²": "m/s2",
}


def factor(unit: str, si: str) -> float | None:
    """What turns a number in `unit`, as people write it, into one in the SI unit `si`; None where it is no such unit.

    Capitals count only where they tell units apart: mN is no MN.
    """
    known = UNITS[si]
    unit = unit.strip()
    if unit == si:
        return 1.0
    if unit in known:
        return known[unit]
    plain = unit.casefold()
    plain = _ALIASES.get(plain, plain)
    if unit.startswith("m") and plain in ("mn", "mn/m"):
        return None
    return next((value for name, value in known.items() if name.casefold() == plain), None)


def is_unit(text: str) -> bool:
    """Whether `text` is a unit of any kind."""
    return any(factor(text, si) is not None for si in UNITS)


def likely_units(value: float, si: str, usual: tuple[float, float]) -> list[str]:
    """The units in which a number would be a `usual` one (SI), the more common first; none of an unknown kind."""
    low, high = usual
    others = ((name, scale) for name, scale in UNITS.get(si, {}).items() if scale != 1.0)
    return _first_of_each((name, scale) for name, scale in others if low <= value * scale <= high)


def _first_of_each(units: Iterable[tuple[str, float]]) -> list[str]:
    """The names of units, of those with one factor the first."""
    return list({scale: name for name, scale in reversed(list(units))}.values())[::-1]
