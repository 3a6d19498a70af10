"""Sizes and times in words, as people read them."""


def size_text(size: int | float) -> str:
    """A size in bytes, as people read it."""
    for unit in ("B", "kB", "MB", "GB"):
        if size < 999.5:
            return f"{size:.3g} {unit}"
        size /= 1000
    return _text(size, "TB", 1e9)


def time_text(seconds: int | float) -> str:
    """A time in seconds, as people read it."""
    for unit, length in (("days", 86400), ("h", 3600), ("min", 60)):
        if seconds >= 2 * length:
            return _text(seconds / length, unit, 1e6)
    return f"{seconds:.3g} s"


def _text(amount: int | float, unit: str, most: float) -> str:
    if amount < 1000:
        return f"{amount:.3g} {unit}"
    return f"{amount:,.0f} {unit}" if amount < most else f"{amount:.3g} {unit}"
