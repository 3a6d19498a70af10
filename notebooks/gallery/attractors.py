"""The attractors along the frequency ratio, and the share of 24 starts that leads to each."""

import vibrojax as vj

box = {"x1": [-0.02, 0.02], "v1": [-2.0, 1.0], "x2": [-0.05, 0.05], "v2": [-3.0, 3.0]}
sweep = {
    "scene": "vibro-impact",
    "title": "Attractors over the frequency ratio",
    "starts": {"sample": "sobol", "count": 24, "box": box},
    "parameters": {"beta": 0.4, "delta": 0.005},
    "grid": {"gamma": {"start": 0.3, "stop": 0.85, "num": 23}},
}
attractors = vj.attractors(vj.run_sweep(sweep, progress=False), progress=False)
vj.save_picture(attractors, "attractors.png")
