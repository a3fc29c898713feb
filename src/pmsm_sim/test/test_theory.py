"""The plant against what the textbook says in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from pmsm_sim import flux_map

_RPM = 2.0 * np.pi / 60.0
_SHIFT = np.array([0.0, 2.0, 4.0]) * np.pi / 3.0


@pytest.fixture
def bench(unprotected):
    return unprotected


@pytest.fixture(params=[False, True], ids=["ideal", "general"])
def drive_of(request, bench):
    """Makes drives of both models."""

    def make(**values):
        drive = bench(**values)
        drive.par["general"] |= request.param
        return drive

    return make


def test_locked_rotor_time_constant(drive_of):
    """A voltage step along d at standstill: i = u / R (1 - exp(-t R / L))."""
    drive = drive_of()
    drive.par["J"] = 1e12
    R, L, u_dc = (float(drive.par[n][0]) for n in ("R_s", "L_d", "u_dc"))
    d = 0.05
    # phase a against b and c
    drive.run(200, (0.5 + d, 0.5 - d, 0.5 - d))
    u = 2.0 / 3.0 * 2.0 * d * u_dc
    t = float(drive.par["T_s"][0]) * np.arange(200)
    expected = u / R * (1.0 - np.exp(-t * R / L))
    # the pulses are centred in the period, the step is not: a ripple of the second order
    assert drive.column("i_dq")[:, 0] == pytest.approx(expected, abs=2e-3)


def test_short_circuit_settles_at_the_phasor(drive_of):
    """Zero vector at constant speed: i = -w psi_f / (R + 1j w L) (1j), after L / R."""
    drive = drive_of(motor="seed_750", initial_speed_rpm=500.0)
    drive.par["J"] = 1e12
    R, L, psi = (float(drive.par[n][0]) for n in ("R_s", "L_d", "psi_f"))
    w = 4 * 500.0 * _RPM
    drive.run(1500)
    expected = -1j * w * psi / complex(R, w * L)
    i = drive.column("i_dq") @ [1.0, 1j]
    assert i[-1] == pytest.approx(expected, abs=1e-5)
    # a transient of the rotor frame: exp(-(R / L + 1j w) t)
    t = float(drive.par["T_s"][0]) * np.arange(1500)
    assert i == pytest.approx(expected * (1 - np.exp(-(R / L + 1j * w) * t)), abs=1e-7)


def test_steady_state_phasor_of_a_salient_machine(drive_of):
    """Rotating mean voltage: the mean current obeys u = R i + 1j w psi."""
    drive = drive_of(motor="ipmsm", initial_speed_rpm=400.0)
    drive.par["J"] = 1e12
    R, L_d, L_q, psi = (float(drive.par[n][0]) for n in ("R_s", "L_d", "L_q", "psi_f"))
    w, T_s = 4 * 400.0 * _RPM, float(drive.par["T_s"][0])
    u = complex(-4.0, w * psi + 3.0)

    def duty(k):
        theta = w * (k + 0.5) * T_s
        return 0.5 + (u * np.exp(1j * (theta - _SHIFT))).real / 311.0

    drive.run(4000, duty)
    i = (drive.column("i_dq")[-500:] @ [1.0, 1j]).mean()
    induced = 1j * w * complex(L_d * i.real + psi, L_q * i.imag)
    # holding the voltage over a period makes it smaller by sinc(w T_s / 2)
    assert R * i + induced == pytest.approx(u * np.sinc(w * T_s / 2 / np.pi), rel=2e-3)


def test_no_load_emf_with_harmonics(bench):
    """Gates blocked: the terminals show the EMF; here through the torque per ampere."""
    drive = bench(machine_emf_5=0.1, machine_emf_7=0.05)
    par = drive.par[0]
    from pmsm_sim.parts.machine import flux

    theta = np.linspace(0.0, 2.0 * np.pi, 361)
    psi = np.array([flux(par, 0.0, 0.0, np.cos(x), np.sin(x))[:2] for x in theta]) @ [1.0, 1j]
    psi_a = (psi * np.exp(1j * theta)).real
    psi_f = float(par["psi_f"])
    expected = psi_f * (np.cos(theta) + 0.1 / 5 * np.cos(5 * theta) + 0.05 / 7 * np.cos(7 * theta))
    assert psi_a == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize("sign", [1, -1])
def test_dead_time_costs_its_share_of_the_period(bench, sign):
    """Mean leg voltage over u_dc is d - sign(i) t_d / T_s."""
    t_d, T_s = 3e-6, 1e-4
    drive = bench(inverter_dead_time=t_d, oversampling=1000, i_dq=(4.0 * sign, 0.0))
    drive.par["J"] = 1e12
    duty = np.array([0.6, 0.45, 0.4])
    drive.run(3, duty)
    high = np.array([(drive.legs[-1] >> x & 1).mean() for x in range(3)])
    i = drive.i_abc[-1][0]
    assert high == pytest.approx(duty - np.sign(i) * t_d / T_s, abs=2 / 1000)


def test_dead_time_has_no_say_without_edges(bench):
    drive = bench(inverter_dead_time=3e-6, oversampling=200, i_dq=(4.0, 0.0))
    drive.run(5, (1.0, 0.0, 0.0))
    assert set(drive.legs[-1]) == {1}


def test_on_state_drops(bench):
    """A standing current sees the drops of the devices it flows through."""
    values = {
        "inverter_switch_voltage": 1.2,
        "inverter_diode_voltage": 0.8,
        "inverter_switch_resistance": 0.04,
        "inverter_diode_resistance": 0.02,
    }
    drive = bench(**values)
    drive.par["J"] = 1e12
    duty = np.array([0.53, 0.47, 0.47])
    drive.run(3000, duty)
    i_a = float(drive.column("i_dq")[-100:, 0].mean())
    u_dc, R = 311.0, float(drive.par["R_s"][0])
    # leg a carries i > 0: switch when high, diode when low; b and c carry -i/2
    v_a = duty[0] * (u_dc - 1.2 - 0.04 * i_a) + (1 - duty[0]) * (-0.8 - 0.02 * i_a)
    v_b = duty[1] * (u_dc + 0.8 + 0.01 * i_a) + (1 - duty[1]) * (1.2 + 0.02 * i_a)
    assert R * i_a == pytest.approx(2.0 / 3.0 * (v_a - v_b), rel=1e-3)


def test_current_is_clamped_at_zero_in_the_dead_time(bench):
    """A small current that ends within the dead time does not reverse in it."""
    drive = bench(inverter_dead_time=5e-6, oversampling=1000, i_dq=(0.02, 0.0))
    drive.par["J"] = 1e12
    drive.run(2)
    i = np.abs(drive.waveform)
    assert ((i < 1e-12).sum(axis=1) >= 1).any()


def test_iron_loss_at_no_load(bench):
    """Loss of a conductance across the EMF: 1.5 (w psi_f)^2 / R_iron."""
    drive = bench(machine_iron_loss_resistance=500.0, load_kind="speed", load_speed_rpm=750.0)
    w, psi = 4 * 750.0 * _RPM, 0.14
    drive.run(1, enable=False)
    before = drive.plant.energies()["iron"]
    drive.run(100, enable=False)
    loss = (drive.plant.energies()["iron"] - before) / 0.01
    assert loss == pytest.approx(1.5 * (w * psi) ** 2 / 500.0, rel=2e-2)
    # it brakes the shaft, and nothing flows in the supply
    assert drive.plant.energies()["load"] < 0.0
    assert abs(drive.plant.energies()["dc"]) < 1e-9


@pytest.mark.parametrize("name", ["linear", "saturated", "harmonic"])
def test_torque_from_co_energy_is_torque_from_power(bench, name):
    """tau w = electrical power - copper loss - change of the field energy, at imposed speed."""
    values = {
        "linear": {},
        "saturated": {"machine_flux_map": "ipmsm_saturated"},
        "harmonic": {"machine_emf_5": 0.1, "machine_emf_11": 0.05},
    }[name]
    drive = bench(motor="ipmsm", load_kind="speed", load_speed_rpm=300.0, **values)
    w_M = 300.0 * _RPM

    def duty(k):
        theta = 4 * w_M * k * 1e-4
        return 0.5 + 22.0 / 311.0 * np.cos(theta + 1.7 - _SHIFT)

    drive.run(1)
    before = drive.plant.energies()
    drive.run(400, duty)
    after = drive.plant.energies()
    change = {n: after[n] - before[n] for n in after}
    mechanical = change["supply"] - change["copper"] - change["field"]
    tau = drive.column("torque")[1:]
    # samples of the torque at the switching period, and the exact integral
    assert mechanical == pytest.approx(w_M * tau.mean() * 0.04, rel=0.05)
    assert mechanical == pytest.approx(change["load"], rel=1e-7)


def test_a_flux_map_of_a_linear_machine_is_that_machine(bench, tmp_path):
    i = np.linspace(-20.0, 20.0, 11)
    psi_d = 0.12 + 2e-3 * i[:, None] + 0.0 * i
    psi_q = 5e-3 * i[None, :] + 0.0 * i[:, None]
    file = flux_map.FluxMapFile(
        name="linear",
        description="",
        source="",
        i_d=i.tolist(),
        i_q=i.tolist(),
        psi_d=psi_d.tolist(),
        psi_q=psi_q.tolist(),
    )
    map_ = flux_map.fit(file)
    assert map_.psi_f == pytest.approx(0.12, abs=1e-9)
    for i_d, i_q in [(0.0, 0.0), (5.5, -7.3), (-19.0, 20.0), (40.0, -35.0)]:
        assert map_.flux(i_d, i_q) == pytest.approx((0.12 + 2e-3 * i_d, 5e-3 * i_q), abs=1e-8)
        assert map_.inductances(i_d, i_q) == pytest.approx(np.diag([2e-3, 5e-3]), abs=1e-8)


def test_rectifier_ripple_has_six_pulses(bench):
    """Under load the DC link follows the six pulses of the rectified grid: 300 Hz."""
    drive = bench(
        dc_link_kind="rectifier",
        dc_link_capacitance=2e-4,
        dc_link_grid_resistance=0.2,
        initial_speed_rpm=750.0,
        load_kind="speed",
        load_speed_rpm=750.0,
    )
    w = 4 * 750.0 * _RPM

    def duty(k):
        return 0.5 + (0.14 * w + 15.0) / 311.0 * np.cos(w * (k + 1) * 1e-4 + np.pi / 2 - _SHIFT)

    drive.run(1000, duty)
    u = drive.column("dc_voltage")[400:1000]  # 60 ms
    spectrum = np.abs(np.fft.rfft(u - u.mean()))
    frequency = np.fft.rfftfreq(len(u), 1e-4)
    assert frequency[spectrum.argmax()] == pytest.approx(300.0)
    assert np.ptp(u) > 1.0
    assert drive.feedback[-1]["dc_voltage"] == drive.state[-1]["dc_voltage"]


def test_the_chopper_limits_the_dc_voltage(bench):
    values = {
        "dc_link_kind": "rectifier",
        "dc_link_capacitance": 2e-4,
        "initial_speed_rpm": 1500.0,
        "load_kind": "speed",
        "load_speed_rpm": 1500.0,
    }
    w = 4 * 1500.0 * _RPM

    def braking(k):
        return 0.5 + 0.5 * 0.14 * w / 311.0 * np.cos(w * (k + 0.5) * 1e-4 + np.pi / 2 - _SHIFT)

    free = bench(**values).run(800, braking).column("dc_voltage")
    chopper = {
        "dc_link_chopper_resistance": 50.0,
        "dc_link_chopper_on": 335.0,
        "dc_link_chopper_off": 330.0,
    }
    held = bench(**chopper, **values).run(800, braking)
    assert free.max() > 365.0
    assert held.column("dc_voltage").max() < 336.0
    assert held.column("dc_voltage")[600:].min() > 326.0
    assert held.plant.energies()["chopper"] > 1.0
