"""Speed against error of every method on this machine, the Pareto front drawn in."""

import vibrojax as vj

study = vj.run_accuracy(["vibro-impact"], quick=True, progress=False)
vj.save_picture(study, "speed_against_error.png")
