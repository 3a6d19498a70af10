"""Impact velocity at each return: up and down the frequency ratio, each lane from where the last one ended."""

import vibrojax as vj

sweep = {
    "scene": "vibro-impact",
    "title": "Impact velocity at each return, up and down",
    "starts": ["stuck"],
    "parameters": {"beta": 0.4, "delta": 0.005},
    "grid": {"gamma": {"start": 0.5, "stop": 1.1, "num": 61}},
    "run": {"carry": "gamma", "keep_returns": 24},
}
vj.save_picture(vj.run_sweep(sweep, progress=False), "returns_both_ways.png")
