"""Suggestions for misnamed parameters, by meaning: `gap` for delta, `speed` for v."""

import re
import unicodedata
from collections.abc import Iterable, Mapping

from vibrojax.errors import printable, suggestion
from vibrojax.physics.parameters import Parameter
from vibrojax.physics.units import UNITS

_SYNONYMS = {
    "gap": "clearance distance offset play spacing",
    "speed": "velocity vel",
    "mass": "weight masses",
    "damping": "damper dashpot damp viscous viscosity",
    "stiffness": "stiff rigidity elasticity",
    "spring": "springs",
    "frequency": "freq hz hertz bpm omega frequencies",
    "pulses": "frequency freq hz hertz bpm pulse",
    "force": "amplitude load",
    "duration": "width length",
    "yields": "yield strength hardness",
    "rotation": "rotary rotational revolutions spin",
    "radius": "diameter",
    "gravity": "gravitation acceleration",
}
"""Words of users for a word of parameters' long names."""

_MOST = 3
"""Greatest number of parameters that a message suggests."""


def suggest_parameter(word: str, parameters: Mapping[str, Parameter]) -> str:
    """Return a hint such as `did you mean delta (gap [m])?`, by meaning if possible, or else by spelling."""
    return suggest_by_meaning(word, parameters.values()) or suggestion(word, parameters)


def suggest_coordinate(word: str, attributes: Mapping[str, Mapping[str, object]]) -> str:
    """Return the hint of `suggest_parameter` for the coordinates of a dataset, given their attributes by name."""
    known = {
        name: Parameter(
            name, 0.0, str(attrs.get("units", "")), str(attrs.get("long_name", "")), str(attrs.get("symbol", ""))
        )
        for name, attrs in attributes.items()
    }
    return suggest_parameter(word, known)


def suggest_by_meaning(word: str, parameters: Iterable[Parameter]) -> str:
    """Return the parameters whose symbol is `word`, or whose long name has its words, as a hint; "" if there are none.

    **Example:**

    >>> from vibrojax.physics.parameters import CONTACT
    >>> suggest_by_meaning("gap", CONTACT.values())
    'did you mean delta (gap [m])?'
    """
    parameters = list(parameters)
    alike = [p for p in parameters if p.symbol and _plain(p.symbol) == _plain(word)]
    if not alike:
        ranks = {p.name: _rank(word, p) for p in parameters}
        best = max((rank[0] for rank in ranks.values()), default=0)
        alike = [p for p in parameters if ranks[p.name][0] == best > 0]
        heads = [p for p in alike if ranks[p.name][1] > 0]
        alike = sorted(heads or alike, key=lambda p: -ranks[p.name][1])[:_MOST]
    if not alike:
        return ""
    *others, last = [_described(p) for p in alike]
    return f"did you mean {' or '.join([*([', '.join(others)] if others else []), last])}?"


def _rank(word: str, parameter: Parameter) -> tuple[int, int]:
    """Return how many words of `word` are in the long name, and 2 if its noun is one, 1 if an attribute is, else 0."""
    synonyms = [{part, *(key for key, names in _SYNONYMS.items() if part in names.split())} for part in _words(word)]
    # The noun phrase with which the long name begins: `gap` of "gap between striker and bit".
    noun = re.split(r"\s+(?:between|of|at|per|that|with)\b|\s*\(", printable(parameter.long_name))[0]
    head = [part for part in _words(noun) if part.isalpha()]
    count = sum(bool(part & set(_words(parameter.long_name))) for part in synonyms)
    known = set().union(*synonyms) if synonyms else set()
    return count, 2 if head and head[-1] in known else int(bool(known & set(head)))


def _described(parameter: Parameter) -> str:
    """Return the name, meaning and unit, such as `delta (gap [m])`."""
    long_name = re.split(r"\s+between\b|\s*\(", printable(parameter.long_name, 60))[0]
    unit = UNITS.get(parameter.unit, (printable(parameter.unit, 20),))[0]
    return f"{printable(parameter.name, 40)} ({long_name}{f' [{unit}]' if unit not in ('', '1') else ''})"


def _words(text: str) -> list[str]:
    return re.findall(r"[^\W_]+/?[^\W_]*", text.lower())


def _plain(symbol: str) -> str:
    """Return a symbol without subscripts and underscores: `k1` for k₁."""
    return unicodedata.normalize("NFKC", symbol).replace("_", "")
