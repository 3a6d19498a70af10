"""Physical parameters: symbol, default, unit, meaning and admissible range (SI units).

**Example:**

>>> own = vj.parameters.table(vj.parameters.positive("v_s", 1.8, "m s-1", "speed over which friction falls", "v_s"))
>>> own["v_s"].problem(-1.0)
'is -1; it must be above 0 m s-1'
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import isfinite, pi
from typing import Any

FAR_FACTOR = 4.0
"""Ratio to the usual values beyond which a value counts as far from them. Mistaken units differ by a greater ratio,
mostly a thousand; a bit of 20 kg, a fifth of the lightest, is reported as well."""


@dataclass(frozen=True)
class Parameter:
    """A physical parameter of a scene or a friction law.

    The field `unit` is the unit of `default`. A value must be at least `lowest` (above `lowest` if `open_below` is
    True), and less than the bound `below`. The pair `usual` holds the smallest and the largest value in Batako's thesis
    or on rigs; None if unknown.
    """

    name: str
    default: float
    unit: str
    long_name: str
    symbol: str
    lowest: float | None = None
    open_below: bool = False
    below: float | None = None
    usual: tuple[float, float] | None = None

    def is_far(self, value: float) -> bool:
        """Return whether `value` is far from the usual ones, by more than `FAR_FACTOR`; zero never is."""
        if self.usual is None or not isfinite(value) or value == 0:
            return False
        low, high = self.usual
        return not (low / FAR_FACTOR if low > 0 else 0.0) <= abs(value) <= FAR_FACTOR * max(abs(low), abs(high))

    def problem(self, value: float) -> str | None:
        """Return an error message that states the admissible values, or None if `value` is admissible."""
        if not isfinite(value):
            return f"is {value}; a finite number is needed"
        unit = "" if self.unit == "1" else f" {self.unit}"
        if self.below is not None and value >= self.below:
            return f"is {value:g}; it must be below {self.below:g}{unit}"
        if self.lowest is not None and (value < self.lowest or (self.open_below and value == self.lowest)):
            return f"is {value:g}; it must be {'above' if self.open_below else 'at least'} {self.lowest:g}{unit}"
        return None


def positive(
    name: str, default: float, unit: str, long_name: str, symbol: str, usual: tuple[float, float] | None = None
) -> Parameter:
    """Return a `Parameter` with values above zero."""
    return Parameter(name, default, unit, long_name, symbol, lowest=0.0, open_below=True, usual=usual)


def not_negative(
    name: str, default: float, unit: str, long_name: str, symbol: str, usual: tuple[float, float] | None = None
) -> Parameter:
    """Return a `Parameter` with values of zero or above."""
    return Parameter(name, default, unit, long_name, symbol, lowest=0.0, usual=usual)


def table(*parameters: Parameter) -> dict[str, Parameter]:
    """Return a dictionary of the parameters by name."""
    return {parameter.name: parameter for parameter in parameters}


def differing(parameters: Mapping[str, Parameter], values: Mapping[str, float]) -> list[dict[str, str | float]]:
    """Return one record for each of the `values` that differs from its parameter's default.

    The keys of a record are `name`, `symbol`, `units`, `value` and `default`. Names without a parameter are ignored.
    """
    return [
        {"name": name, "symbol": p.symbol, "units": p.unit, "value": values[name], "default": p.default}
        for name, p in parameters.items()
        if name in values and values[name] != p.default
    ]


BIT_AND_STRIKER = table(
    positive("m1", 250.0, "kg", "bit mass", "m₁", (100.0, 500.0)),
    positive("beta", 0.4, "1", "mass ratio m2/m1", "β", (0.1, 1.5)),
    positive("gamma", 0.75, "1", "frequency ratio w2/w1", "γ", (0.15, 15.0)),
    positive("k1", 156250.0, "N m-1", "main spring stiffness", "k₁", (50e3, 1e6)),
    not_negative("c2", 250.0, "N s m-1", "damping between striker and drive", "c₂", (0.0, 2500.0)),
    not_negative("g", 9.81, "m s-2", "gravity", "g", (1.6, 9.81)),
    not_negative("v", 1.5, "m s-1", "drive speed", "v", (0.1, 2.5)),
)

CONTACT = table(
    positive("k0", 50e6, "N m-1", "contact stiffness", "k₀", (1e6, 500e6)),
    not_negative("c0", 0.1, "N s m-1", "contact damping", "c₀", (0.0, 10e3)),
    Parameter("delta", -0.005, "m", "gap between striker and bit (negative: preload)", "Δ", usual=(-0.02, 0.02)),
)

# The two parameters together may replace `v`: v = 2 pi (rpm/60) bit_radius.
ROTATION = table(
    not_negative("rpm", 120.0, "min-1", "rotation speed of the drive", "n", (10.0, 300.0)),
    positive("bit_radius", 0.12, "m", "radius at which the bit slides", "r", (0.02, 0.5)),
)

# Each of the two may replace a parameter: k1 = m1 (2 pi bit_frequency)², gamma = striker_frequency/bit_frequency.
FREQUENCIES = table(
    positive("bit_frequency", 3.979, "Hz", "natural frequency of the bit alone", "f₁", (1.5, 16.0)),
    positive("striker_frequency", 2.984, "Hz", "natural frequency of the striker alone", "f₂", (0.3, 50.0)),
)

REPLACED = {"rpm": "v", "bit_radius": "v", "bit_frequency": "k1", "striker_frequency": "gamma"}
"""Parameter that each quantity of `ROTATION` and `FREQUENCIES` replaces."""


def substitutes(parameters: Mapping[str, Parameter]) -> dict[str, Parameter]:
    """Return the quantities that may replace one of `parameters`: rotation speed, bit radius and frequencies.

    **Example:**

    >>> list(substitutes(BIT_AND_STRIKER))
    ['rpm', 'bit_radius', 'bit_frequency', 'striker_frequency']
    """
    known = ROTATION if "v" in parameters else {}
    known = known | (FREQUENCIES if parameters.keys() >= {"m1", "k1", "beta", "gamma"} else {})
    return {name: parameter for name, parameter in known.items() if name not in parameters}


def resolved(values: Mapping[str, Any], names: Collection[str] = tuple(REPLACED)) -> dict[str, Any]:
    """Return `values` with the alternative quantities in `names` replaced by the parameters that follow from them.

    The formulas are v = 2 pi rpm/60 bit_radius [m/s], k1 = m1 (2 pi bit_frequency)², and gamma = 2 pi striker_frequency
    sqrt(m1/k1).
    """
    values = dict(values)
    given = values.keys() & set(names)
    if given >= {"rpm", "bit_radius"}:
        values["v"] = 2 * pi / 60 * values.pop("rpm") * values.pop("bit_radius")
    if "bit_frequency" in given and "m1" in values:
        values["k1"] = values["m1"] * (2 * pi * values.pop("bit_frequency")) ** 2
    if "striker_frequency" in given and values.keys() >= {"m1", "k1"}:
        values["gamma"] = 2 * pi * values.pop("striker_frequency") * (values["m1"] / values["k1"]) ** 0.5
    return values
