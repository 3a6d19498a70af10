"""Test basin shares against bSTAB's friction oscillator (Stender and Hoffmann, Nonlinear Dynamics 2021)."""

import numpy as np
from systems import BELT_OSCILLATOR

import vibrojax as vj

# Belt speed: published share of starts that end in steady sliding, and number of these starts. The source is the
# paper's MATLAB program or, for speeds that it lacks, the test file of its successor.
SHARES = {1.25: (0.0838, 5000), 1.5: (0.3165, 4000), 1.775: (0.5552, 5000)}
STARTS = {"sample": "sobol", "count": 512, "seed": 1, "box": {"x": [-2.0, 2.0], "v": [0.0, 2.0]}}
RUN = {"settle": 400.0, "observe": 60.0}


def sliding(speeds, count=512):
    """Return the share of starts that end in steady sliding, by speed."""
    tables = {"scene": BELT_OSCILLATOR, "starts": STARTS | {"count": count}, "grid": {"belt": speeds}, "run": RUN}
    return (vj.run_sweep(tables, progress=False).x_amplitude < 0.2).mean("start").values


def test_shares_match_published_values():
    ours = sliding(list(SHARES))
    share, starts = (np.array(column) for column in zip(*SHARES.values(), strict=True))
    error = np.sqrt(share * (1 - share) / starts + ours * (1 - ours) / STARTS["count"])
    deviation = (ours - share) / error
    assert np.abs(deviation).max() < 2 and abs(deviation.mean()) < 1


def test_no_start_slides_on_slow_belt_and_all_slide_on_fast_belt():
    assert sliding([1.0, 1.9], 64).tolist() == [0, 1]
