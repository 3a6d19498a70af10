"""The lanes of the study: periodic motions of each scene that settle soon, so that errors mean something."""

from dataclasses import dataclass

DRILL = ("beta", "gamma", "v", "delta", "threshold", "start")


@dataclass(frozen=True)
class Lanes:
    """Points of a scene: `points`, columns of equal length by name; `settle` and `observe` [s]."""

    scene: str
    points: dict[str, list]
    settle: float
    observe: float

    @property
    def count(self) -> int:
        """How many there are."""
        return len(next(iter(self.points.values())))

    def sweep(self, method: str, precision: str, copies: int) -> dict:
        """The sweep of these lanes, over and over, `copies` times."""
        points = {name: column * copies for name, column in self.points.items()}
        times = {"settle": self.settle, "observe": self.observe, "end_early": False, "chunk": self.count * copies}
        return {"scene": self.scene, "points": points, "run": times | {"method": method, "precision": precision}}


_ROTARY = (
    (0.24, 0.41, 2.0, "stuck"),
    (0.32, 0.39, 0.6, "drive"),
    (0.44, 0.46, 1.7, "stuck"),
    (0.40, 0.79, 0.7, "stuck"),
    (0.42, 0.83, 1.3, "stuck"),
    (0.34, 0.85, 0.8, "stuck"),
    (0.53, 0.53, 1.6, "stuck"),
    (0.30, 0.80, 1.5, "stuck"),
    (0.35, 0.34, 0.5, "stuck"),
    (0.41, 0.63, 1.2, "stuck"),
    (0.44, 0.83, 1.5, "stuck"),
    (0.27, 0.44, 0.8, "drive"),
    (0.23, 0.55, 1.2, "stuck"),
    (0.38, 0.45, 0.6, "drive"),
    (0.45, 0.74, 1.0, "stuck"),
    (0.26, 0.60, 0.6, "drive"),
)
_VIBRO_IMPACT = (
    (0.56, 0.59, 0.5, 0.0, "stuck"),
    (0.57, 0.83, 1.3, -0.005, "stuck"),
    (0.21, 0.58, 1.1, 0.005, "stuck"),
    (0.25, 0.60, 1.4, 0.0, "stuck"),
    (0.30, 0.88, 0.9, -0.005, "drive"),
    (0.34, 0.80, 1.7, -0.005, "stuck"),
    (0.35, 0.51, 0.5, 0.0, "stuck"),
    (0.35, 0.73, 1.8, 0.005, "stuck"),
    (0.28, 0.60, 1.8, -0.005, "drive"),
    (0.28, 0.82, 1.8, 0.005, "stuck"),
    (0.44, 0.74, 0.7, -0.005, "drive"),
    (0.41, 0.87, 1.8, 0.005, "stuck"),
    (0.53, 0.70, 1.7, -0.005, "stuck"),
    (0.39, 0.74, 1.9, 0.0, "stuck"),
    (0.33, 0.72, 0.8, 0.005, "stuck"),
    (0.41, 0.75, 1.3, -0.005, "drive"),
)
_DRILLING = (
    (0.41, 0.77, 1.9, 0.005, 61900.0, "stuck"),
    (0.40, 0.52, 2.0, 0.0, 30000.0, "stuck"),
    (0.40, 0.78, 1.8, -0.005, 61900.0, "drive"),
    (0.42, 0.61, 1.5, -0.005, 61900.0, "drive"),
    (0.32, 0.55, 1.9, 0.005, 30000.0, "stuck"),
    (0.38, 0.75, 1.7, -0.005, 30000.0, "drive"),
    (0.31, 0.73, 1.4, -0.005, 30000.0, "drive"),
    (0.38, 0.71, 1.0, -0.005, 30000.0, "stuck"),
    (0.60, 0.83, 1.3, -0.005, 30000.0, "stuck"),
    (0.42, 0.70, 1.2, 0.005, 61900.0, "stuck"),
    (0.26, 0.67, 1.9, -0.005, 30000.0, "stuck"),
    (0.61, 0.89, 1.2, -0.005, 61900.0, "drive"),
    (0.29, 0.67, 1.5, -0.005, 30000.0, "drive"),
    (0.29, 0.62, 1.8, 0.005, 61900.0, "stuck"),
    (0.65, 0.87, 1.1, -0.005, 30000.0, "drive"),
    (0.33, 0.62, 1.6, -0.005, 61900.0, "stuck"),
)
_COUPLED = (
    (0.32, 0.54, 1.7, 0.0, 30000.0, "stuck"),
    (0.38, 0.72, 0.9, 0.0, 30000.0, "stuck"),
    (0.26, 0.59, 1.4, -0.005, 30000.0, "stuck"),
    (0.28, 0.55, 1.7, -0.005, 30000.0, "drive"),
    (0.35, 0.58, 1.5, 0.0, 30000.0, "stuck"),
    (0.38, 0.83, 1.3, 0.0, 30000.0, "stuck"),
    (0.43, 0.80, 1.3, -0.005, 30000.0, "drive"),
    (0.31, 0.83, 1.5, -0.005, 30000.0, "drive"),
    (0.57, 0.60, 1.4, 0.0, 30000.0, "stuck"),
    (0.46, 0.71, 1.6, -0.005, 30000.0, "stuck"),
    (0.43, 0.60, 1.1, 0.005, 30000.0, "stuck"),
    (0.33, 0.52, 1.6, -0.005, 30000.0, "stuck"),
    (0.36, 0.60, 1.9, 0.005, 30000.0, "stuck"),
    (0.40, 0.71, 1.7, -0.005, 30000.0, "stuck"),
    (0.30, 0.72, 1.6, 0.005, 30000.0, "stuck"),
    (0.32, 0.67, 1.3, 0.005, 30000.0, "stuck"),
)
_PENETRATION = tuple(
    (force, frequency, k3, zeta)
    for force, zeta in ((300e3, 1.1), (250e3, 0.6))
    for frequency in (10.0, 20.0, 30.0, 40.0)
    for k3 in (100e6, 300e6)
)

_ROWS = {
    "rotary": (("beta", "gamma", "v", "start"), _ROTARY),
    "vibro-impact": (("beta", "gamma", "v", "delta", "start"), _VIBRO_IMPACT),
    "penetration": (("force", "frequency", "k3", "zeta"), _PENETRATION),
    "drilling": (DRILL, _DRILLING),
    "coupled-drilling": (DRILL, _COUPLED),
}
SCENES = tuple(_ROWS)


def lanes_of(scene: str, quick: bool = False) -> Lanes:
    """The lanes of `scene`; fewer and shorter ones where it is to be `quick`."""
    names, rows = _ROWS[scene]
    rows = rows[:: len(rows) // 4] if quick else rows
    columns = {name: list(column) for name, column in zip(names, zip(*rows, strict=True), strict=True)}
    if scene == "penetration":
        return Lanes(scene, columns, 0.2 if quick else 0.5, 0.4 if quick else 0.5)
    return Lanes(scene, columns, 6.0 if quick else 8.0, 2.0 if quick else 4.0)
