"""Provenance of results: the versions of this package and of jax."""

from importlib.metadata import PackageNotFoundError, version


def package_version() -> str:
    """Return the installed version of this package, or "0+unknown" if the package is not installed."""
    try:
        return version("vibrojax")
    except PackageNotFoundError:
        return "0+unknown"


def source() -> str:
    """Return the value of the dataset attribute `source`: package name and version."""
    return f"vibrojax {package_version()}"


def provenance() -> dict[str, str]:
    """Return the attributes that state the origin of a dataset: `source` (name and version) and `jax` (version)."""
    import jax  # not at the top: reading the package version needs no jax

    return {"source": source(), "jax": jax.__version__}  # the last digits of results depend on jax's compiler
