"""Classification of irregular motions by the greatest Lyapunov exponent."""

import vibrojax as vj

sweep = {
    "scene": "vibro-impact",
    "title": "Nature of irregular motions",
    "starts": ["drive"],
    "parameters": {"delta": 0.005},
    "grid": {"beta": {"start": 0.25, "stop": 0.6, "num": 19}, "gamma": {"start": 0.6, "stop": 0.8, "num": 19}},
    "run": {"lyapunov": True},
}
vj.save_picture(vj.run_sweep(sweep, progress=False), "natures.png", variable=["lyapunov", "nature"])
