"""A user-defined friction law: how fast may friction decrease with the sliding speed?"""

import vibrojax as vj

law = vj.FrictionLaw(
    name="falling",
    reference="my rig",
    parameters=vj.parameters.table(vj.parameters.positive("v_s", 1.8, "m s-1", "speed of the fall", "vₛ")),
    mu=lambda speed, p: 0.13 + 0.27 * vj.elementary.exp(-speed / p["v_s"]),
)
grid = {"v_s": {"start": 0.3, "stop": 4.0, "num": 38}, "gamma": {"start": 0.4, "stop": 1.0, "num": 31}}
sweep = {"scene": "vibro-impact", "title": "A user-defined friction law", "parameters": {"friction": law}, "grid": grid}
vj.save_picture(vj.run_sweep(sweep, progress=False), "own_friction_law.png")
