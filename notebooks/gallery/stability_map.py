"""How stable the orbits of a map are: the largest multiplier, and the distance from a graze."""

import vibrojax as vj

sweep = {
    "scene": "vibro-impact",
    "starts": ["stuck"],
    "grid": {"beta": {"start": 0.2, "stop": 0.7, "num": 31}, "gamma": {"start": 0.4, "stop": 1.0, "num": 31}},
    "run": {"orbits": True},
}
ds = vj.run_sweep(sweep, progress=False)
largest = ds.assign(multiplier_abs=ds.multiplier_abs.isel(multiplier=0, drop=True))
vj.save_picture(largest, "stability_map.png", variable=["multiplier_abs", "grazing_margin"])
