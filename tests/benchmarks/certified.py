"""Compare certified lanes of random machines with the same lanes after a settling time 50 times as long.

    python tests/benchmarks/certified.py [LANES] [SEED]

A lane is certified if `error_estimate` is within the accepted error and `sensitive` is 0. The script prints the share
of certified lanes that keep their label, cycles and impacts and lie within their estimate, and every lane that does
not. A lane that fails at the long settling time is printed too, but not counted. 2,000 lanes take some 5 minutes;
tests/hard/README.md has the last results.
"""

import sys
from pathlib import Path

import numpy as np
import xarray as xr

sys.path.insert(0, str(Path(__file__).parents[2]))
import vibrojax as vj

SOON, LATE = 40.0, 2000.0
"""Settling times to compare [s]."""

BOX = {
    "beta": (0.1, 1.2),
    "gamma": (0.3, 1.5),
    "v": (0.3, 2.5),
    "delta": (-0.02, 0.012),
    "c2": (50.0, 400.0),
    "m1": (100.0, 300.0),
}
LOGARITHMIC = {"k0": (5e6, 1e8), "k1": (1e5, 7e5)}
CONTACT_DAMPING = (0.0, 0.1, 3000.0)
LAWS = {
    "stribeck": {"mu": (0.1, 0.8)},
    "coulomb": {"mu": (0.1, 0.8)},
    "popp-exponential": {},
    "popp-arctan": {"a1": (0.05, 0.2)},
    "hyperbolic": {"mu0": (0.1, 0.6), "delta_f": (0.3, 5.0)},
    "hyperbolic-quadratic": {"mu0": (0.1, 0.6)},
}
STARTS = ("stuck", "drive", "touching")


def points(law: str, lanes: int, rng: np.random.Generator) -> dict[str, list]:
    """Return random values of every parameter, and the starts in turn."""
    columns = {name: rng.uniform(*bounds, lanes).tolist() for name, bounds in (BOX | LAWS[law]).items()}
    columns |= {name: np.exp(rng.uniform(*np.log(bounds), lanes)).tolist() for name, bounds in LOGARITHMIC.items()}
    columns["c0"] = [CONTACT_DAMPING[lane % 3] for lane in range(lanes)]
    columns["start"] = [STARTS[lane // 3 % 3] for lane in range(lanes)]
    return columns


def sweep(law: str, columns: dict[str, list], settle: float) -> xr.Dataset:
    """Run the lanes with one friction law."""
    return vj.run_sweep(
        {
            "scene": "vibro-impact",
            "unusual": True,
            "parameters": {"friction": law},
            "points": columns,
            "run": {"settle": settle},
        },
        progress=False,
    )


def relative_changes(soon: xr.Dataset, late: xr.Dataset) -> np.ndarray:
    """Return the larger relative change of period and impact velocity of each lane."""
    with np.errstate(invalid="ignore", divide="ignore"):
        changes = [np.abs(soon[name].values / late[name].values - 1) for name in ("period", "impact_velocity")]
    return np.fmax(*changes)


def main(lanes: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    certified = kept = sensitive = 0
    for law in LAWS:
        columns = points(law, -(-lanes // len(LAWS)), rng)
        soon, late = (sweep(law, columns, settle) for settle in (SOON, LATE))
        flagged = soon.sensitive.values == 1 if "sensitive" in soon else np.zeros(soon.sizes["point"], bool)
        is_certified = (soon.error_estimate.values <= 1e-4) & ~flagged
        same = np.all([soon[name].values == late[name].values for name in ("regime", "cycles", "impacts")], axis=0)
        changes = relative_changes(soon, late)
        good = same & ((changes <= soon.error_estimate.values) | np.isnan(changes))
        failed = late.status.values != 0
        certified, kept = certified + (is_certified & ~failed).sum(), kept + (is_certified & good).sum()
        sensitive += flagged.sum()
        print(
            f"{law}: {is_certified.sum()} certified of {is_certified.size}, {(is_certified & good).sum()} hold",
            flush=True,
        )
        for lane in np.flatnonzero(is_certified & ~good):
            values = {name: column[lane] for name, column in columns.items()}
            labels = "; ".join(
                f"{ds.regime.values[lane]} cycles {ds.cycles.values[lane]} impacts {ds.impacts.values[lane]:.3g}"
                for ds in (soon, late)
            )
            estimate, drift = soon.error_estimate.values[lane], soon.drift_estimate.values[lane]
            reason = late.reason.attrs["flag_meanings"].split()[late.reason.values[lane]]
            print(f"  {labels} ({reason}); change {changes[lane]:.2g}, estimate {estimate:.2g}, drift {drift:.2g}")
            print(f"    settled at {soon.settling_time.values[lane]:.3g} s; {values}")
    print(f"{kept} of {certified} certified lanes hold: {kept / certified:.2%}; {sensitive} sensitive")


if __name__ == "__main__":
    main(*(int(word) for word in (sys.argv[1:] + ["2000", "1"][len(sys.argv) - 1 :])))
