"""Regimes over mass ratio and frequency ratio, with a gap of 5 mm, from two starts."""

import vibrojax as vj

sweep = {
    "scene": "vibro-impact",
    "title": "Regimes over mass ratio and frequency ratio",
    "starts": ["drive", "stuck"],
    "parameters": {"delta": 0.005},
    "grid": {
        "beta": {"start": 0.1, "stop": 1.2, "num": 31},
        "gamma": {"start": 0.3, "stop": 1.2, "num": 31},
    },
}
vj.save_picture(vj.run_sweep(sweep, progress=False), "regime_map.png")
