"""Sizes and times as readable strings."""


def size_text(size: int | float) -> str:
    """Return a size in bytes as a string, such as `1.5 GB`."""
    for unit in ("B", "kB", "MB", "GB"):
        if size < 999.5:
            return f"{size:.3g} {unit}"
        size /= 1000
    return _text(size, "TB", 1e9)


def time_text(seconds: int | float) -> str:
    """Return a time in seconds as a string, such as `2.5 h`."""
    for unit, length in (("days", 86400), ("h", 3600), ("min", 60)):
        if seconds >= 2 * length:
            return _text(seconds / length, unit, 1e6)
    return f"{seconds:.3g} s"


def _text(amount: int | float, unit: str, largest_plain: float) -> str:
    plain = 1000 <= amount < largest_plain
    return f"{amount:,.0f} {unit}" if plain else f"{amount:.3g} {unit}"
