"""A family with its doublings, and its multipliers in the unit circle."""

import vibrojax as vj

family = vj.follow("vibro-impact", along="gamma", at=0.45, span=(0.34, 0.5), beta=0.4, progress=False)
vj.save_picture(family, "multipliers.png")
