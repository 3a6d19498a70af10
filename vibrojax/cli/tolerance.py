"""Simulate a machine over the box of its parameter tolerances: regimes, worst case, and where it occurs."""

import re
from argparse import ArgumentParser

from vibrojax.cli.output import Options, add_json, add_output, file_facts, print_json, result_at, write_result
from vibrojax.cli.values import add_values, named_values
from vibrojax.errors import Place, shown

SETTINGS = ("start", "settle", "observe", "error")
"""Names that are not parameters of a scene."""

_HALF_WIDTH = re.compile(r"\+-|±|\+/-")


def arguments(parser: ArgumentParser) -> None:
    about = (
        "parameters; those with a tolerance as NAME=VALUE+-HALF_WIDTH, like delta=-0.002+-0.001 or gamma=0.64+-1%% "
        "(± is accepted). start (a name, or [x1,x1',x2,x2']; by default all starts), settle and observe (s: 40, 8), "
        "error (1e-4)"
    )
    add_values(parser, SETTINGS, about)
    add_output(parser, "SCENE-tolerance.nc")
    add_json(parser)


def run(options: Options) -> None:
    place = Place("tolerance")
    pairs = dict(_pair(place, word) for word in options.values if _HALF_WIDTH.search(word))
    words = [word for word in options.values if not _HALF_WIDTH.search(word)]
    settings, parameters = named_values(place, words, SETTINGS, lists=False)
    for name in pairs:
        if name in parameters or name in settings:
            raise place.at(name).error("has a second value; give one")
    from vibrojax.analyses.tolerance.run import read_box, simulate_box

    start = settings.pop("start", None)
    box = read_box(options.scene, start, settings, parameters | pairs)
    result = result_at(options, f"{box.sweep.scene}-tolerance.nc", box.identity())
    from vibrojax.analyses.tolerance.analysis import Tolerances

    dataset = simulate_box(box, progress=not (options.quiet or options.json))
    drawn = write_result(options, dataset, result)
    (part,) = Tolerances().summary(dataset)
    if options.json:
        print_json({**part.facts, **file_facts(result, drawn)})
    elif not options.quiet:
        print("\n".join([*part.lines, f"{result.out}{drawn}"]))


def _pair(place: Place, word: str) -> tuple[str, tuple[float, float]]:
    """Return the name, the nominal value and the half-width in NAME=VALUE+-HALF_WIDTH, which may end in %."""
    name, _, text = (part.strip() for part in word.partition("="))
    value, width = (
        (part.strip() for part in _HALF_WIDTH.split(text, maxsplit=1)) if _HALF_WIDTH.search(text) else ("", "")
    )
    try:
        nominal = float(value)
        return name, (nominal, abs(nominal) * float(width[:-1]) / 100 if width.endswith("%") else float(width))
    except ValueError:
        expected = "write NAME=VALUE+-HALF_WIDTH, like delta=0.005+-0.001 or gamma=0.64+-1%"
        raise place.error(f"{shown(word)} is not a tolerance; {expected}") from None
