"""The machines, one file each; a file in this folder that binds `SCENE` is found by itself."""

from importlib import import_module
from pkgutil import iter_modules

from vibrojax.scenes._scene import Scene as Scene

_files = (
    import_module(f"{__name__}.{found.name}") for found in iter_modules(__path__) if not found.name.startswith("_")
)

SCENES: dict[str, type[Scene]] = {file.SCENE.name: file.SCENE for file in _files}
