"""Runs of lanes with everything that their settings request: early stopping on orbits, orbits, exponents."""

from typing import Any

from vibrojax.compile.xla import workers
from vibrojax.lanes.compiler import XLA_BLOCK_ON_ACCELERATOR
from vibrojax.lanes.inputs import LaneInputs, LaneResult, Plan, Report, Stage, unreported
from vibrojax.lanes.run import LaneRun
from vibrojax.lanes.settled import StopRule
from vibrojax.periodic.natures import Natures
from vibrojax.periodic.orbit_stages import NearbyStage, OrbitStage
from vibrojax.periodic.settled_on_orbit import EarlyEnds
from vibrojax.scenes import Scene
from vibrojax.settings.run_settings import RunSettings
from vibrojax.stepping import Located

CHUNK, CHUNK_SHARING_ORBITS = 4096, 2048
"""Default number of lanes per chunk. In a run whose lanes stop on orbits of other lanes of the same chunk, results
depend on this number; the second one applies."""

EARLY_END_MIN_SECONDS = 5e6
"""Simulated seconds, summed over all lanes, below which compiling the return map takes longer than it saves.
Compilation takes 2 s of processor time. Early stopping saves 1.4 s per million simulated seconds over the parameter
region of the source. It saves only 0.4 s over the default map, where more lanes are irregular and most others settle
soon."""

SHARING_MIN_STARTS = 16
"""Smallest number of initial conditions per parameter point for which the lanes of a point share orbits."""

SHARING_MIN_SECONDS = 1.5e6
"""As `EARLY_END_MIN_SECONDS`, for shared orbits. There is no minimum for a sweep with `orbits`, which compiles the
return map anyway."""


def plan_of(scene: Scene[Any], run: RunSettings, lanes: int, starts_per_point: float = 1.0) -> Plan:
    """Return the plan of a run; `lanes`: number of its lanes."""
    plan = Plan(lanes, starts_per_point, 0)
    usual = CHUNK_SHARING_ORBITS if _ends_on_orbits(scene, run, plan) == "shared" else CHUNK
    accelerated = workers()[0] is not None
    return Plan(lanes, starts_per_point, run.chunk or max(usual, XLA_BLOCK_ON_ACCELERATOR if accelerated else 0))


def _ends_on_orbits(scene: Scene[Any], run: RunSettings, plan: Plan) -> str:
    """Return whether lanes may stop on their "own" orbit or on one "shared" with others, or "" for neither."""
    if not isinstance(run.stepper, Located) or scene.driving_part().section is None or run.carry is not None:
        return ""
    seconds = plan.lanes * (run.settle + run.observe)
    if plan.starts_per_point >= SHARING_MIN_STARTS:
        return "shared" if run.orbits or seconds >= SHARING_MIN_SECONDS else ""
    return "own" if seconds >= EARLY_END_MIN_SECONDS else ""


def stop_rule(inputs: LaneInputs, plan: Plan) -> StopRule | None:
    """Return the rule that ends lanes like `inputs` on their orbits, or None if this is impossible or saves no time."""
    ends = _ends_on_orbits(inputs.scene, inputs.run, plan)
    return EarlyEnds(inputs.scene, inputs.run, inputs.start_names, shared=ends == "shared") if ends else None


def lane_run(inputs: LaneInputs, plan: Plan) -> LaneRun:
    """Return a run of lanes like `inputs`, with the stop rule and the stages that their settings and the plan imply."""
    about = inputs.scene, inputs.run, inputs.start_names
    stages: list[Stage] = [OrbitStage(*about), NearbyStage(*about)] if inputs.run.orbits else []
    stages += [Natures(*about)] if inputs.run.lyapunov else []
    return LaneRun(inputs, plan, stop_rule(inputs, plan), stages)


def run_lanes(inputs: LaneInputs, plan: Plan | None = None, report: Report = unreported) -> LaneResult:
    """Run lanes and return their results; by default they are all the lanes of the run."""
    plan = plan or plan_of(inputs.scene, inputs.run, len(inputs))
    return lane_run(inputs, plan).all(inputs, report)
