"""What scenes are made of, as tables: parameters, starts, friction laws, variables and settings.

Everything is read from what the code itself goes by, so that it cannot say anything else.
"""

from dataclasses import fields, is_dataclass
from typing import Any

import jax
import jax.numpy as jnp
import pandas as pd

from vibrojax.analyses.glossary import glossary
from vibrojax.compile.devices import precision
from vibrojax.errors import Place
from vibrojax.io.derived import OF_ATTRACTORS, OF_BORDERS, OF_FAMILIES
from vibrojax.io.variables import VARIABLES
from vibrojax.measures import recorder_for
from vibrojax.measures.run import Effort, run_block
from vibrojax.models.physics.friction import FRICTION_LAWS
from vibrojax.models.physics.parameters import ROTATION, Parameter
from vibrojax.models.physics.rock import ROCKS
from vibrojax.models.scenes import SCENES, HasContact, HasFriction, HasRock, Scene
from vibrojax.models.scenes.penetration import PULSE_SHAPES
from vibrojax.stepping import Wanted, stepper_named
from vibrojax.sweep.engine.labelled import measured_besides, of_orbits
from vibrojax.sweep.input.names import Names, read_names
from vibrojax.sweep.input.offered import enter_offered
from vibrojax.sweep.input.points import VECTOR
from vibrojax.sweep.input.run_settings import MEANINGS, RunSettings
from vibrojax.sweep.input.starts import PLANE, SAMPLE

COLUMNS = ["symbol", "default", "units", "range", "usual", "meaning", "where"]


_OF_ORBITS = {
    "multiplier_abs",
    "multiplier_arg",
    "stable",
    "orbit_residual",
    "grazing_margin",
    "orbit_cycles",
    "orbit_reason",
}
"""Variables that there are with `orbits = true`."""

_LABELLED = {"regime", "check_regime", "drift_estimate", "sensitive", "hidden_motion"}
"""Variables of sweeps where lanes return to a section."""

_NEARBY = {"nearby_cycles", "nearby_impacts", "nearby_distance"}
"""Those that there are then where lanes return to a section."""


def list_scenes() -> pd.DataFrame:
    """The scenes by name: what each is, its states and its starts.

    **Example:**

    >>> vj.list_scenes().states["vibro-impact"]
    'x1, v1, x2, v2'
    """
    enter_offered()
    rows = {
        name: {"what": _summary(kind), "states": ", ".join(kind().state_names), "starts": ", ".join(kind.starts)}
        for name, kind in SCENES.items()
    }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("scene")


def list_parameters(scene: str | Scene[Any]) -> pd.DataFrame:
    """The parameters of a scene by name, with those that stand for others, and those of every friction law.

    The columns are `symbol`, `default`, `units`, `range` (what is admissible), `usual` (what the source and rigs have;
    a value far from that is warned of), `meaning` and `where`: with which friction law or shape of pulses it goes;
    empty where it is there always.

    **Raises:** `InputError` where there is no such scene.

    **Example:**

    >>> vj.list_parameters("vibro-impact").loc["beta", ["symbol", "range", "usual", "meaning"]].tolist()
    ['β', 'above 0', '0.1 to 1.5', 'mass ratio m2/m1']
    """
    names = read_names(Place("scenes"), scene)
    choices = _of_choices(names)
    shared = set(names.parameters).difference(*choices.values())
    rows = [(_row(names.parameters[name]) | {"name": name, "where": ""}) for name in names.parameters if name in shared]
    for choice, parameters in choices.items():
        new = [parameter for name, parameter in parameters.items() if name not in shared]
        rows += [_row(parameter) | {"name": parameter.name, "where": choice} for parameter in new]
    if "v" in names.parameters:
        rows += [_row(one) | {"name": one.name, "where": "both in place of v"} for one in ROTATION.values()]
    return pd.DataFrame(rows).set_index("name")[COLUMNS]


def list_variables(scene: str | Scene[Any]) -> pd.DataFrame:
    """The variables of the datasets that there are of a scene, by name: `units` and `meaning`; and `where`: empty for
    those of sweeps, with orbits; else with which command there are more.

    **Raises:** `InputError` where there is no such scene.

    **Example:**

    >>> vj.list_variables("drilling").loc["relief", ["units", "meaning"]].tolist()
    ['1', 'mean force over threshold, P/D']
    """
    system = read_names(Place("scenes"), scene).system
    measured = set(_features(system))
    labelled = _LABELLED if system.section is not None else set()
    known = VARIABLES | measured_besides(system) | of_orbits(system)
    found = {*_OF_ORBITS, *of_orbits(system)} if of_orbits(system) else set()
    found |= _NEARBY if system.section is not None else set()
    there = measured | labelled | found | {"status", "reason", "error_estimate"}
    tables = {"": {name: one for name, one in known.items() if name in there}}
    tables["follow"] = OF_FAMILIES if of_orbits(system) else {}
    tables["borders"] = OF_BORDERS if isinstance(system, HasContact) and system.section is not None else {}
    tables["attractors"] = OF_ATTRACTORS if system.section is not None else {}
    rows = {
        name: {"units": one.units, "meaning": one.long_name, "where": where}
        for where, table in tables.items()
        for name, one in table.items()
    }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("variable")


def list_settings() -> pd.DataFrame:
    """The settings of a sweep, the table [run], with their defaults.

    **Example:**

    >>> vj.list_settings().default[["settle", "observe", "error"]].to_dict()
    {'settle': 40.0, 'observe': 8.0, 'error': 0.0001}
    """
    rows = {field.name: {"default": field.default, "meaning": MEANINGS[field.name]} for field in fields(RunSettings)}
    return pd.DataFrame.from_dict(rows, orient="index", dtype=object).rename_axis("setting")


def scene_text(scene: str) -> str:
    """All that there is to know of a scene to write a sweep file, as text."""
    names = read_names(Place("scenes"), scene)
    system = names.system
    parts = [f"{system.name}: {_summary(type(system))}"]
    starts = f"starts: {', '.join(system.starts)}"
    if system.start_states:
        states = ", ".join(f"{VECTOR}{state}" for state in system.start_states)
        starts += f", or a vector [{', '.join(system.start_states)}]; in a list of points: columns {states}"
        starts += f"; many: {SAMPLE}, or {PLANE}"
    parts.append(starts if names.has_starts else "starts: always the same")
    if names.has_rock:
        rocks = (f"{name} ({one.threshold / 1e3:g} kN, {one.k3 / 1e6:g} MN/m)" for name, one in ROCKS.items())
        parts.append(f"rock, in place of threshold and k3: {', '.join(rocks)}")
    for title, table in (
        ("parameters: symbol, default, unit, admissible, usual on rigs, meaning", list_parameters(scene)),
        ("variables: unit, meaning, where: with which command, if not in a sweep", list_variables(scene)),
        ("settings, in [run]", list_settings()),
    ):
        parts.append(f"{title}\n{_aligned(table)}")
    parts.append("words\n" + glossary(*_words(system)))
    return "\n\n".join(parts)


def _words(scene: Scene[Any]) -> list[str]:
    """The words that a scene's tables use."""
    returns = ["section", "return", "regime", "orbit", "multiplier"] if scene.section is not None else []
    relief = ["relief P/D"] if isinstance(scene, HasRock) else []
    return ["lane", *returns, *relief, "reading R1, R2, ..."]


def _aligned(table: pd.DataFrame) -> str:
    """`table` as text, its columns aligned to the left, two blanks deep."""
    rows = zip(table.index, table.to_numpy(), strict=True)
    cells = [[str(name), *(_cell(value) for value in row)] for name, row in rows]
    widths = [max(len(row[column]) for row in cells) for column in range(len(cells[0]))]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in cells)
    return "\n".join(f"  {line}".rstrip() for line in lines)


def _cell(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


def _row(parameter: Parameter) -> dict[str, Any]:
    return {
        "symbol": parameter.symbol,
        "default": parameter.default,
        "units": parameter.unit,
        "range": _range(parameter),
        "usual": "" if parameter.usual is None else " to ".join(f"{end:g}" for end in parameter.usual),
        "meaning": parameter.long_name,
    }


def _range(parameter: Parameter) -> str:
    """The admissible values, in words."""
    parts = []
    if parameter.lowest is not None:
        parts.append(f"{'above' if parameter.open_below else 'at least'} {parameter.lowest:g}")
    if parameter.below is not None:
        parts.append(f"below {parameter.below:g}")
    return ", ".join(parts) or "any"


def _of_choices(names: Names) -> dict[str, dict[str, Parameter]]:
    """The parameters that only some friction laws, or shapes of pulses, have, by what is chosen."""
    if isinstance(names.system, HasFriction):
        first = names.friction
        laws = sorted(FRICTION_LAWS.values(), key=lambda law: law.name != first)
        return {f'friction = "{law.name}" ({law.reference})': dict(law.parameters) for law in laws}
    if "pulse_shape" not in names.options:
        return {}
    options = ({"pulse_shape": shape} for shape in PULSE_SHAPES)
    of_shapes = (read_names(Place("scenes"), names.system, chosen).parameters for chosen in options)
    shapes = dict(zip(PULSE_SHAPES, map(dict, of_shapes), strict=True))
    everywhere = set.intersection(*(set(parameters) for parameters in shapes.values()))
    return {
        f'pulse_shape = "{shape}"': {name: one for name, one in parameters.items() if name not in everywhere}
        for shape, parameters in shapes.items()
    }


def _features(scene: Scene[Any]) -> list[str]:
    """The names of what is measured of a scene; nothing is computed for it."""

    def run() -> Any:
        values = {name: jnp.full(1, one.default) for name, one in scene.parameters().items()}
        constants = scene.constants(values)
        state = scene.start(constants, scene.starts[0] if scene.starts else None, (1,))
        stepper = stepper_named("located")
        effort = Effort(stepper.accuracy(Wanted(error=1e-4), scene), 1.0)
        return run_block(scene, stepper, recorder_for(scene), constants, state, effort, 1.0, 1.0)

    with precision("float64"):
        return list(jax.eval_shape(run))


def _summary(kind: type) -> str:
    """The first line of a class's docstring."""
    return str(kind.__doc__ or kind.__name__).strip().splitlines()[0] if is_dataclass(kind) else kind.__name__
