"""From data sheets to parameters."""

from __future__ import annotations

import math

import pytest

from mfpcc_experiments import cli, datasheet
from mfpcc_experiments.datasheet import Sheet, SheetError, convert, quantity
from pmsm_sim import motor as plant_motor
from pwm_node import yaml_files

# A star-connected machine whose parameters are known: psi_f 0.1 V s, 4 pole pairs.
_PSI, _N_P = 0.1, 4
_KE_LL_PEAK = math.sqrt(3.0) * _N_P * _PSI


def _sheet(**changes):
    values = {
        "poles": 2 * _N_P,
        "resistance": 3.0,
        "inductance": 17e-3,
        "inertia": 3e-3,
        "voltage": 311.0,
        "torque": 3.0,
        "ke": _KE_LL_PEAK,
        "ke_voltage": "ll-peak",
        **changes,
    }
    return Sheet(**values)


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("1.2ohm", "resistance", 1.2),
        ("1.2 Ω", "resistance", 1.2),
        ("0.56 mH", "inductance", 0.56e-3),
        ("92.5 gcm2", "inertia", 92.5e-7),
        ("1.8 kg cm²", "inertia", 1.8e-4),
        ("25.5 mNm/A", "kt", 25.5e-3),
        ("374 rpm/V", "kv", 374 * math.pi / 30),
        ("51 V/krpm", "ke", 51e-3 / (math.pi / 30)),
    ],
)
def test_quantities(text, kind, value):
    assert quantity(kind, text) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1.2", "has no unit"),
        ("1.2 mOh", "did you mean 'mohm'"),
        ("ohm", "a number with its unit"),
        ("-1 ohm", "above 0"),
        ("1.2.3 ohm", "no number"),
    ],
)
def test_bad_quantities(text, said):
    with pytest.raises(SheetError, match=said):
        quantity("resistance", text)


@pytest.mark.parametrize(
    "constant",
    [
        {},
        {"ke": _KE_LL_PEAK / math.sqrt(2.0), "ke_voltage": "ll-rms"},
        {"ke": _N_P * _PSI, "ke_voltage": "phase-peak"},
        {"ke": _N_P * _PSI / math.sqrt(2.0), "ke_voltage": "phase-rms"},
        {"ke": None, "kt": 1.5 * _N_P * _PSI, "kt_current": "peak"},
        {"ke": None, "kt": 1.5 * _N_P * _PSI * math.sqrt(2.0), "kt_current": "rms"},
        {"ke": None, "kt": _KE_LL_PEAK, "kt_current": "dc"},
        {"ke": None, "kv": 1.0 / _KE_LL_PEAK},
    ],
)
def test_all_conventions_give_the_same_machine(constant):
    motor = convert(_sheet(**constant))
    assert motor.values["psi_f"] == pytest.approx(_PSI, rel=1e-12)
    assert motor.values["R_s"] == 1.5 and motor.values["L_d"] == 8.5e-3
    assert motor.values["n_p"] == 4
    # rated torque over 1.5 n_p psi_f
    assert motor.values["i_max"] == pytest.approx(2.0 * 3.0 / 0.6)
    assert not motor.contradictions


def test_per_phase_and_salient():
    values = convert(_sheet(per_phase=True, inductance_q=30e-3)).values
    assert (values["R_s"], values["L_d"], values["L_q"]) == (3.0, 17e-3, 30e-3)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"kt": 1.5 * _N_P * _PSI, "kt_current": "rms"}, "kE and kT .* rms and peak"),
        ({"kv": 1.0 / (_N_P * _PSI)}, "kE and kV .* line-to-line and phase"),
        ({"current": 10.0, "kt_current": "peak"}, "rated torque and current"),
        ({"no_load_speed": 9000.0}, "no-load speed"),
        ({"speed": 9000.0}, "cannot be reached"),
    ],
)
def test_contradictions_are_told(changes, said):
    import re

    found = convert(_sheet(**changes)).contradictions
    assert any(re.search(said, sentence) for sentence in found), found


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"poles": 7}, "even number"),
        ({"ke": None}, "one of kT, kE, kV"),
        ({"torque": None}, "rated current nor rated torque"),
        ({"kt_current": "rsm"}, "did you mean 'rms'"),
    ],
)
def test_what_is_missing_is_told(changes, said):
    with pytest.raises(SheetError, match=said):
        convert(_sheet(**changes))


_ARGUMENTS = [
    "motor",
    "--name",
    "ec45",
    "--poles",
    "16",
    "-R",
    "1.2ohm",
    "-L",
    "0.56mH",
    "--kt",
    "25.5mNm/A",
    "--kt-current",
    "dc",
    "--kv",
    "374rpm/V",
    "-J",
    "92.5gcm2",
    "--torque",
    "55.5mNm",
    "--current",
    "2.03A",
    "--speed",
    "2940rpm",
    "--voltage",
    "12V",
]


def test_the_command_writes_a_file_that_the_plant_reads(tmp_path, capsys):
    path = tmp_path / "ec45.yaml"
    assert cli.run([*_ARGUMENTS, "-o", str(path)]) == 0
    assert "line-to-line / 2" in capsys.readouterr().out
    motor = plant_motor.load(str(path))
    assert motor.R_s == 0.6 and motor.n_p == 8
    assert cli.run([*_ARGUMENTS, "-o", str(path)]) == 1
    assert "--force" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["ec45.yaml"]


def test_the_command_tells_contradictions(capsys):
    assert cli.run([*_ARGUMENTS, "--ke", "9V/krpm"]) == 1
    assert "contradicts itself: kE and kT" in capsys.readouterr().err


def test_all_motors_there_are(capsys):
    names = yaml_files.available("motors")
    assert len(names) >= 8
    for name in names:
        assert plant_motor.load(name).name == name
    assert datasheet.TOLERANCE < 0.1
