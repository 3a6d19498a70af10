"""Regimes over drive speed and gap, from two starts."""

import vibrojax as vj

sweep = {
    "scene": "vibro-impact",
    "title": "Regimes over drive speed and gap",
    "starts": ["drive", "stuck"],
    "parameters": {"beta": 0.4, "gamma": 0.75},
    "grid": {
        "v": {"start": 0.25, "stop": 2.5, "num": 37},
        "delta": {"start": -0.005, "stop": 0.02, "num": 26},
    },
}
vj.save_picture(vj.run_sweep(sweep, progress=False), "gap_and_speed.png")
