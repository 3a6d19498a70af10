"""Where a result comes from: the versions of this package and of jax."""

from importlib.metadata import PackageNotFoundError, version


def package_version() -> str:
    """Version of this package as installed; the only place that tells it, from `pyproject.toml`."""
    try:
        return version("vibrojax")
    except PackageNotFoundError:
        return "0+unknown"


def jax_version() -> str:
    """Version of jax, whose compiler decides the last digits of results."""
    import jax  # not above: the version of this package needs no jax

    return jax.__version__


def source() -> str:
    """The dataset attribute `source`: name and version."""
    return f"vibrojax {package_version()}"


def provenance() -> dict[str, str]:
    """The attributes that every dataset carries of its making: `source` (name and version) and `jax` (its version)."""
    return {"source": source(), "jax": jax_version()}
