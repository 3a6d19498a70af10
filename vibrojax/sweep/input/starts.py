"""The starts of a sweep: names and vectors in a list, a sample of a box, or a plane of states."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import prod

import numpy as np
from jaxtyping import Float, Int

from vibrojax.errors import Place, shown
from vibrojax.models.physics.parameters import Parameter
from vibrojax.sweep.input.axes import MOST_VALUES, read_axis
from vibrojax.sweep.input.names import DEFAULT_STARTS, Names
from vibrojax.sweep.input.values import as_table, choice, count, known_keys, quantity

SAMPLES = ("sobol", "random")
"""How a box is sampled: a scrambled Sobol sequence, evenly over the box, or points drawn uniformly."""

_SAMPLE_KEYS = ("sample", "count", "seed", "box", "at")
_PLANE_KEYS = ("plane", "at")
_LIST = 'write one like ["drive", "stuck"]'
SAMPLE = '{ sample = "sobol", count = 256, seed = 0, box = { x1 = [-0.05, 0.05], v1 = [-2.0, 2.0] } }'
PLANE = "{ plane = { x2 = { start = -0.05, stop = 0.05, num = 50 }, v2 = [-1.0, 1.0] } }"
"""How starts by the hundred may be written."""

_BOX, _PLANE = f"write one like {SAMPLE}", f"write one like {PLANE}"
_STATE = Parameter("state", 0.0, "1", "state at t = 0", "y")

Start = str | tuple[float, ...]
"""A start as the items of a list are: a name or a vector."""


@dataclass(frozen=True, eq=False)
class Starts:
    """The starts of a sweep, in their order.

    - `names`: those that have names, each once; `states`: names of the states that a vector gives.
    - `number` (starts,): index into `names` of each, their number for a vector.
    - `vectors` (starts, states): the states [m, m/s] that each starts from; NaN for those that have names.
    - `listed`: whether they were written one by one: else they have no name but their number.
    """

    names: tuple[str, ...]
    states: tuple[str, ...]
    number: Int[np.ndarray, " starts"]
    vectors: Float[np.ndarray, "starts states"]
    listed: bool = True

    def __len__(self) -> int:
        return len(self.number)

    def __getitem__(self, index: int) -> Start:
        """A start, its name or vector."""
        number = int(self.number[index])
        return self.names[number] if number < len(self.names) else tuple(self.vectors[index].tolist())

    def __iter__(self) -> Iterator[Start]:
        return (self[index] for index in range(len(self)))

    @property
    def has_vectors(self) -> bool:
        """Whether some have no name."""
        return bool(np.any(self.number == len(self.names)))


def list_of(starts: Sequence[Start], states: tuple[str, ...]) -> Starts:
    """The starts of a list of names and vectors."""
    names = tuple(dict.fromkeys(start for start in starts if isinstance(start, str)))
    nowhere = (np.nan,) * len(states)
    vectors = np.array([nowhere if isinstance(start, str) else start for start in starts], float)
    number = np.array([names.index(start) if isinstance(start, str) else len(names) for start in starts], int)
    return Starts(names, states, number, vectors.reshape(len(starts), len(states)))


def read_starts(place: Place, value: object, names: Names) -> Starts | None:
    """The starts, checked; `place` is where they stand; None for a scene without."""
    if not names.has_starts:
        if value is not None:
            raise place.error(f"scene {shown(names.scene)} has no starts; leave it out")
        return None
    states = names.system.start_states
    if value is None:
        usual = [start for start in DEFAULT_STARTS if start in names.starts] or names.starts[:1]
        return list_of(usual, states) if usual else None
    if isinstance(value, dict):
        return _drawn(place, value, names)
    if not isinstance(value, list) or not value:
        raise place.error(f"{shown(value)} is no list of starts; {_LIST}, a sample of a box or a plane")
    starts = [names.start(place.item(index), item) for index, item in enumerate(value)]
    seen: set[Start] = set()
    for index, start in enumerate(starts):
        if start in seen:
            raise place.item(index).error(f"{shown(start)} is there already; give each start once")
        seen.add(start)
    return list_of(starts, states)


def _drawn(place: Place, given: dict[str, object], names: Names) -> Starts:
    """A sample or a plane of starts."""
    states = names.system.start_states
    if not states:
        raise place.error(f"scene {shown(names.scene)} starts from no states of the user's; give names")
    if "plane" in given:
        known_keys(place, given, _PLANE_KEYS, {key: "a plane has no such key" for key in _SAMPLE_KEYS})
        columns = _plane(place.at("plane"), given["plane"], states)
    elif "sample" in given:
        known_keys(place, given, _SAMPLE_KEYS)
        columns = _sample(place, given, states)
    else:
        raise place.error(f"neither a sample nor a plane; {_BOX}, or {PLANE}")
    at = _at(place.at("at"), given.get("at", {}), states, columns)
    rows = len(next(iter(columns.values())))
    vectors = np.stack([columns.get(name, np.full(rows, at.get(name, 0.0))) for name in states], axis=1)
    return Starts((), states, np.zeros(rows, int), vectors, listed=False)


def _sample(place: Place, given: Mapping[str, object], states: tuple[str, ...]) -> dict[str, np.ndarray]:
    """The sampled states by name, each (count,)."""
    kind = choice(place.at("sample"), given["sample"], SAMPLES)
    for key in ("count", "box"):
        if key not in given:
            raise place.at(key).error(f"missing; {_BOX}")
    number = count(place.at("count"), given["count"], 1, MOST_VALUES)
    seed = count(place.at("seed"), given.get("seed", 0), 0)
    box = as_table(place.at("box"), given["box"])
    if not box:
        raise place.at("box").error(f"empty; {_BOX}")
    ends = {name: _ends(_state(place.at("box"), name, states), box[name]) for name in box}
    low, high = np.array(list(ends.values())).T
    random = np.random.default_rng(seed)
    unit = _sobol(len(ends), number, random) if kind == "sobol" else random.random((number, len(ends)))
    return dict(zip(ends, (low + (high - low) * unit).T, strict=True))


def _sobol(dimensions: int, number: int, random: np.random.Generator) -> Float[np.ndarray, "number dimensions"]:
    """The first points of a scrambled Sobol sequence in the unit cube (Owen 1998)."""
    from scipy.stats import qmc  # slow to import, and for nothing else

    sampler = qmc.Sobol(dimensions, rng=random)
    return np.asarray(sampler.random_base2((number - 1).bit_length())[:number])


def _ends(place: Place, value: object) -> tuple[float, float]:
    """The two ends of a side of the box."""
    if not isinstance(value, (list, tuple)) or len(value) != 2:
        raise place.error(f"{shown(value)} is no side of a box; write its two ends, like [-0.05, 0.05]")
    low, high = (quantity(place.item(index), end, _STATE) for index, end in enumerate(value))
    if not low < high:
        raise place.error(f"from {low:g} to {high:g} is no side of a box; the first end must be below the second")
    return low, high


def _plane(place: Place, value: object, states: tuple[str, ...]) -> dict[str, np.ndarray]:
    """The states of a plane by name, each (starts,), row-major in the order named."""
    axes = as_table(place, value)
    if not axes:
        raise place.error(f"empty; {_PLANE}")
    values = [read_axis(_state(place, name, states), axis, _STATE) for name, axis in axes.items()]
    if prod(map(len, values)) > MOST_VALUES:
        raise place.error(f"{prod(map(len, values))} starts are too many; {MOST_VALUES} at most")
    return {name: one.ravel() for name, one in zip(axes, np.meshgrid(*values, indexing="ij"), strict=True)}


def _at(place: Place, value: object, states: tuple[str, ...], varied: Mapping[str, object]) -> dict[str, float]:
    """The states that all starts share."""
    given = as_table(place, value)
    for name in given:
        if name in varied:
            raise place.at(name).error("varies already; leave it out")
    return {name: quantity(_state(place, name, states), x, _STATE) for name, x in given.items()}


def _state(place: Place, name: str, states: tuple[str, ...]) -> Place:
    """Where the state `name` is given; raises where the scene starts from no such state."""
    known_keys(place, {name: None}, states)
    return place.at(name)
