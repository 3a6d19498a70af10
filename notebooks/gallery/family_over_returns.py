"""A family of orbits, stable and unstable, over the returns of a sweep."""

import vibrojax as vj

point = {"beta": 0.4, "delta": 0.005}
strong = vj.follow("vibro-impact", along="gamma", at=0.75, span=(0.5, 1.0), start="stuck", progress=False, **point)
sweep = {
    "scene": "vibro-impact",
    "title": "A family of orbits over the returns",
    "starts": ["drive", "stuck"],
    "parameters": point,
    "grid": {"gamma": {"start": 0.5, "stop": 1.0, "num": 61}},
    "run": {"keep_returns": 24},
}
vj.save_picture(vj.run_sweep(sweep, progress=False), "family_over_returns.png", over=strong)
