"""The drill's constants (defaults of the vibro-impact scene) and quantities derived from a lane's parameters."""

M1, K1, C2 = 250.0, 156250.0, 250.0  # kg, N/m, N s/m
MU, V_CR = 0.4, 3.0  # 1, m/s
K0, C0 = 50e6, 0.1  # N/m, N s/m
STICK_LIMIT = MU * M1 * 9.81  # N
ARMED_BELOW = 0.05  # relative to v: x1' must fall below -ARMED_BELOW v before its next rise through zero is a return


def striker(beta, gamma):
    """Return m2 [kg] and k2 [N/m]."""
    return beta * M1, beta * gamma * gamma * K1
