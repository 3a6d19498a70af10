"""The fits may promote: they mix counts, masks and floats, and call a library that does. What steps lanes may not."""

import jax
import pytest


@pytest.fixture(autouse=True, scope="module")
def promotion():
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield
