"""The whole drill on sandstone: rate of penetration over mass ratio and frequency ratio."""

import vibrojax as vj

sweep = {
    "scene": "drilling",
    "title": "The drill on sandstone",
    "starts": ["stuck"],
    "parameters": {"rock": "sandstone"},
    "grid": {
        "beta": {"start": 0.2, "stop": 0.7, "num": 21},
        "gamma": {"start": 0.5, "stop": 0.9, "num": 21},
    },
}
vj.save_picture(vj.run_sweep(sweep, progress=False), "drill_on_rock.png")
