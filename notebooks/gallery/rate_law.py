"""Six forms of the rate-of-penetration law, fitted to the same lanes along the force."""

import vibrojax as vj

sweep = {
    "scene": "penetration",
    "title": "Three rocks along the force",
    "grid": {
        "rock": ["sandstone", "limestone", "granite"],
        "force": {"start": 100e3, "stop": 600e3, "num": 26},
    },
    "run": {"settle": 1.0, "observe": 1.0},
}
rates = vj.run_sweep(sweep, progress=False)
vj.save_picture(vj.fit_rop(rates, along="force", progress=False), "rate_law.png")
