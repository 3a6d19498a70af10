"""The analysis `push`: the smallest push in each state variable after which a machine leaves its working cycle."""

import xarray as xr

from vibrojax.analyses.analysis import Analysis, PictureRule, SummaryPart
from vibrojax.analyses.push.picture import smallest_pushes
from vibrojax.io.attributes import flags


class Pushes(Analysis):
    """Find the smallest push in each state variable after which a machine no longer returns to its working cycle."""

    kind = "push"
    pictures = (PictureRule("pushes", lambda held: True, smallest_pushes),)

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        """Return a line for each machine, state variable and sign of the push."""
        return [SummaryPart("pushes", push_lines(ds))]


def push_lines(ds: xr.Dataset) -> list[str]:
    """Return lines of text: the working cycle of each machine, then its smallest pushes.

    The line of each state variable and sign contains the smallest push and the regime in which the motion then ends.
    """
    machines = ds if "point" in ds.dims else ds.expand_dims("point")
    varied = [name for name, data in machines.coords.items() if data.dims == ("point",) and name != "point"]
    meanings = flags(ds["regime"])
    lines = []
    for number in range(machines.sizes["point"]):
        machine = machines.isel(point=number)
        values = [f"{name} = {machine[name].item():g}" for name in varied if machine[name].dtype.kind == "f"]
        lines += [f"{', '.join(values)}:"] if values else []
        regime = meanings[int(machine["regime"])]
        if not float(machine["bound_x1"]) > 0:
            lines.append(f"no stable cycle ({regime})")
            continue
        lines.append(f"working cycle: {regime}, {float(machine['period']):.5g} s")
        states = [str(name).removeprefix("push_") for name in machine.data_vars if str(name).startswith("push_")]
        for state in states:
            push = machine[f"push_{state}"]
            unit = push.attrs["units"].replace(" s-1", "/s")
            for k, sign in enumerate("-+"):
                size, bracket = float(push[k]), float(machine[f"bracket_{state}"][k])
                text = f"none up to {float(machine[f'bound_{state}']):.4g} {unit} leaves it"
                if size == size:
                    regime = meanings[int(machine[f"regime_{state}"][k])]
                    text = f"{size:.4g} {unit} (within {bracket:.1g}): {regime}"
                lines.append(f"  {state} {sign}  {text}")
    return lines
