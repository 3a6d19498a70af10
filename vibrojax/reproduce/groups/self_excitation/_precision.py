"""The readings that all parts rest on, and how well the source's frequencies can be read."""

USUAL = ("R4", "R5")
PERIOD_WITHIN = 0.006
PERIOD = "0.6 %: 1 ms of a period of some 0.25 s (Fig. 5.27 gives it to 1 ms), and half a unit of the third digit"
