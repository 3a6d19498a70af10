"""The readings that all parts rest on, and how well the source's frequencies can be read."""

USUAL = ("R4", "R5")
PERIOD = "1 %: a period of some 0.2 s read to 1 ms, printed to three digits"
READ_OFF = "2 %: read off a spectrum with bins of some 0.1 Hz"
