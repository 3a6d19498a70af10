"""The readings: how the source was read where it is misprinted or silent. R1 to R14 as in the model."""

READINGS = {
    "R1": "eq. 5.11 prints the stick force with the sign of the pull; read as against it, as the text says",
    "R2": "eq. 5.10 prints +Φ on the bit; read as friction that grows by μJ against the sliding: impact brakes",
    "R3": "tables give a gap of 0.005 m, Fig. 5.51 gives -0.005 m; read as -0.005 m, a preload of 5 mm",
    "R4": "v_cr is not in the text; 3 m/s, from program listing A3-1",
    "R5": "zero initial condition: x1 = x1' = x2 = x2' = 0, so the bit moves with the drive (start `drive`)",
    "R6": "attractors coexist: another start can end in another motion",
    "R7": "row w1 = 66 of Table 5.3 is a misprint: its own eqs. 5.16 and 5.17 give 77.5 and 77.1, not 79.6 and 78.5",
    "R8": "the listing's rate of penetration is slip times 2πf; true rate = slip times f. C in the listing's rate",
    "R9": "ROP = C ln(P/D) is negative for P/D < 1; read as C ln(eta/eta0) with eta0 fitted, beside a line",
    "R10": "pulse width 2 and 4 ms in the text; 4 ms where none is given",
    "R11": "Table 6.7's 470 kN: Table 6.6 does not give such a blow at drive speeds up to 2 m/s; trend only",
    "R12": "c1 in the appendix tables is c2",
    "R13": "with a preload, start `drive` begins inside the contact, which kicks the striker; `touching` does not",
    "R14": "a few cycles to settle: in the best region; elsewhere transients last minutes",
    "R15": "Figs 5.14 to 5.17 give no driving velocity: 1.5 m/s, and 0.5 and 3 m/s change nothing of it",
    "R16": "the source does not say what settled means: here all returns from then on repeat to 1 %",
    "R17": "Figs 5.41 to 5.50 and appendix 5-3: c2 = 75 N s/m and v = 0.5 m/s wherever gamma is over 1",
    "R18": "a lobe of a phase portrait: a place farthest from its centre, faster than 0.4 of the greatest velocity; "
    "the small ones by the abscissa are not counted, as the source says",
    "R19": "Fig. 5.67's caption says beta 0.4, its Table 5.5 beta 0.3: read as 0.4; the other stands in the remark",
    "R21": "a clean blow: one swing of the striker per cycle; a strong one: an impact velocity over that of the drive",
    "R22": "the swept sine's force, damping and threshold are not given: 60 kN +- 70 kN, zeta 0.3, D 150 kN, 20 Hz/s",
    "R23": "Table 6.2 and Fig. 6.15 give the stiffness at which slip begins as 0.01 MN/m, at which Fig. 6.14 has none",
    "R24": "Fig. 6.27 gives no damping: the lightest of zeta 0.5 to 1.1 that slips",
    "R25": "Table 6.6 gives no driving velocity and no gap: 1.5 m/s, -5 mm; D 50 kN, the lowest of its range",
    "R26": "how the drill is set to 11.6 and 13.9 Hz is not said: k1 times the square of the frequencies' ratio",
    "R27": "Table 6.7's blow: a half-sine of 470 kN as long as Table 6.6's contact lasts, on the bit alone",
    "R28": "misprints of 2.14 and 2.17 corrected, and 2.16's coefficients chosen, as in the model",
    "R20": "zero acceleration: under a tenth of the greatest in flight",
}
"""By name."""
