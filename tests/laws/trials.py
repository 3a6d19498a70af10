"""Trials of the fit on logs with planted laws. Each has two formations with their own C and D. The noise is 3 % of the
mean rate, with a correlation of 0.7 between neighbouring rows, and 3 % of the rows are outliers."""

import sys
from contextlib import contextmanager
from pathlib import Path

import jaxtyping
import numpy as np

from vibrojax.studies.rop_forms import BLOCK_LIMIT, supported
from vibrojax.studies.rop_group import NAMES, fit_lanes

sys.path.insert(0, str(Path(__file__).parents[2] / "notebooks"))
import rig_logs


@contextmanager
def unchecked():
    """Skip run-time type checks, which take longer than the fits of many data sets. Single fits are checked."""
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        yield
    finally:
        jaxtyping.config.update("jaxtyping_disable", False)


FORMATIONS = (15 / 3600, 40e3), (8 / 3600, 60e3)  # C [m/s], D [N]
FOUNDER, ETA0, EXPONENT = 160e3, 0.75, 2.0


def rows(rng, C, D, law="literal", founder=FOUNDER, fall=1.0, count=400, noise=0.03, rho=0.7, outliers=0.03):
    """Return the weights [N] and rates [m/s] of a formation; above the founder, the rate falls by `fall` (W/F - 1)."""
    weight = rig_logs.weights((count,), rng, 70e3, 200e3)
    end = founder or np.inf
    rate = rig_logs.LAWS[law](np.minimum(weight, end) / D, C, ETA0, EXPONENT)
    rate = rate * (1 - fall * np.maximum(weight / end - 1, 0.0))
    rate = rate + noise * abs(rate).mean() * rig_logs.correlated((count,), rho, rng)
    wrong = rng.permutation(count)[: round(outliers * count)]
    rate[wrong] *= rng.choice([0.1, 0.3, 2.0, 3.0, 5.0], wrong.size)
    return weight, np.maximum(rate, 0.0)


def trial(rng, law="literal", founder=FOUNDER, unknown=False, **about):
    """Return the verdict on both formations, and for each whether C and the founder weight are told right."""
    standing, evidence, of_c, of_founder = [], [], [], []
    name = "onset" if unknown and law == "literal" else law
    for C, D in FORMATIONS:
        weight, rate = rows(rng, C, D, law, founder, **about)
        relief = weight / (np.median(weight) if unknown else D)
        fit = fit_lanes(relief, weight, rate, unknown=unknown)
        standing.append(fit.forms["standing"])
        evidence.append(fit.forms["evidence_against"])
        form = fit.forms.loc[name]
        of_c.append(abs(form["C"] - C) <= 2 * form["C_stderr"])
        of_founder.append(fit.founder.is_known == (founder is not None))
    return supported(np.array(standing), np.array(evidence), NAMES, BLOCK_LIMIT), of_c, of_founder


def trials(count, seed=1, **planted):
    """Return shares: right verdict, wrong verdict, C right, verdict and C right, founder right (found, or none)."""
    law = planted.get("law", "literal")
    law = "onset" if planted.get("unknown") and law == "literal" else law
    rng = np.random.default_rng(seed)
    with unchecked():
        results = [trial(rng, **planted) for _ in range(count)]
    verdicts, of_c, of_founder = (np.array(part) for part in zip(*results, strict=True))
    right = verdicts == law
    wrong = ~right & (verdicts != "none")
    return tuple(float(x.mean()) for x in (right, wrong, of_c, right[:, None] & of_c, of_founder))


CASES = {
    "literal, falls": {},
    "literal, does not rise": {"fall": 0.0},
    "literal, no founder": {"founder": None},
    "D unknown, falls": {"unknown": True},
    "D unknown, does not rise": {"unknown": True, "fall": 0.0},
    "D unknown, no founder": {"unknown": True, "founder": None},
    "onset, falls": {"law": "onset"},
    "onset, no founder": {"law": "onset", "founder": None},
    "line, falls": {"law": "line"},
    "line, no founder": {"law": "line", "founder": None},
    "power, falls": {"law": "power"},
    "power, no founder": {"law": "power", "founder": None},
    "constant": {"law": "constant", "founder": None},
    "literal, no outliers": {"outliers": 0.0},
    "literal, independent noise": {"rho": 0.0},
}
