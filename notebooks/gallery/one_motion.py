"""One point in time: history, phase planes and spectrum of bit and striker."""

import vibrojax as vj

motion = vj.simulate("vibro-impact", start="stuck", duration=20.0, beta=0.4, gamma=0.75, delta=0.005, progress=False)
vj.save_picture(motion, "one_motion.png")
