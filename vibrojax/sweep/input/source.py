"""Where a sweep comes from: a path, a bundled name, or a dict."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from vibrojax.errors import InputError, Place, nearest, shown, suggestion
from vibrojax.models.physics.friction import FrictionLaw
from vibrojax.models.scenes import Scene
from vibrojax.stepping import Stepper
from vibrojax.sweep.input.plain import plain_table, render

_PACKAGE = Path(__file__).parents[2]
# A wheel carries the sweeps inside the package; in a checkout they lie at the top.
_CHECKOUT = (_PACKAGE.parent,) if (_PACKAGE.parent / "pyproject.toml").exists() else ()
BUNDLED_FOLDERS = tuple(folder / "sweeps" for folder in (_PACKAGE, *_CHECKOUT))


@dataclass(frozen=True)
class Source:
    """A sweep before it is checked: its `name`, the `file` to name in messages, where its files lie, and its tables."""

    name: str
    file: str
    folder: Path
    text: str
    tables: dict[str, object]


def read_source(source: str | PathLike[str] | Mapping[str, object]) -> Source:
    """The sweep's tables from a path to a TOML file, a bundled name, or a dict of the same shape.

    In a dict a scene, a friction law or a stepper may stand itself where its name stands in a file.
    """
    if isinstance(source, Mapping):
        objects, named = without_objects(source)
        tables = plain_table(Place("sweep"), named)
        text = render(tables)
        for (table, key), value in objects.items():
            home = tables[table] if table else tables
            if isinstance(home, dict):
                home[key] = value
        return Source("sweep", "sweep", Path(), text, tables)
    if not isinstance(source, (str, PathLike)):
        raise InputError(f"sweep: {shown(source)} is no sweep; give a path, a bundled name or a dict")
    found = _bundled(source) if isinstance(source, str) else None
    path = found or Path(source)
    if not found and isinstance(source, str) and _is_name(source) and not path.exists():
        raise InputError(f"{source}: no such bundled sweep or file; {suggestion(source, bundled_names())}")
    text = read_text(path)
    return Source(str(source) if found else path.stem, str(path), path.parent, text, _parse(path, text))


def without_objects(source: Mapping[str, object]) -> tuple[dict[tuple[str, str], object], dict[str, object]]:
    """The objects that stand in place of names, by table and key, and the tables with their names instead."""
    objects: dict[tuple[str, str], object] = {}
    named = dict(source)
    scene = named.get("scene")
    if isinstance(scene, Scene):
        objects["", "scene"] = scene
        named["scene"] = scene.name
    for table, key in (("parameters", "friction"), ("run", "method")):
        home = named.get(table)
        value = home.get(key) if isinstance(home, Mapping) else None
        if isinstance(home, Mapping) and isinstance(value, FrictionLaw | Stepper):
            objects[table, key] = value
            named[table] = {**home, key: value.name}
    return objects, named


def read_text(path: Path) -> str:
    """The text of a file that a user named, without its byte order mark."""
    try:
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text (byte {error.start}); save it as UTF-8") from None
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give the path of one that is there{_hint(path)}") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; give the path of a file") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise InputError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None


def bundled_names() -> list[str]:
    """The names of the sweeps that come with the package."""
    return sorted({_spelled(path.stem) for folder in BUNDLED_FOLDERS for path in folder.glob("*.toml")})


def _bundled(name: str) -> Path | None:
    """The bundled file called `name`, hyphens and underscores alike; None where there is none."""
    if not _is_name(name):
        return None
    paths = (path for folder in BUNDLED_FOLDERS for path in sorted(folder.glob("*.toml")))
    return next((path for path in paths if _spelled(path.stem) == _spelled(name)), None)


def _spelled(name: str) -> str:
    return name.replace("_", "-")


def _is_name(source: str) -> bool:
    return Path(source).name == source and not source.endswith(".toml")


def _hint(path: Path) -> str:
    similar = [other.name for other in path.parent.glob(f"*{path.suffix}")] if path.parent.is_dir() else []
    found = nearest(path.name, similar)
    return f" (did you mean {shown(found)}?)" if found else ""


def _parse(path: Path, text: str) -> dict[str, object]:
    try:
        return tomllib.loads(text)
    except ValueError as error:  # also numbers of thousands of digits, which are no TOMLDecodeError
        raise Place(str(path)).error(f"not TOML: {error}") from None
    except RecursionError:
        raise InputError(f"{path}: not TOML: tables or lists nested too deep") from None
