"""Blows on granite: the force on the rock, the bit, and the steps of the hole."""

import vibrojax as vj

blows = vj.simulate("penetration", rock="granite", force=500e3, frequency=20, duration=0.2, progress=False)
vj.save_picture(blows, "steps_of_the_hole.png")
