"""Where a result comes from."""

from importlib.metadata import PackageNotFoundError, version


def package_version() -> str:
    """Version of this package as installed."""
    try:
        return version("vibrojax")
    except PackageNotFoundError:
        return "0+unknown"


def source() -> str:
    """The dataset attribute `source`: name and version."""
    return f"vibrojax {package_version()}"
