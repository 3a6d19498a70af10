"""A bifurcation diagram: the blow at each of the last returns, from two starts."""

import vibrojax as vj

sweep = {
    "scene": "vibro-impact",
    "title": "Impact velocity at each return, from two starts",
    "starts": ["drive", "stuck"],
    "parameters": {"beta": 0.4, "delta": 0.005},
    "grid": {"gamma": {"start": 0.3, "stop": 1.2, "num": 181}},
    "run": {"keep_returns": 24},
}
vj.save_picture(vj.run_sweep(sweep, progress=False), "returns_from_two_starts.png")
