"""
How well `mfpcc identify` finds what is known: simulated recordings of six motors, many seeds.

Each motor runs with steps of speed and of i_d, 20 mA of noise on i_d and i_q (24.5 mA on each of
the three sensors, as everywhere in docs/method.md), an ideal encoder and inverter. Counted is, by
parameter, in how many of the recordings the truth lies in the stated interval, and how far off the
worst estimate is.

    python -m mfpcc_experiments.proofs.identification --seeds 100
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import click
import numpy as np

import pmsm_sim.motor
from mfpcc_experiments.identifying import delay as delays
from mfpcc_experiments.identifying.fit import fit
from mfpcc_experiments.identifying.steps import Steps, steps_of
from mfpcc_experiments.measuring.waveform import space_vector
from mfpcc_experiments.running.engine import Engine
from mfpcc_experiments.running.scenario import Scenario
from pmsm_sim.motor import MotorPars

MOTORS = (
    "seed_750",
    "textbook_spmsm",
    "ipmsm",
    "maxon_ecmax40_120w",
    "maxon_ec45flat_70w",
    "teknic_m2310p",
)
#: How far an estimate may be off.
LIMITS = {"R_s": 0.05, "L_d": 0.03, "L_q": 0.03, "psi_f": 0.01}
#: In how many of 100 recordings the truth has to be inside of the interval.
INSIDE = 0.9

# Shares of the largest speed and current, one after the other.
_STAGES = ((0.1, 0.3), (0.1, -0.3), (0.4, 0.2), (0.4, -0.3), (0.7, 0.0), (0.5, -0.2))
_STAGE = 0.05  # s


def scenario(motor: MotorPars, name: str) -> Scenario:
    """The run that a motor is identified from."""
    rated = 1.5 * motor.n_p * motor.psi_f * motor.i_max
    end = (len(_STAGES) + 1) * _STAGE
    return Scenario.model_validate(
        {
            "name": "identification",
            "motor": name,
            "speed_rpm": 0.1 * motor.speed_max_rpm,
            "duration": end,
            "window_s": [0.0, end],
            "plant": {"load_torque": 0.2 * rated, "noise.current_rms": 0.0245},
            "schedule": [
                {
                    "at": (k + 0.5) * _STAGE,
                    "speed_ref_rpm": speed * motor.speed_max_rpm,
                    "i_d_ref": current * motor.i_max,
                }
                for k, (speed, current) in enumerate(_STAGES)
            ],
        }
    )


def recorded(name: str, seed: int, **plant: object) -> tuple[Steps, MotorPars]:
    """Steps of a run of a motor, and what it is."""
    motor = pmsm_sim.motor.load(name)
    run = scenario(motor, name)
    values, controller = run.node_parameters("mbpcc", seed)
    traces = list(Engine({**values, **plant}, controller).run(run.periods))
    feedback = np.concatenate([trace.feedback for trace in traces])
    command = np.concatenate([trace.command for trace in traces])
    i_abc = np.stack([feedback[f"i_{leg}"] for leg in "abc"], axis=1)
    # The command of a period acts in the next one.
    u = space_vector(command["duty"][:-1]) * feedback["dc_voltage"][1:]
    u = np.where(command["enable"][:-1], u, np.nan)
    return (
        steps_of(
            space_vector(i_abc),
            motor.n_p * feedback["encoder_angle"] % (2.0 * np.pi),
            np.concatenate([[np.nan], u]),
            feedback["period"].astype(np.int64),
            1.0 / run.pwm_frequency,
        ),
        motor,
    )


@dataclass
class Score:
    """Of one parameter of one motor: recordings, how many with the truth inside, the worst."""

    recordings: int = 0
    inside: int = 0
    worst: float = 0.0


def judge(name: str, seeds: Sequence[int]) -> tuple[dict[str, Score], int]:
    """
    Identify recordings of a motor.

    Returns
    -------
    dict of Score
        By parameter.
    int
        In how many the delay was found, and was sure.
    """
    scores = {key: Score() for key in LIMITS}
    exact = 0
    for seed in seeds:
        steps, motor = recorded(name, seed)
        delay = delays.estimate(steps)
        exact += delay is not None and delay.sure and delay.periods == 0
        found = fit(steps)
        assert found is not None
        for key, score in scores.items():
            truth = float(getattr(motor, key))
            score.recordings += 1
            score.inside += found.low[key] <= truth <= found.high[key]
            score.worst = max(score.worst, abs(found.values[key] / truth - 1.0))
    return scores, exact


def lines(motors: Sequence[str], seeds: int) -> Iterator[tuple[str, bool]]:
    """A line for each motor, and whether all in it is as it should be."""
    for name in motors:
        scores, exact = judge(name, range(seeds))
        good = exact == seeds and all(
            score.worst <= LIMITS[key] and score.inside >= INSIDE * score.recordings
            for key, score in scores.items()
        )
        cells = [
            f"{key} {score.inside:3}/{score.recordings}, {100 * score.worst:.2f} %"
            for key, score in scores.items()
        ]
        yield f"{name:<20} {'; '.join(cells)}; delay {exact}/{seeds}", good


@click.command()
@click.option("--seeds", default=100, show_default=True, help="Recordings of each motor.")
@click.option("--motor", "motors", multiple=True, default=MOTORS, help="Motors.")
def main(seeds: int, motors: tuple[str, ...]) -> None:
    """Print, by motor and parameter, in how many recordings the truth is inside, and the worst."""
    bad = False
    for line, good in lines(motors, seeds):
        click.echo(line)
        bad |= not good
    sys.exit(int(bad))


if __name__ == "__main__":
    main()
