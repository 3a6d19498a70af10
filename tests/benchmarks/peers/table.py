"""The race as a table in Markdown."""

from peers.lanes import Judged
from peers.race import TARGETS, Result

COLUMNS = ("error", "", "µs per lane-s", "spread", "ratio", "best setting", "worst", "median", "lanes", "compile s")


def table(results: list[Result], judged: Judged, settle: float, observe: float, machine: dict, cores: int) -> str:
    """Return the whole text. Ratios are relative to the first result, which is ours."""
    about = ", ".join(f"{name} {value}" for name, value in machine.items() if name not in ("processor", "cores"))
    lines = [
        "# Time per simulated second of a lane, at the same error",
        "",
        f"{machine['processor']}, {cores} of {machine['cores']} cores used, {about}.",
        "",
        "Vibro-impact, beta 0.25–0.6, gamma 0.6–0.8, v 0.5–2, delta −0.005–0.01, from the start `stuck`; float64; "
        f"every lane stepped to its end, {settle:g} s and {observe:g} s observed. Errors are relative, of period and "
        f"impact velocity the larger, on the same {len(judged.period)} lanes for everyone: drawn from the box, "
        f"repeating after one return, and settled long before ({judged.settled:.0%} of the lanes drawn were); two "
        f"references differ by at most {judged.spread:.0e} on them. A peer's best setting is the fastest one whose "
        "worst lane is within the error. Times are of all lanes on all cores used, without compiling, the median of "
        "the repeats and half their range; ratios are to ours at the same error, whose time includes the certification "
        "(a second run) and the whole dataset. The peers do neither.",
        "",
        "| " + " | ".join(COLUMNS) + " |",
        "|" + "|".join("---" if name in ("", "best setting") else "---:" for name in COLUMNS) + "|",
    ]
    for target in TARGETS:
        ours = results[0].best(target)
        lines += [_row(result, target, ours.time if ours else None) for result in results]
    lines += ["", *(f"* {result.peer.name}: {result.peer.about}." for result in results), ""]
    return "\n".join(lines)


def _row(result: Result, target: float, ours: float | None) -> str:
    run = result.best(target)
    name = f"{target:.0e}"
    if run is None:
        return " | ".join([f"| {name}", result.peer.name, "–", "–", "–", _why_not(result), *["–"] * 3, "– |"])
    cells = [
        name,
        result.peer.name,
        f"{1e6 * run.time:.3g}",
        f"± {1e6 * run.spread:.2g}" if len(run.times) > 1 else "one run",
        f"{run.time / ours:.3g}" if ours else "–",
        str(run.setting) + (f" ({result.remark})" if result.remark else ""),
        f"{run.worst:.1e}",
        f"{run.median:.1e}",
        str(run.lanes),
        f"{result.compiling:.1f}",
    ]
    return "| " + " | ".join(cells) + " |"


def _why_not(result: Result) -> str:
    nearest = result.nearest()
    if nearest is None:
        return result.remark
    best = f"not reached: best {nearest.worst:.1e} at {1e6 * nearest.time:.3g} µs ({nearest.setting})"
    return f"{best}; {result.remark}" if result.remark else best
