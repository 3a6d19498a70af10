"""Find the smallest push in each state after which a machine no longer returns to its working cycle."""

from argparse import ArgumentParser
from typing import TYPE_CHECKING

from vibrojax.cli._command import Options
from vibrojax.cli._complete import scenes, values_with, with_completer
from vibrojax.cli._json import flags
from vibrojax.cli._named_values import named_values, whole
from vibrojax.cli._output import result_at, result_written
from vibrojax.errors import Place

if TYPE_CHECKING:
    import xarray

SETTINGS = ("start", "scan", "precision", "settle", "observe", "most_x1", "most_v1", "most_x2", "most_v2")
"""Arguments of `smallest_push` that are no parameters of a scene."""

_MOST = "most_"


def arguments(parser: ArgumentParser) -> None:
    """Add the command's arguments to `parser`."""
    scene = parser.add_argument("scene", metavar="SCENE", help="rotary, vibro-impact or drilling")
    with_completer(scene, scenes)
    values = parser.add_argument(
        "values",
        metavar="NAME=VALUE",
        nargs="*",
        help="parameters, and friction; a list, beta=0.3,0.4,0.5, is as many machines, pushed together. start (a name, "
        "or [x1,x1',x2,x2']: of the motion whose cycle is pushed), most_x1, most_v1, most_x2, most_v2 (the greatest "
        "push, m or m/s; by default the whole swing), scan (pushes of each scan in a direction: 256), precision "
        "(0.001), settle and observe (s, for which motions settle and are then watched: 40, 8)",
    )
    with_completer(values, values_with(SETTINGS))
    parser.add_argument("-o", dest="out", metavar="OUT.nc", help="where to write (SCENE-push.nc in this folder)")
    parser.add_argument("--fresh", action="store_true", help="replace OUT, whatever it holds")


def run(options: Options) -> None:
    """Run the command."""
    settings, parameters = named_values(Place("push"), options.values, SETTINGS, lists=True)
    from vibrojax.analyses.push.spec import PRECISION, SCAN, read_pushed

    most = {name.removeprefix(_MOST): x for name, x in settings.items() if name.startswith(_MOST)}
    asked = read_pushed(
        options.scene,
        start=settings.get("start"),
        most=most or None,
        scan=whole(settings.get("scan", SCAN)),
        precision=settings.get("precision", PRECISION),
        settle=settings.get("settle", 40.0),
        observe=settings.get("observe", 8.0),
        parameters=parameters,
    )
    result = result_at(options, f"{asked.sweep.scene}-push.nc", asked.identity())

    from vibrojax.analyses.push.run import push_asked

    dataset = push_asked(asked, progress=not options.quiet)
    drawn = result_written(options, dataset, result)
    if not options.quiet:
        print("\n".join([*push_lines(dataset), f"{result.out}{drawn}"]))


def push_lines(dataset: "xarray.Dataset") -> list[str]:
    """A line for each state and side, of each machine."""
    if "sign" not in dataset.dims:
        return []
    machines = dataset if "point" in dataset.dims else dataset.expand_dims("point")
    meanings = flags(dataset["regime"])
    lines = []
    for number in range(machines.sizes["point"]):
        one = machines.isel(point=number)
        names = [name for name, x in machines.coords.items() if x.dims == ("point",) and name != "point"]
        at = ", ".join(f"{name} = {one[name].item():g}" for name in names if one[name].dtype.kind == "f")
        lines += [f"{at}:"] if at else []
        if not float(one["bound_x1"]) > 0:
            lines.append(f"no stable cycle ({meanings[int(one['regime'])]})")
            continue
        lines.append(f"working cycle: {meanings[int(one['regime'])]}, {float(one['period']):.5g} s")
        for name in (str(name).removeprefix("push_") for name in one.data_vars if str(name).startswith("push_")):
            push, unit = one[f"push_{name}"], one[f"push_{name}"].attrs["units"].replace(" s-1", "/s")
            for k, sign in enumerate("-+"):
                size, bracket = float(push[k]), float(one[f"bracket_{name}"][k])
                text = f"none up to {float(one[f'bound_{name}']):.4g} {unit} leaves it"
                if size == size:
                    text = f"{size:.4g} {unit} (within {bracket:.1g}): {meanings[int(one[f'regime_{name}'][k])]}"
                lines.append(f"  {name} {sign}  {text}")
    return lines
