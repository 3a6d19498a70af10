"""Units of rig data and units that are mistaken for SI, with their factors to SI; names are as people write them."""

from math import pi

_FOOT, _INCH, _LBF, _TF = 0.3048, 0.0254, 4.4482216152605, 9806.65
_MINUTE, _HOUR = 60.0, 3600.0
_PER_MINUTE = {"mm": 1e-3, "m": 1.0, "cm": 1e-2, "ft": _FOOT, "in": _INCH}

UNITS: dict[str, dict[str, float]] = {
    "1": {"1": 1.0, "%": 0.01},
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "in": _INCH, "ft": _FOOT},
    "m s-1": {"m/s": 1.0, "m/h": 1 / _HOUR, "ft/h": _FOOT / _HOUR, "mm/s": 1e-3}
    | {f"{unit}/min": scale / _MINUTE for unit, scale in _PER_MINUTE.items()},
    "m s-2": {"m/s2": 1.0, "cm/s2": 1e-2},
    # t and _TF: the tonne-force.
    "N": {
        "N": 1.0,
        "kN": 1e3,
        "MN": 1e6,
        "lbf": _LBF,
        "klbf": 1e3 * _LBF,
        "t": _TF,
        "kgf": _TF / 1e3,
    },
    "N m-1": {"N/m": 1.0, "N/mm": 1e3, "kN/m": 1e3, "kN/mm": 1e6, "MN/m": 1e6},
    "N s m-1": {"N s/m": 1.0, "kN s/m": 1e3},
    "kg": {"kg": 1.0, "t": 1e3, "lb": 0.45359237},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": _MINUTE},
    "s-1": {"1/s": 1.0, "1/min": 1 / _MINUTE},
    "s-2": {"1/s2": 1.0},
    "min-1": {"1/min": 1.0, "1/s": _MINUTE, "rad/s": 30 / pi},
}
"""Units of each kind with their factors to SI, by the SI unit as datasets write it."""

_SPELLINGS = {
    "m/h": "m/hr m/hour",
    "ft/h": "ft/hr ft/hour fph",
    "lbf": "lbs",
    "klbf": "klb klbs kip kips",
    "t": "tf ton tonne tonnes tons",
    "1/s": "hz",
    "1/min": "rpm bpm",
    "%": "percent",
    "1": "-",
    "um": "µm",
    "m/s2": "m/s²",
}
_ALIASES = {alias: unit for unit, aliases in _SPELLINGS.items() for alias in aliases.split()}


def factor(unit: str, si: str) -> float | None:
    """Return the factor from `unit`, as people write it, to the SI unit `si`; None if it is not a unit of that kind.

    Capitals count only to distinguish units: mN is not MN.
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
    """Return True if `text` is a unit of any kind."""
    return any(factor(text, si) is not None for si in UNITS)


def likely_units(value: float, si: str, usual: tuple[float, float]) -> list[str]:
    """Return the units that make `value` a `usual` one (SI), common units first; none if `si` is unknown.

    Of several names for one factor only the first counts.
    """
    low, high = usual
    names: dict[float, str] = {}
    for name, scale in UNITS.get(si, {}).items():
        if scale != 1.0 and low <= value * scale <= high:
            names.setdefault(scale, name)
    return list(names.values())
