"""Known faults in datasets written by earlier versions: opening such a dataset issues a warning."""

import warnings

import xarray as xr


class KnownFault(UserWarning):
    """A warning that a dataset may hold wrong numbers because of a bug in the version that wrote it."""


def warn_of_faults(dataset: xr.Dataset, file: str) -> None:
    """Issue a one-line warning if the version that wrote this dataset has a known fault that affects it."""
    swept = dataset.attrs.get("source") == "vibrojax 0.1.0" and "lanes" in dataset.attrs
    if swept and dataset.attrs.get("friction") == "popp-arctan":
        warnings.warn(
            f"{file}: made by vibrojax 0.1.0, whose sweeps with friction popp-arctan are wrong where jaxlib was 0.10.2 "
            "to 0.11.2 and the processor has AVX-512; run the sweep again",
            KnownFault,
            stacklevel=3,
        )
