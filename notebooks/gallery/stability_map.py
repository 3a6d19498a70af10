"""Stability of the orbits of a map: the largest multiplier, and the distance from grazing."""

import vibrojax as vj

sweep = {
    "scene": "vibro-impact",
    "title": "Stability and distance from grazing",
    "starts": ["stuck"],
    "grid": {"beta": {"start": 0.2, "stop": 0.7, "num": 31}, "gamma": {"start": 0.4, "stop": 1.0, "num": 31}},
    "run": {"orbits": True},
}
ds = vj.run_sweep(sweep, progress=False)
vj.save_picture(ds, "stability_map.png", variable=["multiplier_abs", "grazing_margin"])
