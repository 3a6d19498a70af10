"""Tables of the components of scenes: parameters, initial conditions, friction laws, variables and settings.

All tables are derived from the definitions that the simulation uses.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace
from functools import partial
from typing import Any

from vibrojax.errors import InputError, Place
from vibrojax.io.variables import Variable
from vibrojax.lazy import pd
from vibrojax.maps.starts import VECTOR, examples
from vibrojax.measures.labels import HOLE_RADIUS
from vibrojax.physics.friction import FRICTION_LAWS
from vibrojax.physics.parameters import REPLACED, Parameter, substitutes
from vibrojax.physics.rock import ROCKS
from vibrojax.scenes import SCENES, HasFriction, HasImpacts, HasRock, Scene
from vibrojax.scenes.penetration import PULSE_SHAPES
from vibrojax.settings.fields import meanings
from vibrojax.settings.names import enter_offered, read_names
from vibrojax.settings.run_settings import RunSettings
from vibrojax.studies import glossary, offered_analyses


def list_scenes() -> "pd.DataFrame":
    """Return a table with the description, the states and the named initial conditions of each scene.

    **Example:**

    >>> vj.list_scenes().states["vibro-impact"]
    'x1, v1, x2, v2'
    """
    return pd.DataFrame.from_dict(scene_rows(), orient="index").rename_axis("scene")


def scene_rows() -> dict[str, dict[str, str]]:
    """Return the rows of `list_scenes` by name."""
    enter_offered()
    return {
        name: {"what": _summary(kind), "states": ", ".join(kind().state_names), "starts": ", ".join(kind.starts)}
        for name, kind in SCENES.items()
    }


def list_parameters(scene: str | Scene[Any]) -> "pd.DataFrame":
    """Return a table of the parameters of a scene and its friction laws, and of substitutes such as `rpm` for `v`.

    The columns are `symbol`, `default`, `units`, `range` (admissible values), `usual`, `meaning` and `where`. The
    column `usual` is the range in Batako's thesis and on drilling rigs; values far outside the usual range cause a
    warning. The column `where` is the friction law or pulse shape to which the parameter belongs, and is empty if the
    scene always has the parameter.

    **Raises:** `InputError` if the scene does not exist.

    **Example:**

    >>> vj.list_parameters("vibro-impact").loc["beta", ["symbol", "range", "usual", "meaning"]].tolist()
    ['β', 'above 0', '0.1 to 1.5', 'mass ratio m2/m1']
    """
    names = read_names(Place("scenes"), scene)
    choices: dict[str, Mapping[str, Parameter]] = {}  # of a friction law or a pulse shape, those of its own
    if isinstance(names.system, HasFriction):
        laws = sorted(FRICTION_LAWS.values(), key=lambda law: law.name != names.options["friction"])
        choices = {f'friction = "{law.name}" ({law.reference})': law.parameters for law in laws}
    elif "pulse_shape" in names.options:
        read = partial(read_names, Place("scenes"), names.system)
        tables = {f'pulse_shape = "{shape}"': read({"pulse_shape": shape}).parameters for shape in PULSE_SHAPES}
        common = set.intersection(*map(set, tables.values()))
        choices = {where: {name: x for name, x in of.items() if name not in common} for where, of in tables.items()}
    shared = set(names.parameters).difference(*choices.values())
    found = [("", parameter) for name, parameter in names.parameters.items() if name in shared]
    for choice, parameters in choices.items():
        found += [(choice, parameter) for name, parameter in parameters.items() if name not in shared]
    for name, parameter in substitutes(names.parameters).items():
        partner = {"rpm": ", together with bit_radius", "bit_radius": ", together with rpm"}.get(name, "")
        where = f"given in place of {REPLACED[name]}{partner}"
        if name == "bit_radius" and isinstance(names.system, HasRock):
            meaning = "radius of the hole and of the circle on which the bit slides"
            parameter = replace(parameter, default=HOLE_RADIUS, long_name=meaning)
            where = f"needed for specific_energy, or {where}"
        found.append((where, parameter))
    rows = []
    for where, parameter in found:
        limits = []
        if parameter.lowest is not None:
            limits.append(f"{'above' if parameter.open_below else 'at least'} {parameter.lowest:g}")
        if parameter.below is not None:
            limits.append(f"below {parameter.below:g}")
        row = {
            "name": parameter.name,
            "symbol": parameter.symbol,
            "default": parameter.default,
            "units": parameter.unit,
            "range": ", ".join(limits) or "any",
            "usual": " to ".join(f"{end:g}" for end in parameter.usual or ()),
            "meaning": parameter.long_name,
            "where": where,
        }
        rows.append(row)
    return pd.DataFrame(rows).set_index("name")


def list_variables(scene: str | Scene[Any]) -> "pd.DataFrame":
    """Return a table of the variables in datasets of a scene, with units and meanings.

    The column `where` names the command that adds a variable, and is empty for variables of a sweep and its orbits.

    **Raises:** `InputError` if the scene does not exist.

    **Example:**

    >>> vj.list_variables("drilling").loc["relief", ["units", "meaning"]].tolist()
    ['1', 'mean force divided by the threshold, P/D']
    """
    from vibrojax.io.kinds import OF_ATTRACTORS, OF_BORDERS, OF_CURVES, OF_FAMILIES
    from vibrojax.lanes.labels import of_orbits, sweep_variables
    from vibrojax.studies.analysis import Analysis, analysis_named
    from vibrojax.studies.design import DESIGN_VARIABLES
    from vibrojax.studies.effects import STUDY_VARIABLES
    from vibrojax.studies.tolerance import tolerance_variables

    system = read_names(Place("scenes"), scene).system
    held, has_section, has_orbits = sweep_variables(system), system.section is not None, bool(of_orbits(system))
    tables: dict[str, Mapping[str, Variable]] = {
        "": held,
        "follow": OF_FAMILIES if has_orbits else {},
        "borders": OF_BORDERS if isinstance(system, HasImpacts) and has_section else {},
        "curves": OF_CURVES if has_orbits else {},
        "attractors": OF_ATTRACTORS if has_section else {},
        "tolerance": tolerance_variables(held) if "regime" in held else {},
        "design": DESIGN_VARIABLES,
        "study": STUDY_VARIABLES if "regime" in held else {},
    }
    for kind in offered_analyses():
        with suppress(InputError):  # the command of that analysis reports the error
            tables[kind] = (analysis_named(kind) or Analysis()).variables
    rows: dict[str, dict[str, str]] = {}
    for where, table in tables.items():
        for name, about in table.items():  # designs and studies have variables of others, too
            if name not in rows or where not in ("curves", "design", "study"):
                rows[name] = {"units": about.units, "meaning": about.long_name, "where": where}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("variable")


def list_settings() -> "pd.DataFrame":
    """Return a table of the settings in [run] of a sweep, with their defaults.

    In a `vj.System`, the attribute `usual_times` holds the default settling and observation times.

    **Example:**

    >>> vj.list_settings().default[["settle", "observe", "error"]].to_dict()
    {'settle': 40.0, 'observe': 8.0, 'error': 0.0001}
    """
    known = meanings(RunSettings)
    rows = {item.name: {"default": item.default, "meaning": known[item.name]} for item in fields(RunSettings)}
    return pd.DataFrame.from_dict(rows, orient="index", dtype=object).rename_axis("setting")


def scene_text(scene: str) -> str:
    """Describe everything that a sweep file of the scene may contain."""
    names = read_names(Place("scenes"), scene)
    system = names.system
    starts = f"starts: {', '.join(system.starts)}"
    if system.start_states:
        states = ", ".join(f"{VECTOR}{state}" for state in system.start_states)
        starts += f", or a vector [{', '.join(system.start_states)}]; in a list of points: columns {states}"
        starts += f"; many: {', or '.join(examples(system.start_states))}"
    parts = [f"{system.name}: {_summary(type(system))}", starts if names.has_starts else "starts: always the same"]
    if "rock" in names.presets:
        rocks = (f"{name} ({rock.threshold / 1e3:g} kN, {rock.k3 / 1e6:g} MN/m)" for name, rock in ROCKS.items())
        parts.append(f"rock, in place of threshold and k3: {', '.join(rocks)}")
    for title, table in (
        ("parameters: symbol, default, unit, admissible, usual on rigs, meaning", list_parameters(scene)),
        ("variables: unit, meaning, where: with which command, if not in a sweep", list_variables(scene)),
        ("settings, in [run]", list_settings()),
    ):
        parts.append(f"{title}\n{_aligned(table)}")
    words = ["lane", *(["section", "return", "regime", "orbit", "multiplier"] if system.section is not None else [])]
    words += ["relief P/D"] if isinstance(system, HasRock) else []
    parts.append("words\n" + glossary(*words, "reading R1, R2, ..."))
    return "\n\n".join(parts)


def _aligned(table: "pd.DataFrame") -> str:
    """Format a table as text with left-aligned columns, indented by two spaces."""

    def text(value: object) -> str:
        if value is None or isinstance(value, bool):
            return "" if value is None else str(value).lower()
        return f"{value:g}" if isinstance(value, float) else str(value)

    cells = [[str(name), *map(text, row)] for name, row in zip(table.index, table.to_numpy(), strict=True)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in cells)
    return "\n".join(f"  {line}".rstrip() for line in lines)


def _summary(kind: type) -> str:
    """Return the first line of a class's docstring."""
    return str(kind.__doc__ or kind.__name__).strip().splitlines()[0] if is_dataclass(kind) else kind.__name__
