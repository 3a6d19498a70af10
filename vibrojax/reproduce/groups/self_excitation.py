"""Self-excitation without impact: chapter 5, section 4 (the scene *rotary*)."""

from vibrojax.reproduce._entry import Entry, number
from vibrojax.reproduce._group import Group
from vibrojax.reproduce._needs import lane
from vibrojax.reproduce.groups._table_5_3 import ROWS


def _row(index: int) -> Entry:
    row = ROWS[index - 1]
    need = lane("rotary", k1=250.0 * row.w1**2, v=row.v, beta=row.beta, gamma=row.gamma)
    return Entry(
        f"table-5.3.{index}",
        f"synchronisation frequency, w1 {row.w1}, v {row.v}, beta {row.beta}, gamma {row.gamma}",
        f"{row.simulation} rad/s",
        (need,),
        lambda one: number(one.angular_frequency, row.simulation, "rad/s", 0.01),
        "1 %: its period was read to 1 ms in some 0.2 s, and is printed to three digits",
        ("R4", "R5", *(("R7",) if index == 10 else ())),
    )


GROUP = Group(
    name="self-excitation",
    title="Self-excitation without impact",
    text="",
    entries=tuple(_row(index) for index in range(2, 12)),
)
