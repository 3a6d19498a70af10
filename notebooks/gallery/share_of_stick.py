"""Shares of stick and backward slip over drive speed and frequency ratio."""

import vibrojax as vj

sweep = {
    "scene": "vibro-impact",
    "title": "Stick, and slip backwards",
    "starts": ["stuck"],
    "grid": {
        "v": {"start": 0.25, "stop": 2.5, "num": 31},
        "gamma": {"start": 0.4, "stop": 1.2, "num": 31},
    },
}
ds = vj.run_sweep(sweep, progress=False)
vj.save_picture(ds, "share_of_stick.png", variable=["stick_fraction", "reverse_fraction"])
