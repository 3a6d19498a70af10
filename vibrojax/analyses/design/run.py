"""The function `design`: map, search, verification, fronts, and the dataset of the result."""

from collections.abc import Mapping, Sequence
from os import PathLike

import numpy as np
import xarray as xr

from vibrojax.analyses.design.conditions import conditions
from vibrojax.analyses.design.dataset import Result, design_dataset
from vibrojax.analyses.design.evaluation import Assessment, Simulator, distinct_starts
from vibrojax.analyses.design.fronts import find_front
from vibrojax.analyses.design.mapping import SEEDS, coarse_map, seeds
from vibrojax.analyses.design.orbit_search import advance
from vibrojax.analyses.design.reading import read_design
from vibrojax.analyses.design.refusal import check_objective, infeasibility
from vibrojax.analyses.design.robustness import box_samples, search_offsets, settle
from vibrojax.analyses.design.search import Candidate, improve
from vibrojax.analyses.design.slopes import slopes_at
from vibrojax.analyses.design.spec import DesignSpec
from vibrojax.progress import Progress

SAME_POINT = 0.01
"""Distance in the unit box within which two candidates count as one."""


def design(source: str | PathLike[str] | Mapping[str, object], *, progress: bool = True) -> xr.Dataset:
    """Find the values of varied parameters that maximise a variable, under constraints held over the tolerances.

        best = vj.design("design.toml")
        best.isel(candidate=0)

    A coarse map over the varied parameters, from every start, gives the points from which the search begins. The search
    uses derivatives at the periodic orbits; each of its points is simulated from every start, at the nominal values and
    at corners of the tolerance box. Finished candidates are simulated again at all corners and at 256 draws; those that
    fail are repaired, or marked as not feasible.

    **Arguments:**

    - `source`: path of a TOML file, a bundled name such as "energy", or a dict with the same structure: `scene`,
      `maximise`, `vary`, and optionally `subject`, `tolerance`, `parameters`, `starts`, `run`, `front`, `title`.
    - `progress`: True to report progress on stderr.

    **Returns:** a dataset along `candidate`, best first:

    - the varied parameters; `objective` at the nominal point, worst over the starts; `objective_worst` over the
      tolerances; the variables of the subject, each at the nominal point and as `NAME_worst`; `feasible`.
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
    """Return the dataset of a checked design, see [vibrojax.analyses.design.run.design][]."""
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
