"""Basins: where the striker starts decides how the drill moves."""

import vibrojax as vj

sweep = {
    "scene": "vibro-impact",
    "title": "Basins of two motions",
    "starts": {"plane": {"x2": {"start": -0.05, "stop": 0.05, "num": 60}, "v2": {"start": -3, "stop": 3, "num": 60}}},
    "parameters": {"beta": 0.4, "gamma": 0.75, "delta": 0.005},
}
vj.save_picture(vj.run_sweep(sweep, progress=False), "basins.png")
