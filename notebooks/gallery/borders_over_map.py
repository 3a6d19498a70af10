"""Borders of the stable single impact, with the kind of each."""

import vibrojax as vj

sweep = {
    "scene": "vibro-impact",
    "title": "Where the stable single impact ends",
    "starts": ["drive", "stuck"],
    "parameters": {"delta": 0.005},
    "grid": {"beta": {"start": 0.1, "stop": 1.2, "num": 17}, "gamma": {"start": 0.3, "stop": 1.2, "num": 17}},
}
ds = vj.run_sweep(sweep, progress=False)
vj.save_picture(ds, "borders_over_map.png", over=vj.borders(ds, progress=False))
