"""The function `design`: map, search, verification, fronts; and the line that says why a design has no result."""

from collections.abc import Mapping, Sequence
from os import PathLike

import numpy as np
import xarray as xr

from vibrojax.errors import InputError, counted
from vibrojax.measures.labels import REGIMES
from vibrojax.progress import Progress
from vibrojax.studies.design_conditions import conditions, slopes_at
from vibrojax.studies.design_dataset import Result, design_dataset, held
from vibrojax.studies.design_evaluation import (
    Assessment,
    CoarseMap,
    Simulator,
    Unit,
    coarse_map,
    distinct_starts,
    extreme,
)
from vibrojax.studies.design_fronts import find_front
from vibrojax.studies.design_orbit_search import advance
from vibrojax.studies.design_robustness import box_samples, search_offsets, settle
from vibrojax.studies.design_search import SEEDS, Candidate, improve, seeds
from vibrojax.studies.design_spec import Constraint, DesignSpec, read_design

SAME_POINT = 0.01
"""Distance in the unit box within which two candidates count as one."""


def design(source: str | PathLike[str] | Mapping[str, object], *, progress: bool = True) -> xr.Dataset:
    """Find the values of varied parameters that maximise a variable, under constraints at samples of the tolerances.

        best = vj.design("design.toml")
        best.isel(candidate=0)

    A coarse map over the varied parameters, from every start, gives the points from which the search begins. The search
    uses derivatives at the periodic orbits; each of its points is simulated from every start, at the nominal values and
    at corners of the tolerance box. Finished candidates are simulated again at all corners and at 256 draws; those that
    fail are repaired, or left out. Worst values are those of these samples, no bounds of the tolerance box: where
    `irregular_share` is above 0, they depend on the time of observation as well.

    **Arguments:**

    - `source`: path of a TOML file, a bundled name such as "energy", or a dict with the same structure: `scene`,
      `maximise`, `vary`, and optionally `subject`, `tolerance`, `parameters`, `starts`, `run`, `front`, `title`.
    - `progress`: True to report progress on stderr.

    **Returns:** a dataset along `candidate`, best first:

    - the varied parameters; `objective` at the nominal point, worst over the starts; `objective_worst` of the samples
      of the tolerances; the variables of the subject, each at the nominal point and as `NAME_worst`; `feasible`.
    - `gradient` along `parameter`; along `limit`, for constraints and bounds: `slack`, `binds`, and `relaxation`, the
      gain of the objective per unit by which the limit is relaxed (Lagrange multiplier).
    - with a front: along `front`, `front_objective`, the varied parameters, and what the front is drawn against.
    - along `map`: the coarse map.

    **Raises:** `InputError` for an invalid design, if there is no feasible point, or if the objective is 0 at all of
    them: the message says which requirement cannot be met, and how near the search came.

    **Example:**

    >>> asked = {"scene": "vibro-impact", "maximise": "impact_velocity", "starts": ["stuck"]}
    >>> asked |= {"vary": {"gamma": [0.6, 0.9]}, "subject": {"regime": "single-impact"}}
    >>> best = vj.design(asked, progress=False).isel(candidate=0)
    >>> bool(best.feasible == 1), round(float(best.gamma), 2)
    (True, 0.6)
    """
    return find_design(read_design(source), progress)


def find_design(spec: DesignSpec, progress: bool = True) -> xr.Dataset:
    """Return the dataset of a checked design, see [vibrojax.studies.design_run.design][]."""
    simulator, samples = Simulator(spec), box_samples(spec)
    with Progress(3 + (spec.front is not None), "stages", progress, pace=False) as bar:
        coarse = coarse_map(simulator)
        count = sum(a.feasible for a in coarse.assessments)
        bar.add(1, f"map: {count} of {len(coarse.unit)} points feasible without tolerances")
        candidates = seeds(simulator, coarse, search_offsets(spec), spec.constraints, 2 * SEEDS)
        advance(simulator, candidates)
        # Over few parameters, borders of regimes cut off an orbit's optimum more often, and lanes are cheap.
        candidates = distinct(candidates)[: SEEDS + 2 * (len(spec.varied) <= 2)]
        improve(simulator, candidates)
        bar.add(1, f"search: {len(candidates)} candidates, {simulator.lanes} lanes so far")
        candidates = distinct(candidates)
        checked: list[Assessment] = []
        for candidate in candidates:
            if sum(assessment.feasible for assessment in checked) < SEEDS:
                checked.append(settle(simulator, candidate, samples))
        for c, assessment in zip(candidates, checked, strict=False):
            c.assessment = assessment
        verified = distinct(candidates[: len(checked)])
        feasible = [c for c in verified if c.result.feasible]
        if not feasible:
            raise infeasibility(spec, coarse, verified)
        check_objective(spec, coarse, feasible)
        bar.add(1, f"verification: {len(feasible)} of {len(verified)} candidates feasible")
        results = _concluded(simulator, feasible)
        front = find_front(simulator, coarse, [r.candidate for r in results]) if spec.front else []
        if spec.front:
            bar.add(1, f"front: {len(front)} points")
    return design_dataset(spec, simulator, coarse, results, front)


def distinct(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the candidates, best first, without those that ended at the same point as a better one."""
    kept: list[Candidate] = []
    for c in sorted(candidates, key=lambda c: c.result.rank):
        if all(np.abs(c.point - other.point).max() > SAME_POINT for other in kept):
            kept.append(c)
    return kept


def _concluded(simulator: Simulator, candidates: Sequence[Candidate]) -> list[Result]:
    """Return the results of verified candidates, with gradients and conditions at the nominal points."""
    spec = simulator.spec
    slopes = slopes_at(simulator, [c.point for c in candidates], [c.result for c in candidates])
    results = []
    for c, own in zip(candidates, slopes, strict=True):
        gradient = own[spec.maximise][distinct_starts(c.result)[0]] / (spec.high - spec.low)
        results.append(Result(c, conditions(spec, c.point, c.result, own), gradient))
    return results


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
