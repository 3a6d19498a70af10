"""A swept sine on rock: amplitudes over its frequency, the resonance, and where the hole stops growing."""

import vibrojax as vj

sine = {"pulse_shape": "sweep", "force": 70e3, "bias": 60e3, "sweep_start": 20.0, "sweep_rate": 20.0}
motion = vj.simulate("penetration", zeta=0.3, duration=15.0, progress=False, **sine)
vj.save_picture(motion, "swept_sine.png")
