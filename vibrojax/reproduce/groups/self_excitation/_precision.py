"""The readings that all parts rest on, and how well the source's frequencies can be read."""

USUAL = ("R4", "R5")
PERIOD_WITHIN = 0.008
PERIOD = "0.8 %: 1 ms of a period of some 0.25 s, as in Fig. 5.27, and a unit of the third digit, which is cut (R30)"
