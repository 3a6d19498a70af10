"""The specification of a study: a TOML file, a bundled name or a dict, checked before anything runs."""

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike

from vibrojax.errors import Place, shown, suggestion
from vibrojax.lanes.scene_variables import sweep_variables
from vibrojax.maps.bounds import read_bounds, read_points_of, read_specification
from vibrojax.maps.read import read_parameters
from vibrojax.maps.sweep import Sweep
from vibrojax.settings.names import Names
from vibrojax.settings.toml import read_source
from vibrojax.settings.values import check_distinct, count, flag
from vibrojax.studies.effects_sampling import Sampling

DEFAULT_SAMPLES = 256
"""Number of base samples if the file gives none."""

MAX_SAMPLES = 2**16

SHARE = "share_single_impact"
"""Name in `of` for the share of starts from which a point has a single impact."""

_KEYS = ("scene", "title", "of", "starts", "samples", "seed", "unusual", "vary", "parameters", "run")


@dataclass(frozen=True, eq=False)
class Study:
    """A checked study: the variables `of` which it explains, the samples, and a sweep with one point per sample."""

    of: list[str]
    sampling: Sampling
    sweep: Sweep
    text: str

    def identity(self) -> dict[str, object]:
        """Return all settings on which the result depends, as flat JSON values."""
        bounds = {f"vary.{name}": list(x) for name, x in self.sampling.bounds.items()}
        own = {"study": True, "of": self.of, "samples": self.sampling.samples, "seed": self.sampling.seed}
        return self.sweep.identity() | own | bounds


def read_study(source: str | PathLike[str] | Mapping[str, object]) -> Study:
    """Read a study from the path of a TOML file, the name of a bundled study, or a dict with the same structure.

    **Raises:** `InputError` with a one-line message at the first error.
    """
    origin = read_source(source, "study")
    place, tables, fixed, names = read_specification(origin, _KEYS)
    read_parameters(place.at("parameters"), dict(fixed), names)
    unusual = flag(place.at("unusual"), tables.get("unusual", False))
    sampling = Sampling(
        read_bounds(place.at("vary"), tables.get("vary"), names, fixed, unusual),
        _read_samples(place.at("samples"), tables.get("samples", DEFAULT_SAMPLES)),
        count(place.at("seed"), tables.get("seed", 0), 0),
    )
    of = _read_of(place.at("of"), tables.get("of"), names)
    columns = {name: x.tolist() for name, x in zip(sampling.names, sampling.points().T, strict=True)}
    kept: dict[str, object] = {key: tables[key] for key in ("scene", "starts", "run") if key in tables}
    title = tables.get("title") or f"Study of {', '.join(of)}"
    sweep = read_points_of(
        origin.file, {**kept, "title": title, "parameters": fixed, "points": columns, "unusual": True}
    )
    return Study(of, sampling, sweep, origin.text)


def _read_of(place: Place, value: object, names: Names) -> list[str]:
    if not isinstance(value, list) or not value:
        problem = "missing" if value is None else f"{shown(value)} names no variable"
        raise place.error(f'{problem}; write a list like of = ["impact_energy", "blow_frequency"]')
    known = sweep_variables(names.system)
    plain = [name for name, about in known.items() if not (about.flags or about.along)]
    allowed = plain + [SHARE] * ("impacts" in plain and "regime" in known)
    for index, name in enumerate(value):
        if name not in allowed:
            raise place.item(index).error(
                f"scene {shown(names.scene)} has no variable {shown(name)}; {suggestion(str(name), allowed)}"
            )
    check_distinct(place, value, "variable")
    return list(value)


def _read_samples(place: Place, value: object) -> int:
    samples = count(place, value, 2, MAX_SAMPLES)
    if samples & (samples - 1):
        below = 1 << (samples.bit_length() - 1)
        raise place.error(f"{samples} is not a power of two; give {below} or {2 * below}")
    return samples
