"""The variables of a sweep's dataset: name, unit, meaning, and data type."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Variable:
    """The attributes and the data type of a dataset variable.

    - `units`, `long_name`: CF attributes.
    - `dtype`: data type of the stored values.
    - `flags`: the meaning of each integer value, from `first_flag` (0 by default) upwards.
    - `along`: name of a dimension that the variable has in addition to the dimensions of the sweep; "" for none.
    - `dims`: all dimensions of the variable, if they are the same in every dataset. For a variable with `dims`, pass
      only the values to `Analysis.dataset`.
    - `notes`: further attributes by name, such as a definition.

    **Example:**

    >>> vj.Variable("Hz", "strongest frequency of the bit").attributes()
    {'units': 'Hz', 'long_name': 'strongest frequency of the bit'}
    """

    units: str
    long_name: str
    dtype: type[np.generic] = np.float64
    flags: tuple[str, ...] = ()
    first_flag: int = 0
    along: str = ""
    notes: Mapping[str, str | float] = field(default_factory=dict, hash=False)
    dims: tuple[str, ...] = ()

    def attributes(self) -> dict[str, Any]:
        """Return the CF attributes of the variable, by name; a text has no units."""
        attributes: dict[str, Any] = {"units": self.units, "long_name": self.long_name, **self.notes}
        if self.dtype is np.str_:
            del attributes["units"]
        if self.flags:
            attributes["flag_values"] = self.first_flag + np.arange(len(self.flags), dtype=np.int8)
            # CF 1.11, section 3.5: apart from letters and digits, a flag's meaning may contain only - _ . + @.
            attributes["flag_meanings"] = " ".join(flag.replace("/", "-over-") for flag in self.flags)
        return attributes

    def entry(self, dims: Any, values: Any) -> tuple[Any, np.ndarray, dict[str, Any]]:
        """Return the variable of a dataset: its dimensions, the values in its data type, and its attributes."""
        return dims, np.asarray(values, self.dtype), self.attributes()


def described(table: Mapping[Any, Any], schema: Mapping[str, Variable]) -> dict[Any, Any]:
    """Return variables with the data types and attributes in `schema`.

    **Arguments:** `table`: (dimensions, values) by name, or the values alone of a variable that states its `dims`;
    entries of another form are not changed.
    """

    def entry(name: Any, given: Any) -> Any:
        if name not in schema or (isinstance(given, tuple) and len(given) != 2):
            return given
        dims, values = given if isinstance(given, tuple) else (schema[name].dims, given)
        return schema[name].entry(dims, values)

    return {name: entry(name, given) for name, given in table.items()}


REGIMES = (
    "undecided",
    "equilibrium",
    "impact-free",
    "single-impact",
    "multi-impact",
    "subharmonic",
    "irregular",
    "failed",
)
"""Names of the regimes; the index of a name is the flag value."""

OWN_REGIMES = "regime of the motion"
"""Meaning of the variable `regime` of scenes without a striker."""

STATUSES = ("done", "failed", "refused")
"""Meaning of each flag of `status`."""

REASONS = (
    "none",
    "not-finite",
    "out-of-steps",
    "pulse-width-not-below-1/frequency",
    "too-stiff",
    "too-slow",
    "beyond-a-stop",
    "restitution-not-0-to-1",
    "negative-normal-force",
    "slides-on-two-switches",
    "negative-friction-at-rest",
    "mass-not-above-zero",
    "friction-drives",
    "static-below-sliding",
    "period-not-above-zero",
)
"""Meaning of each flag of `reason`."""

ORBIT_REASONS = ("found", "not-repeating", "not-converged", "near-grazing", "another-orbit", "refused")
"""Meaning of each flag of `orbit_reason`."""

STABILITIES = ("not-known", "unstable", "stable")
"""Meaning of the flags -1, 0 and 1 of `stable`."""

NATURES = ("unknown", "periodic", "quasi-periodic", "chaotic", "not-settled")
"""Meaning of each flag of `nature`, the classification of a lane by its largest Lyapunov exponent."""


def orbit_name(state: str) -> str:
    """Return the name of the variable that holds a state variable of the orbit at the section."""
    return f"orbit_{state}"


VARIABLES: dict[str, Variable] = {
    "regime": Variable("1", "regime of the striker's motion", np.int8, REGIMES),
    "check_regime": Variable("1", "regime in the check run, a second simulation with longer steps", np.int8, REGIMES),
    "hidden_motion": Variable(
        "1",
        "whether another start at the same point leads to a different motion of the same regime",
        np.int8,
        ("none", "another"),
    ),
    "period": Variable("s", "period"),
    "cycles": Variable("1", "number of returns after which the motion repeats (0: it does not)", np.int8),
    "returns": Variable("1", "number of observed returns to the section", np.int32),
    "impacts": Variable("1", "number of impacts per period of the motion (per return if cycles is 0)"),
    "impact_velocity": Variable("m s-1", "impact velocity"),
    "impact_velocity_min": Variable("m s-1", "least impact velocity"),
    "impact_velocity_max": Variable("m s-1", "greatest impact velocity"),
    "bit_velocity_at_impact": Variable("m s-1", "sliding velocity of the bit at an impact"),
    "impact_phase": Variable("rad", "mean phase of the impacts between two returns, 0 at the section crossing"),
    "impact_energy": Variable("J", "impact energy"),
    "impact_power": Variable(
        "W",
        "mean power of the impacts",
        notes={"definition": "impact_energy impacts/(cycles period); 0 without impacts, NaN if cycles is 0"},
    ),
    "blow_frequency": Variable("min-1", "impacts per minute"),
    "peak_impact_force": Variable("N", "peak contact force"),
    "mean_impact_force": Variable("N", "mean contact force"),
    "stick_fraction": Variable("1", "share of time in which the bit sticks to the rock"),
    "reverse_fraction": Variable("1", "share of time in which the bit slides backwards"),
    "stick_slip_index": Variable(
        "1",
        "stick-slip index of the bit",
        notes={
            "definition": "(greatest - least)/(2 mean) of the bit's sliding velocity u = x1' + v in the observation; "
            "the mean of a periodic motion is the drive speed v"
        },
    ),
    "bit_amplitude": Variable("m", "half the peak-to-peak range of the bit's position"),
    "striker_amplitude": Variable("m", "half the peak-to-peak range of the striker's position"),
    "striker_turns": Variable("1", "number of maxima of the striker's position per return"),
    "phase_lag": Variable("rad", "phase lag of the striker's fundamental oscillation behind the bit's"),
    "settling_time": Variable("s", "time after which the returns repeat within 1 %"),
    "drive_power": Variable("W", "mean power of the drive"),
    "error_estimate": Variable("1", "estimated relative error of period and impact velocity, the larger of the two"),
    "drift_estimate": Variable(
        "1", "estimated relative distance of period, impact velocity and amplitudes from settled values"
    ),
    "sensitive": Variable("1", "1 if numerical errors decide which attractor the lane reaches, else 0", np.int8),
    "status": Variable("1", "whether the lane was computed", np.int8, STATUSES),
    "reason": Variable("1", "reason why the lane failed or was refused", np.int8, REASONS),
    "rate_of_penetration": Variable("m s-1", "rate of penetration"),
    "mean_force": Variable("N", "mean force on the bit, P"),
    "relief": Variable("1", "mean force divided by the threshold, P/D"),
    "slip_per_impact": Variable("m", "growth of the hole's depth per impact (per pulse under a prescribed force)"),
    "specific_energy": Variable(
        "J m-3",
        "impact energy per volume of the hole",
        notes={"definition": "impact_power/(pi bit_radius^2 rate_of_penetration); NaN if cycles or the rate is 0"},
    ),
    "deepest_gap": Variable(
        "m", "greatest distance of the bit above the rock, with a minus sign; 0 without separation"
    ),
    "multiplier_abs": Variable("1", "modulus of the orbit's multipliers, in decreasing order", along="multiplier"),
    "multiplier_arg": Variable("rad", "argument of the orbit's multipliers, 0 to pi", along="multiplier"),
    "eigenvalue_re": Variable(
        "s-1", "real part of the equilibrium's eigenvalues, in decreasing order", along="eigenvalue"
    ),
    "eigenvalue_im": Variable("s-1", "imaginary part of the equilibrium's eigenvalues", along="eigenvalue"),
    "stable": Variable("1", "whether all multipliers are inside the unit circle", np.int8, STABILITIES, -1),
    "orbit_residual": Variable(
        "1", "largest scaled distance of the orbit's points from their images under the return map"
    ),
    "grazing_margin": Variable("1", "scaled distance of the orbit from a change in the order of its events"),
    "orbit_cycles": Variable("1", "number of returns after which the orbit repeats", np.int8),
    "orbit_reason": Variable("1", "result of the search for the orbit", np.int8, ORBIT_REASONS),
    "nearby_cycles": Variable(
        "1", "number of returns after which a stable orbit near the lane repeats (0: none found)", np.int8
    ),
    "nearby_impacts": Variable("1", "number of impacts per period of the nearby stable orbit"),
    "nearby_distance": Variable(
        "1", "largest distance of the lane's last returns from the nearby stable orbit, in amplitudes"
    ),
    "lyapunov": Variable("1/s", "largest Lyapunov exponent of the flow, without the trivial zero"),
    "lyapunov_stderr": Variable(
        "1/s", "standard error of lyapunov from blocks of returns (0 for an exponent from multipliers)"
    ),
    "zero_one": Variable(
        "1", "0-1 test for chaos on the returns of a lane that does not repeat: near 1 if chaotic, near 0 if regular"
    ),
    "nature": Variable("1", "kind of motion according to its largest Lyapunov exponent", np.int8, NATURES),
    "return_time": Variable("s", "time of the return", along="return_index"),
    "return_impacts": Variable("1", "impacts since the previous return", along="return_index"),
    "return_impact_velocity": Variable("m s-1", "impact velocity at the return", along="return_index"),
}
