"""Datasets of earlier versions whose numbers are known to be wrong: a warning when they are opened."""

import warnings

import xarray as xr


class KnownFault(UserWarning):
    """A dataset may hold wrong numbers, by a fault of the version that made it."""


def warn_of_faults(dataset: xr.Dataset, file: str) -> None:
    """Warn, on one line, of what is known to be wrong in datasets of the version that made this one."""
    swept = dataset.attrs.get("source") == "vibrojax 0.1.0" and "lanes" in dataset.attrs
    if swept and dataset.attrs.get("friction") == "popp-arctan":
        warnings.warn(
            f"{file}: made by vibrojax 0.1.0, whose sweeps with friction popp-arctan are wrong where jaxlib was 0.10.2 "
            "to 0.11.2 and the processor has AVX-512; run the sweep again",
            KnownFault,
            stacklevel=3,
        )
