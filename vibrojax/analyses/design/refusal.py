"""The line that says why a design has no result: which requirement cannot be met, and how near the search came."""

from collections.abc import Sequence

import numpy as np

from vibrojax.analyses.design.dataset import held
from vibrojax.analyses.design.evaluation import Assessment, Unit, extreme
from vibrojax.analyses.design.mapping import CoarseMap
from vibrojax.analyses.design.search import Candidate
from vibrojax.analyses.design.spec import Constraint, DesignSpec
from vibrojax.errors import InputError, counted
from vibrojax.measures.labels import REGIMES


def infeasibility(spec: DesignSpec, coarse: CoarseMap, candidates: Sequence[Candidate]) -> InputError:
    """Return the error for a design without a feasible point."""
    pairs = [(c.point, c.result) for c in candidates]
    pairs += list(zip(coarse.unit, coarse.assessments, strict=True)) if not spec.tolerances else []
    point, nearest = min(pairs, key=lambda pair: pair[1].badness)
    where, place, fit = _place_text(spec, point), spec.place.at("subject"), nearest.lanes.in_regime
    whole = " within the tolerances" if spec.tolerances else ""
    lanes = f"nearest: {fit.sum()} of {counted(fit.size, 'lane')} {where}{_regimes_text(nearest)}"
    violated = _violated(nearest) if fit.any() else []
    if spec.share is not None:
        share = float(nearest.good.mean(axis=1).min())
        ends = f"least {spec.share[0]:g}, most {spec.share[1]:g}"
        there = "".join(f"; there {_limit_text(spec, nearest, j)}" for j in violated[:1])
        return place.at("share").error(f"{ends} cannot be met{whole}; nearest: {share:.3g} {where}{there}")
    if not violated:
        what = f"{spec.regime} from every start" if spec.regime else f"a value of {spec.maximise} from every start"
        if any(a.feasible for a in coarse.assessments):
            return spec.place.at("tolerance").error(f"{what} cannot be held within the tolerances; {lanes}")
        return place.at("regime" if spec.regime else spec.maximise).error(f"{what} cannot be reached{whole}; {lanes}")
    limit = spec.constraints[violated[0]]
    value = extreme(held(nearest, limit.variable), limit.end)
    alone = [extreme(held(a, limit.variable), limit.end) for a in coarse.assessments if a.lanes.in_regime.all()]
    reached = extreme(np.array(alone), "most" if limit.end == "least" else "least")
    obstacles = ["the tolerances"] * bool(spec.tolerances) + ["the other limits"] * (len(spec.constraints) > 1)
    free = f"; without {' and '.join(obstacles)}, the map reaches {_amount(spec, limit, reached)}"
    others = " with the other limits" if len(spec.constraints) > 1 else ""
    return place.at(limit.variable).error(
        f"{limit.end} {_amount(spec, limit, limit.limit)} cannot be met{whole}{others}; "
        f"nearest: {_amount(spec, limit, value)} {where}" + (free if obstacles and np.isfinite(reached) else "")
    )


def check_objective(spec: DesignSpec, coarse: CoarseMap, feasible: Sequence[Candidate]) -> None:
    """Raise `InputError` if the objective is 0 at every feasible point, as where no blow breaks the rock."""
    if any(a.objective for a in [*(c.result for c in feasible), *(a for a in coarse.assessments if a.feasible)]):
        return
    pairs = [pair for pair in zip(coarse.unit, coarse.assessments, strict=True) if pair[1].objective > 0]
    hint = "; it is 0 on the whole map"
    if pairs:
        point, nearest = min(pairs, key=lambda pair: pair[1].badness)
        limits = ", ".join(_limit_text(spec, nearest, j) for j in _violated(nearest)) or "from other starts"
        amount = f"{nearest.objective:.3g} {spec.variables[spec.maximise].units}"
        hint = f"; nearest above 0: {amount} {_place_text(spec, point)}, {limits}"
    raise spec.place.at("maximise").error(f"{spec.maximise} is 0 wherever the requirements hold{hint}")


def _violated(assessment: Assessment) -> list[int]:
    """Return the constraints that are violated, by index, the worst first."""
    slack = assessment.slack.min(axis=1)
    return [int(j) for j in np.argsort(slack) if slack[j] < 0]


def _limit_text(spec: DesignSpec, assessment: Assessment, index: int) -> str:
    limit = spec.constraints[index]
    value = extreme(held(assessment, limit.variable), limit.end)
    return f"{limit.variable} is {_amount(spec, limit, value)}, {limit.end} {_amount(spec, limit, limit.limit)}"


def _amount(spec: DesignSpec, limit: Constraint, value: float) -> str:
    unit = spec.variables[limit.variable].units
    return f"{value:.6g}" if unit == "1" else f"{value:.6g} {unit}"


def _place_text(spec: DesignSpec, point: Unit) -> str:
    columns = spec.columns(point[None], np.zeros((1, len(spec.tolerances))))
    return "at " + ", ".join(f"{name} = {x[0]:.4g}" for name, x in columns.items())


def _regimes_text(assessment: Assessment) -> str:
    """Return the regimes of the lanes that are not in the regime asked for, like " (irregular)"."""
    if "regime" not in assessment.lanes.dataset:
        return ""
    others = np.unique(assessment.lanes.dataset["regime"].values[~assessment.lanes.in_regime])
    return f" ({', '.join(REGIMES[k] for k in others)})" if others.size else ""
