"""From data sheets to parameters."""

from __future__ import annotations

import math

import pytest
import yaml

from mfpcc_experiments import cli
from mfpcc_experiments.datasheet import Sheet, SheetError, conversion, convert, quantity, read
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


# 1 min-1 = 0.10471975512 rad/s; 1 oz in = 28.349523125 g x 9.80665 m/s2 x 25.4 mm = 7.0615518 mN m
@pytest.mark.parametrize(
    ("kind", "text", "value", "counted"),
    [
        # both code points of micro (U+00B5, U+03BC) and of ohm (U+03A9, U+2126)
        ("inductance", "70 \u00b5H", 70e-6, None),
        ("inductance", "70 \u03bcH", 70e-6, None),
        ("resistance", "73 m\u03a9", 0.073, None),
        ("resistance", "73 m\u2126", 0.073, None),
        ("resistance", "2.4 Ohms", 2.4, None),
        # Faulhaber
        ("resistance", "0,43 Ω", 0.43, None),
        ("ke", "1,02 mV/min⁻¹", 9.740282517e-3, None),
        ("ke", "1.02 mV/min-1", 9.740282517e-3, None),
        ("kv", "979 min-1/V", 102.5206403, None),
        ("speed", "22 900 min-1", 22900.0, None),
        # maxon
        ("inertia", "92.5 gcm²", 92.5e-7, None),
        ("speed", "2940 rpm", 2940.0, None),
        # Kollmorgen
        ("ke", "54.5 Vrms/kRPM", 0.5204366639, "rms"),
        ("ke", "77.1 Vpk/krpm", 0.7362507667, "peak"),
        ("ke", "54.5 V/1000 min-1", 0.5204366639, None),
        ("kt", "0.85 N-m/Arms", 0.85, "rms"),
        ("kt", "7.5 lb-in/Arms", 0.8473862177, "rms"),
        ("torque", "18.1 lb-in", 2.045025405, None),
        ("inertia", "0.00042 lb-in-s²", 4.745362819e-5, None),
        ("inertia", "0.81 kg-cm²", 0.81e-4, None),
        ("current", "4.87 Arms", 4.87, "rms"),
        # Nanotec
        ("torque", "180 oz-in", 1.271079327, None),
        ("kt", "12 oz-in/A", 0.08473862177, None),
        ("kt", "3.5 Ncm/A", 0.035, None),
        ("inertia", "0.004 oz-in-s^2", 2.824620726e-5, None),
        ("inertia", "0.5 oz-in²", 9.14498917e-6, None),
        # T-Motor
        ("kv", "400 KV", 41.88790205, None),
        ("kv", "KV400", 41.88790205, None),
        ("resistance", "73 mOhm", 0.073, None),
        # Yaskawa, Panasonic
        ("inertia", "0.263×10⁻⁴ kg·m²", 0.263e-4, None),
        ("inertia", "0.263 x 10^-4 kg m^2", 0.263e-4, None),
        ("ke", "5 mV/(r/min)", 0.04774648293, None),
        ("ke", "0.1 V·s/rad", 0.1, None),
        ("ke", "100 mV/(rad/s)", 0.1, None),
        ("torque", "1 kgf·cm", 0.0980665, None),
        ("voltage", "24 VDC", 24.0, "dc"),
        ("speed", "12,345.6 rpm", 12345.6, None),
        ("speed", "314.159265 rad/s", 3000.0, None),
    ],
)
def test_data_sheets_write_their_units_so(kind, text, value, counted):
    found = read(kind, text)
    assert found.value == pytest.approx(value, rel=2e-9)
    assert found.counted == counted


def test_an_ambiguous_comma_is_asked_about():
    with pytest.raises(SheetError, match=r"thousands or decimals\? 2\.940 or 2940"):
        quantity("speed", "2,940 rpm")
    assert quantity("inductance", "0,056 mH") == pytest.approx(56e-6)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1.2", "has no unit"),
        ("1.2 mOh", "did you mean 'mohm'"),
        ("ohm", "a number with its unit"),
        ("-1 ohm", "above 0"),
        ("1.2.3 ohm", "no number"),
        ("1 2 ohm", "a number with its unit"),
        ("1.2 MΩ", "did you mean 'mohm'"),  # not a thousandth of what stands there
        ("1.2 V", "unknown unit 'V'"),
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


def test_of_a_delta_a_phase_lies_between_two_terminals():
    """Terminals of a delta of 3 ohm see 3 parallel to 6 = 2 ohm; a star of 1 ohm each does, too."""
    delta = {"winding": "delta", "ke": _KE_LL_PEAK, "ke_voltage": "phase-peak"}
    of_a_phase = convert(_sheet(per_phase=True, **delta)).values
    assert of_a_phase["R_s"] == pytest.approx(1.0)
    assert of_a_phase["L_d"] == pytest.approx(17e-3 / 3.0)
    assert of_a_phase["psi_f"] == pytest.approx(_PSI)
    between_terminals = convert(_sheet(resistance=2.0, winding="delta")).values
    assert between_terminals["R_s"] == pytest.approx(1.0)
    assert between_terminals["psi_f"] == pytest.approx(_PSI)


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
        ({"winding": "dleta"}, "did you mean 'delta'"),
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


def _value(out, name):
    """What the printed motor file says."""
    return yaml.safe_load(out[out.index("name: ") :])[name]


def test_units_say_how_a_constant_counts(capsys):
    """
    By hand: 54.5 V rms at 104.72 rad/s are 77.07 V peak between terminals, 44.50 V of a phase,
    0.42493 V s per rad of the shaft, 0.084987 V s with 5 pole pairs. 1.5 x 5 x that x sqrt(2) is
    0.90142 N m/A rms; 4 A rms are an amplitude of 5.657 A.
    """
    sheet = ["motor", "--name", "servo", "--poles", "10", "-R", "2.4 Ω", "-L", "8 mH"]
    sheet += ["-J", "0.81 kg-cm²", "--voltage", "311 V", "--speed", "2000 rpm"]
    assert cli.run([*sheet, "--ke", "54.5 Vrms/krpm", "--kt", "0.9014 N-m/Arms",
                    "--current", "4 Arms"]) == 0  # fmt: skip
    out = capsys.readouterr().out
    assert _value(out, "psi_f") == pytest.approx(0.084987, rel=1e-5)
    assert _value(out, "i_max") == 11.3137
    # the same sheet, in amplitudes; the rated current still rms
    assert cli.run([*sheet, "--ke", "77.075 Vpk/krpm", "--kt", "0.6374 N-m/Apk",
                    "--current", "4 Arms"]) == 0  # fmt: skip
    out = capsys.readouterr().out
    assert _value(out, "psi_f") == pytest.approx(0.084987, rel=1e-5)
    assert _value(out, "i_max") == 11.3137
    assert cli.run([*sheet, "--ke", "54.5 Vrms/krpm", "--ke-voltage", "ll-peak",
                    "--current", "4 A"]) == 2  # fmt: skip
    assert "the unit of --ke says 'rms', its option 'll-peak'" in capsys.readouterr().err


def test_poles_as_makers_of_outrunners_write_them(capsys):
    sheet = ["motor", "--name", "u8", "-R", "110 mΩ", "-L", "65 µH", "--kv", "KV100"]
    sheet += ["-J", "1.4 kgcm2", "--voltage", "24 V", "--current", "10 A"]
    assert cli.run([*sheet, "--poles", "36N42P"]) == 0
    out = capsys.readouterr().out
    # 1 / (100 x 0.104720 x sqrt(3) x 21)
    assert _value(out, "n_p") == 21
    assert _value(out, "psi_f") == pytest.approx(0.002625376, rel=1e-5)
    assert cli.run([*sheet, "--poles", "many"]) == 2
    assert "12N14P" in capsys.readouterr().err


def test_all_motors_there_are(capsys):
    names = yaml_files.available("motors")
    assert len(names) >= 8
    for name in names:
        assert plant_motor.load(name).name == name
    assert conversion.TOLERANCE < 0.1
