"""Provenance of results: the versions of this package and of jax."""

from importlib.metadata import PackageNotFoundError, version


def package_version() -> str:
    """Return the version of this package as installed, from `pyproject.toml`."""
    try:
        return version("vibrojax")
    except PackageNotFoundError:
        return "0+unknown"


def source() -> str:
    """Return the dataset attribute `source`: name and version."""
    return f"vibrojax {package_version()}"


def provenance() -> dict[str, str]:
    """Return the attributes of every dataset on its origin: `source` (name and version) and `jax` (its version)."""
    import jax  # not at the top: the version of this package needs no jax

    return {"source": source(), "jax": jax.__version__}  # jax's compiler decides the last digits of results
