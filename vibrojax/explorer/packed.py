"""Arrays as text in a page: their bytes, shuffled and deflated, in base64."""

import base64
import zlib

import numpy as np

DIGITS = 16
"""Bits of a float's mantissa that are kept: five digits."""

_LEVEL = 9


def packed(values: np.ndarray) -> dict[str, object]:
    """An array as {"dtype": "f4", "i1" or "i4", "shape", "data"}, which the page's `unpack` reads.

    The bytes of all values are stored plane by plane (all first bytes, all second ones, ...), little-endian.
    """
    kind = "f4" if values.dtype.kind == "f" else "i1" if _fits(values) else "i4"
    array = _rounded(values) if kind == "f4" else values.astype(kind)
    content = np.frombuffer(np.ascontiguousarray(array).astype(f"<{kind}").tobytes(), np.uint8)
    planes = content.reshape(-1, np.dtype(kind).itemsize).T.tobytes()
    return {"dtype": kind, "shape": list(values.shape), "data": deflated(planes)}


def deflated(content: bytes) -> str:
    """Bytes deflated (zlib's format), in base64."""
    return base64.b64encode(zlib.compress(content, _LEVEL)).decode()


def _fits(values: np.ndarray) -> bool:
    return values.size == 0 or (int(values.min()) >= -128 and int(values.max()) <= 127)


def _rounded(values: np.ndarray) -> np.ndarray:
    """The values as 32-bit floats with short mantissas, which deflate better."""
    with np.errstate(over="ignore"):  # what is too large is infinite
        bits = np.ascontiguousarray(values, np.float32).view(np.uint32)
    dropped = 23 - DIGITS
    rounded = ((bits + np.uint32(1 << (dropped - 1))) >> np.uint32(dropped) << np.uint32(dropped)).view(np.float32)
    with np.errstate(over="ignore"):
        return np.where(np.isfinite(values), rounded, values).astype(np.float32)
