"""Simulation of self-exciting percussive-rotary drilling over large parameter spaces.

    import vibrojax as vj
    ds = vj.run_sweep("regime-map")

Public names are imported on first use, so that importing the package is fast and changes no global settings. The stub
`__init__.pyi` lists them with their modules, for this package as well as for editors and type checkers.
"""

import re
from importlib import import_module
from pathlib import Path

_STUB = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")
_HOMES = {name: home for home, name in re.findall(r"^from (\S+) import (\w+) as \2$", _STUB, re.MULTILINE)}

__all__ = list(_HOMES)  # the names of the stub


def __getattr__(name: str) -> object:
    if name == "__version__":
        value: object = import_module("vibrojax.io.files").package_version()
    elif name in _HOMES:
        home = import_module(_HOMES[name])
        value = getattr(home, name) if hasattr(home, name) else import_module(f"{_HOMES[name]}.{name}")
    else:
        raise AttributeError(f"module 'vibrojax' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
