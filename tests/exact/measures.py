"""Measures and regime of a motion, written from the contract: one function for the drill, one for the rock."""

import math

import numpy as np

from exact.motion import Motion, Piece
from exact.polynomials import DERIVATIVE, N, falls, value

MOST_CYCLES = 8


def instants(motion: Motion, piece: Piece, row: np.ndarray) -> list[float]:
    """Return the times in the piece at which a linear form falls through zero."""
    return _times(piece, piece.c @ row, np.abs(row) @ motion.swing)


def _times(piece, c, size):
    roots = (x for x in falls(c, min(piece.x(piece.end), 1.0), size) if x > piece.x(piece.begin))
    return [piece.origin + piece.h * (1 + x) / 2 for x in roots]


def extremes(motion: Motion, piece: Piece, row: np.ndarray) -> tuple[float, float]:
    """Return the smallest and the largest value of a linear form in the piece."""
    c, size = piece.c @ row, N**2 * (np.abs(row) @ motion.swing)
    turns = _times(piece, DERIVATIVE @ c, size) + _times(piece, -DERIVATIVE @ c, size)
    values = [value(c, piece.x(t)) for t in (piece.begin, piece.end, *turns)]
    return min(values), max(values)


def swing(motion: Motion, row) -> tuple[float, float]:
    ends = np.array([extremes(motion, piece, row) for piece in motion.pieces])
    return ends[:, 0].min(), ends[:, 1].max()


def total(motion: Motion, begin, end, function):
    """Return the integral of function(piece, t, states) from begin to end."""
    parts = (piece.between(begin, end) for piece in motion.pieces)
    return sum(part.integral(lambda t, Y, part=part: function(part, t, Y)) for part in parts if part)


def sections(motion: Motion) -> list[float]:
    """Return the times at which x1' rises through zero after it was below -0.05 v since the last return."""
    row, p = motion.scene.row, motion.scene.p
    below = row["v1"] + 0.05 * p.v * row["one"]
    returns, armed = [], False
    for piece in motion.pieces:
        armed = armed or value(piece.c @ below, piece.x(piece.begin)) < 0
        crossings = [(t, False) for t in instants(motion, piece, below)]
        crossings += [(t, True) for t in instants(motion, piece, -row["v1"])]
        for t, rises in sorted(crossings):
            if rises and armed:
                returns.append(t)
            armed = not rises
    return returns


def repeats(motion: Motion, returns, amplitudes) -> int:
    """Return the number of returns after which the motion repeats, 1 to 8, or 0."""
    if len(returns) < 2:
        return 0
    period = (returns[-1] - returns[0]) / (len(returns) - 1)
    s = motion.at(returns)[:, [0, 2, 3]]
    s = s / [amplitudes[0], amplitudes[1], amplitudes[1] * 2 * math.pi / period]
    for p in range(1, MOST_CYCLES + 1):
        if len(returns) >= 3 * p + 1 and np.abs(s[p:] - s[:-p]).max() < 1e-3:
            return p
    return 0


def measure(motion: Motion) -> dict[str, float]:
    """Return all measures of the contract that apply to the scene, except settling time and error estimate."""
    return of_drill(motion) if motion.scene.drill else of_penetration(motion)


def of_drill(motion: Motion) -> dict[str, float]:
    scene, row = motion.scene, motion.scene.row
    amplitudes = {name: (high - low) / 2 for name in ("x1", "x2") for low, high in [swing(motion, row[name])]}
    measures = {"bit_amplitude": amplitudes["x1"], "striker_amplitude": amplitudes["x2"]}
    returns = sections(motion)
    cycles = repeats(motion, returns, (amplitudes["x1"], amplitudes["x2"]))
    window = returns[: 1 + (len(returns) - 1) // cycles * cycles] if cycles else returns
    measures["cycles"] = cycles
    if scene.contact:
        touching = [piece for piece in motion.pieces if piece.phase.striker == "touching"]
        pressed = (extremes(motion, piece, scene.press(piece.phase))[1] for piece in touching)
        measures["peak_impact_force"] = max(pressed, default=0.0)
    if len(window) >= 2:
        measures |= over_returns(motion, window, cycles)
    if scene.rock:
        measures["deepest_gap"] = swing(motion, row["e"])[0]
    return measures


def over_returns(motion: Motion, window, cycles) -> dict[str, float]:
    """Return means, shares, rates and counts over whole returns."""
    scene, row, p = motion.scene, motion.scene.row, motion.scene.p
    begin, end = window[0], window[-1]
    returns, time = len(window) - 1, end - begin

    def share(bit):
        parts = (piece.between(begin, end) for piece in motion.pieces if piece.phase.bit == bit)
        return sum(part.end - part.begin for part in parts if part) / time

    mean = lambda function: total(motion, begin, end, function) / time
    w = 2 * math.pi * returns / time
    tones = mean(lambda part, t, Y: Y[:, [0, 2]] * np.exp(-1j * w * (t[:, None] - begin)))
    turns = sum(begin < t <= end for piece in motion.pieces for t in instants(motion, piece, row["v2"]))
    measures = {
        "period": time / returns,
        "stick_fraction": share(0),
        "reverse_fraction": share(-1),
        "striker_turns": turns / returns,
        "phase_lag": float(np.angle(tones[0] / tones[1])),
        "drive_power": mean(lambda part, t, Y: scene.friction_force(part.phase, Y) * p.v),
    }
    if not scene.contact:
        return measures
    measures["mean_impact_force"] = mean(lambda part, t, Y: Y @ scene.J(part.phase))
    impacts = [event for event in motion.events if event.name == "strikes" and begin < event.time <= end]
    measures["impacts"] = len(impacts) * cycles / returns if cycles else len(impacts) / returns
    if impacts:
        speed = np.array([scene.rate(event.before) @ event.state for event in impacts])
        impact_times = np.array([event.time for event in impacts])
        next_return = np.searchsorted(window, impact_times, side="left")
        phase = 2 * math.pi * (impact_times - np.array(window)[next_return - 1]) / np.diff(window)[next_return - 1]
        measures |= {
            "impact_velocity": speed.mean(),
            "impact_velocity_min": speed.min(),
            "impact_velocity_max": speed.max(),
            "impact_energy": (p.m2 * speed**2 / 2).mean(),
            "bit_velocity_at_impact": np.mean([event.state[1] + p.v for event in impacts]),
            "impact_phase": phase.mean(),
        }
    if scene.rock:
        growth = np.diff(motion.at([begin, end]) @ row["x4"])[0]
        measures |= of_rock(growth, time, len(impacts), measures["mean_impact_force"], p)
    return measures


def of_rock(growth, time, impacts, mean_force, p) -> dict[str, float]:
    slip = growth / impacts if impacts else math.nan
    rate = {"rate_of_penetration": growth / time, "slip_per_impact": slip}
    return rate | {"mean_force": mean_force, "relief": mean_force / p.threshold}


def of_penetration(motion: Motion) -> dict[str, float]:
    """Return the measures over the whole pulses in the observation."""
    scene, row, p = motion.scene, motion.scene.row, motion.scene.p
    frequency = scene.pulses.frequency
    first, last = math.ceil(motion.observed * frequency - 1e-9), math.floor(motion.end * frequency + 1e-9)
    begin, end, pulses = first / frequency, last / frequency, last - first
    force = total(motion, begin, end, lambda part, t, Y: part.given(t) if part.given else 0 * t)
    growth = np.diff(motion.at([begin, end]) @ row["x4"])[0]
    measures = of_rock(growth, end - begin, pulses, force / (end - begin), p)
    return measures | {"deepest_gap": swing(motion, row["e"])[0]}
