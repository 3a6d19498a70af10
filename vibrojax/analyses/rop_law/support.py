"""Texts on a log: the forms that its blocks of rows support, and what it determines without a threshold."""

import numpy as np
import xarray as xr

from vibrojax.analyses.rop_law.blocks import CONTAINED, Standing
from vibrojax.analyses.rop_law.reading import GROUPS_TABULATED, formulas_of, group_names, standings, table
from vibrojax.errors import counted
from vibrojax.io.attributes import attribute_of


def supported_forms(fit: xr.Dataset) -> list[str]:
    """Return lines of text: the form that each of the first groups supports, and forms that may be the truth too."""
    standing, aic = standings(fit), table(fit, "aic")
    names, lines = np.array([str(name) for name in fit["form"].values]), []
    groups = np.flatnonzero((standing == Standing.CHOSEN).any(axis=1))
    for group in groups[:GROUPS_TABULATED].tolist():
        [chosen] = names[standing[group] == Standing.CHOSEN]
        rivals = ", ".join(names[standing[group] == Standing.UNDECIDED])
        name = group_names(fit)[group]
        if rivals:
            lines.append(f"{name}: these data cannot tell {chosen} from {rivals}")
        else:
            contains = (standing[group] == Standing.CONTAINS_CHOSEN).any()
            others = "every form that does not contain it" if contains else "the other forms"
            lines.append(f"{name}: the data support {chosen}, {formulas_of(fit)[str(chosen)]}, against {others}")
        best = str(names[np.nanargmin(aic[group])])
        if best != chosen and best not in CONTAINED.get(str(chosen), ()):
            lines.append(f"  AIC is lowest for {best}, but takes neighbouring rows for independent")
    more = groups.size - GROUPS_TABULATED
    lines += [f"and {counted(more, 'group')} more"] if more > 0 else []
    return ["by the rates of each block of rows, predicted from the other blocks (CV):", *(f"  {x}" for x in lines)]


def determined_combinations(fit: xr.Dataset) -> list[str]:
    """Return lines of text: what the data determine if the threshold is unknown."""
    force = attribute_of(fit, "reference_force")
    if force is None:
        return []
    onset, error = (fit[f"onset_force{name}"].sel(form="onset").values.ravel() for name in ("", "_stderr"))
    slope = fit["C"].sel(form="line").values.ravel() / force
    known = np.isfinite(onset)
    lines = [
        f"the threshold D is unknown, so that eta = P/{force / 1e3:.4g} kN, by the median of the mean force P. "
        "The data determine C and eta0 D of onset, C/D and eta0 D of line, the exponent and C/D^exponent of power:"
    ]
    for group in np.flatnonzero(known)[:GROUPS_TABULATED].tolist():
        lines.append(
            f"  {group_names(fit)[group]}: onset eta0 D = {onset[group] / 1e3:.4g} ± {error[group] / 1e3:.2g} kN; "
            f"line C/D = {1e3 * slope[group]:.4g} m/s per kN"
        )
    if known.any():
        lines.append("  literal and percent have the curve of onset: D would be eta0 D, or 100 times as much")
    return lines
