"""Plant faults in the package, one at a time, and run the tests that must find each. By hand, not in CI:

    python tests/planted_faults.py [WORD ...]      only faults whose names contain one of the words

A fault is one line of the source with an error that a person may well make: a sign, a law, an order of events, a unit,
a rule of a kernel, a check of stored results. The tests run in a copy of the repository, and none of them is marked
`long`. The script ends with the faults that were not found, of which there should be none.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]


class Fault(NamedTuple):
    name: str
    file: str  # in vibrojax/
    tests: str  # in tests/, with options of pytest
    right: str
    wrong: str


# Name | file in vibrojax/ | tests in tests/, and below it a part of a line (-) and what takes its place (+).
FAULTS = r"""
# signs and laws
friction drives the bit | scenes/rotary.py | scenes/test_fields.py -k test_field
- bit = (pull - slip * force)
+ bit = (pull + slip * force)
contact pulls the striker in | scenes/rotary.py | scenes/test_fields.py -k test_field
- on_striker = on_striker - impact
+ on_striker = on_striker + impact
Stribeck's cubic term | physics/friction.py | physics/test_physics.py
- ratio * ratio * ratio * (1 / 3)
+ ratio * ratio * (1 / 3)
restitution beyond critical damping | physics/contact.py | physics/test_physics.py
- - e / 3 + 2 * e**2 / 15
+ + e / 3 + 2 * e**2 / 15
contact damping is left out | physics/contact.py | physics/test_physics.py
- return k0 * compression + c0 * rate
+ return k0 * compression + 0 * c0 * rate
rock never yields | physics/rock.py | rock/test_rock.py
- + yielding * threshold
+ + yielding * compression * k3
# events
stick limit is half as large | scenes/rotary.py | test_exact.py -k 'test_simulate and vibro'
- sticks = (jnp.abs(pull) <= limit + noise)
+ sticks = (jnp.abs(pull) <= 0.5 * limit + noise)
a slip that starts goes the other way | scenes/rotary.py | test_exact.py -k 'test_simulate and vibro'
- starts = jnp.sign(jnp.where(pull == 0, pull_rate, pull))
+ starts = -jnp.sign(jnp.where(pull == 0, pull_rate, pull))
a rebound adds energy | systems/transitions.py | test_systems.py -k accumulating
- -(1.0 + bounce) * rate) / gain
+ -(1.0 + 1.1 * bounce) * rate) / gain
modes are kept after a jump | systems/transitions.py | test_systems_events.py -k 'block or resets_cross or hysteresis'
- new[index] = jnp.where(jumped & changed & ~hit[index], jnp.where(value < 0, -side, side), mode[index])
+ new[index] = mode[index]
a contact begins while the bodies part | scenes/vibro_impact.py | test_reference.py -k 'test_regimes or test_hard_cases'
- maximum(-compression, -length)
+ -length
# measures, labels and units
two impacts count as one | measures/labels.py | test_label.py
- ((cycles == 1) & (impacts == 1), SINGLE_IMPACT)
+ ((cycles == 1) & (impacts <= 2) & (impacts > 0), SINGLE_IMPACT)
impact energy without its half | measures/impacts.py | test_exact.py -k every
- scene.striker_mass(c) / 2 *
+ scene.striker_mass(c) *
impact phase in half turns | measures/impacts.py | test_exact.py -k every
- "impact_phase": 2 * jnp.pi *
+ "impact_phase": jnp.pi *
a foot is a yard | physics/units.py | laws/test_fit_input.py -k unit_factors
- foot = 0.3048 m
+ foot = 0.9144 m
# kernels
booleans compared as signed | compile/elementwise.py | kernels/test_kernel.py -k 'booleans or integers'
- how = of_integers if of_integers in
+ how = "s" + of_integers if of_integers not in ("eq", "ne") else of_integers if of_integers in
a scan from the end runs forward | compile/control.py | kernels/test_kernel.py -k 'loops'
- if equation.params["reverse"]:
+ if equation.params["reverse"] and not length:
a shift by the width | compile/elementwise.py | kernels/test_kernel.py -k integers
- return op.select(op.compare("ult", op.x[1], op.constant(bits)), shifted, beyond)
+ return shifted
a choice takes the other case | compile/elementwise.py | kernels/test_kernel.py
-     no, yes = cases
+     yes, no = cases
rows that do not exist are zero | compile/rows.py | kernels/test_kernel.py -k missing
-     return literal(value, dtype)
+     return literal(0, dtype)
# early ends
a slow approach counts as settled | lanes/settled.py | test_end_early.py -k settled
- & (changing <= tolerance)
+ & (newer <= tolerance)
every nearby lane reaches the orbit | periodic/settled_on_orbit.py | test_end_early.py -k predicted
- return reached & (contraction < MAX_CONTRACTION) &
+ return reached | (contraction < MAX_CONTRACTION) &
ends of transients never differ | lanes/certificate.py | test_certificate.py -k ends_of_transients
- differ[lanes] = ~(same | (np.isnan(times) & np.isnan(others)))
+ differ[lanes] = False
the check run counts as settled | lanes/certificate.py | test_certificate.py -k slow_lanes
- + DRIFT_MARGIN * coarse.get("drift_estimate", 0.0)
+ + 0.0
# orbits
a saltation is left out | stepping/polynomial.py | test_orbits.py -k test_reference_cases
- -moved / jnp.where(rate == 0, 1.0, rate))
+ 0.0 * moved / jnp.where(rate == 0, 1.0, rate))
a step to a twin of the orbit is taken | periodic/newton.py | test_as_jax.py -k pitchfork
- return np.asarray(smooth & ((off
+ return np.asarray(np.isfinite(change) | ((off
a guess beyond a pitchfork leads to the other twin | periodic/orbits.py | test_attractors.py -k pitchfork
- outside |= same_side & (
+ outside |= False & (
grazes are where branches stall | periodic/location.py | test_follow_rigid.py -k graze_is_the_same
- return limit if error <
+ return None if error <
# laws of the rate of penetration
the onset is a factor | studies/rop_forms.py | laws/test_fit.py laws/test_rig_law.py
- eta0 = np.exp(onset) if
+ eta0 = np.exp(-onset) if
a wrong rate at the greatest weight is its own neighbour | studies/rop_group.py | laws/test_rig_law.py -k wrong_rates
- mode="mirror")
+ mode="nearest")
# results and files
chunks of another sweep are taken | maps/store.py | test_store.py
- return f"{self._digest} {index}".encode()
+ return f"{index}".encode()
chunks are not in their places | maps/store.py | test_store.py
- if file.comment != self._owner(index):
+ if not file.comment:
every seal is believed | io/trust.py | test_sealed_datasets.py -k secret
- return secret is not None and hmac.compare_digest(
+ return secret is not None or hmac.compare_digest(
other results count as the same | io/identity.py | test_finished_results.py -k 'replaced or given_file or numbered'
- return stored is not None and not changes(stored, json.loads(identity_text(identity)))
+ return stored is not None
"""


def faults() -> list[Fault]:
    lines = [line for line in FAULTS.splitlines() if line and not line.startswith("#")]
    rows = zip(lines[::3], lines[1::3], lines[2::3], strict=True)
    return [Fault(*first.split(" | "), right[2:], wrong[2:]) for first, right, wrong in rows]


def is_found(fault: Fault, folder: Path) -> bool:
    """Return whether a test fails with the fault."""
    path = folder / "vibrojax" / fault.file
    text = path.read_text()
    if text.count(fault.right) != 1:
        raise SystemExit(f"{fault.name}: {fault.file} has this line {text.count(fault.right)} times: {fault.right}")
    path.write_text(text.replace(fault.right, fault.wrong))
    command = f"{sys.executable} -m pytest -x -q -p no:cacheprovider {fault.tests}"
    environment = os.environ | {"PYTHONPATH": str(folder), "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(
            command, shell=True, cwd=folder / "tests", env=environment, capture_output=True, text=True, check=False
        )
    finally:
        path.write_text(text)
    if done.returncode not in (0, 1):
        raise SystemExit(f"{fault.name}: {done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.returncode == 1


def main(*words: str) -> int:
    chosen = [fault for fault in faults() if not words or any(word in fault.name for word in words)]
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "copy"
        unneeded = shutil.ignore_patterns(".git", ".venv", "build", "__pycache__", ".*_cache")
        shutil.copytree(ROOT, folder, ignore=unneeded, symlinks=True)
        missed = []
        for fault in chosen:
            found = is_found(fault, folder)
            missed += [] if found else [fault.name]
            print(f"{'found ' if found else 'MISSED'}  {fault.name}: {fault.tests}", flush=True)
    print(f"{len(chosen) - len(missed)} of {len(chosen)} faults found", *missed, sep="\n")
    return bool(missed)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
