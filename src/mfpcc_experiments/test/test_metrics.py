"""The definitions of the metrics, on synthetic signals with known answers."""

import math

import numpy as np
import pytest

from mfpcc_experiments.measuring import metrics, steadiness, waveform, window

T_S = 1e-4


def angle(n, frequency, factor=1, phase=0.3):
    """Electrical angle of a constant frequency (Hz) at n samples."""
    return phase + 2 * math.pi * frequency * T_S / factor * np.arange(n)


def test_thd_of_known_harmonics():
    theta = angle(2000, 50.0)
    x = 0.7 + 8.0 * np.cos(theta) + 0.4 * np.cos(5 * theta + 1.0) + 0.3 * np.sin(7 * theta)
    assert waveform.thd(x, theta) == pytest.approx(0.5 / 8.0, rel=1e-9)


def test_dc_is_excluded():
    theta = angle(2000, 50.0)
    assert waveform.thd(3.0 + np.cos(theta), theta) == pytest.approx(0.0, abs=1e-9)


def test_inter_harmonics_and_noise_count():
    theta = angle(4000, 50.0)
    noise = np.random.default_rng(1).normal(0.0, 0.05, 4000)
    x = 2.0 * np.cos(theta) + 0.1 * np.cos(2.5 * theta) + noise
    expected = math.sqrt(2 * (0.1**2 / 2 + 0.05**2)) / 2.0
    assert waveform.thd(x, theta) == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("frequency", [49.993, 50.007, 47.3, 33.3, 211.7])
def test_nothing_leaks_when_periods_do_not_fit_the_samples(frequency):
    theta = angle(2000, frequency)
    assert waveform.thd(8.0 * np.cos(theta - 0.4), theta) < 1e-9
    x = 8.0 * np.cos(theta) + 0.08 * np.cos(11 * theta)
    assert waveform.thd(x, theta) == pytest.approx(0.01, rel=0.02)


def test_a_drifting_speed_is_no_distortion():
    n = np.arange(2000)
    theta = 2 * math.pi * (50.0 * T_S * n + 20.0 * (T_S * n) ** 2)  # 50 -> 58 Hz within 0.2 s
    assert waveform.thd(8.0 * np.cos(theta), theta) < 1e-9


def test_turning_backwards_is_the_same():
    theta = angle(2000, 50.0)
    x = 8.0 * np.cos(theta) + 0.4 * np.cos(3 * theta)
    assert waveform.thd(x, -theta) == pytest.approx(0.05, rel=1e-6)


def test_the_window_is_cut_to_whole_periods():
    part = waveform.fundamental(np.cos(angle(2150, 50.0)), angle(2150, 50.0))
    assert (part.periods, part.samples) == (10, 2000)
    part = waveform.fundamental(np.cos(angle(2000, 49.99)), angle(2000, 49.99))
    assert part.periods == 10  # short by a fifth of a sample: ten periods, not nine


@pytest.mark.parametrize("frequency", [0.0, 1.0])
def test_no_whole_period_gives_no_thd(frequency):
    theta = angle(2000, frequency)
    assert waveform.thd(np.cos(theta), theta) is None


def test_the_spectrum_shows_what_the_thd_counts():
    rng = np.random.default_rng(2)
    theta = angle(2000, 50.0)
    x = 8.0 * np.cos(theta) + 0.4 * np.cos(5 * theta) + rng.normal(0.0, 0.1, 2000)
    part = waveform.fundamental(x, theta)
    frequency, amplitude = waveform.spectrum(part, 1 / T_S)
    assert frequency[amplitude == 1.0] == pytest.approx([50.0])
    assert amplitude[np.searchsorted(frequency, 249.0)] == pytest.approx(0.05, rel=0.1)
    content = math.sqrt(np.sum(np.square(amplitude[amplitude < 1.0])))
    assert content == pytest.approx(part.thd, rel=1e-3)


def test_quantisation_of_the_encoder_is_no_distortion():
    theta_M = angle(2000, 12.5)
    step = 2 * math.pi / 4096
    measured = np.floor((theta_M % (2 * math.pi)) / step) * step
    theta = 4 * waveform.smooth_angle(waveform.unwrap(measured), 100)
    x = 8.0 * np.cos(4 * theta_M)
    assert waveform.thd(x, theta) < 4e-4
    assert waveform.thd(x, 4 * waveform.unwrap(measured)) > 1.5e-3  # what it would have been


def test_smoothing_keeps_an_acceleration():
    t = T_S * np.arange(5000)
    theta = 50.0 * t + 0.5 * 400.0 * t**2
    assert waveform.smooth_angle(theta, 100) == pytest.approx(theta, abs=1e-9)


@pytest.mark.parametrize(("values", "samples"), [(6, 100), (99, 100), (101, 101), (3000, 100)])
def test_smoothing_is_that_of_savitzky_and_golay(values: int, samples: int) -> None:
    from scipy.signal import savgol_filter

    theta = np.random.default_rng(values).normal(size=values).cumsum()
    length = min(values, samples) // 2 * 2 - 1
    smooth = savgol_filter(theta, length, 2, mode="interp")
    assert waveform.smooth_angle(theta, samples) == pytest.approx(smooth, abs=1e-9)


def test_oversampled_angle():
    theta = np.array([0.0, 0.4, 0.8])
    fine = waveform.oversample_angle(theta, 4)
    assert fine == pytest.approx(0.1 * np.arange(12))


def test_to_dq_is_amplitude_invariant_and_drops_zero_sequence():
    theta = angle(400, 50.0)
    phases = theta[:, None] - 2 * math.pi / 3 * np.arange(3)
    i_abc = -5.0 * np.sin(phases) + 1.5 * np.cos(phases) + 0.7
    assert waveform.to_dq(i_abc, theta) == pytest.approx(np.full(400, 1.5 + 5.0j))


def test_ripple():
    theta = angle(2000, 50.0)
    x = 4.0 + 0.15 * np.sin(20 * theta)
    assert waveform.ripple_pp(x) == pytest.approx(0.3, rel=1e-2)
    assert waveform.ripple_rms(x) == pytest.approx(0.15 / math.sqrt(2), rel=1e-3)


def test_settling_and_overshoot():
    n = np.arange(200)
    x = 1.0 + 2.0 * (1.0 - np.exp(-n / 10.0))
    response = waveform.step_response(x, 1.0, 3.0)
    assert response.settling == math.ceil(10.0 * math.log(20.0))
    assert response.overshoot == 0.0
    x = 3.0 - 2.0 * np.exp(-n / 10.0) * np.cos(n / 5.0)
    assert waveform.step_response(x, 1.0, 3.0).overshoot == pytest.approx(
        -np.min(np.exp(-n / 10.0) * np.cos(n / 5.0))
    )
    downwards = waveform.step_response(-x, -1.0, -3.0)
    assert downwards == waveform.step_response(x, 1.0, 3.0)


def test_a_response_that_leaves_the_band_again_has_not_settled():
    x = np.ones(100)
    x[40] = 1.06
    assert waveform.step_response(x, 0.0, 1.0).settling == 41
    x[-1] = np.nan
    assert waveform.step_response(x, 0.0, 1.0).settling is None


def test_switching_frequency():
    duty = np.full((1000, 3), 0.5)
    assert waveform.switching_frequency(duty, T_S) == pytest.approx(10e3)
    duty[:, 2] = 1.0  # one leg clamped
    assert waveform.switching_frequency(duty, T_S) == pytest.approx(10e3 * 2 / 3)
    single = np.zeros((1000, 3))
    single[::2] = 1.0  # whole-period vectors, changing every period
    assert waveform.switching_frequency(single, T_S) == pytest.approx(5e3, rel=2e-3)


def test_window_rows():
    period = np.arange(100, 400, dtype=np.uint64)
    rows = window.window_rows(period, (0.02, 0.03), T_S)
    assert (period[rows][0], period[rows][-1], rows.stop - rows.start) == (200, 299, 100)
    assert window.window_rows(period, (0.0, 10.0), T_S) == slice(0, 300)


def test_the_mean_over_an_electrical_period_moves_with_the_state_only():
    theta = angle(2050, 50.0)
    ripple = 0.5 * np.exp(7j * theta)  # vanishes over each period
    i_dq = np.where(np.arange(2050) < 1000, 2.0, 3.0) * np.exp(0.4j) + ripple
    means = waveform.period_means(i_dq, theta)
    assert len(means) == 2050 - 200 + 1
    assert means[:800] == pytest.approx(np.full(800, 2.0 * np.exp(0.4j)))
    assert means[1000:] == pytest.approx(np.full(851, 3.0 * np.exp(0.4j)))
    assert means[900] == pytest.approx(2.5 * np.exp(0.4j))
    assert not steadiness.is_steady(i_dq, theta)
    assert steadiness.is_steady(i_dq[:1000], theta[:1000])


@pytest.mark.parametrize("begin", [60, 700, 1940])
def test_a_change_of_the_current_is_seen_wherever_it_is(begin):
    theta = angle(2000, 50.0)
    i_dq = np.full(2000, 4j)
    i_dq[begin:] *= 1.5 if begin < 1900 else 3.0
    assert not steadiness.is_steady(i_dq, theta)
    assert not steadiness.is_steady(1e-3 * i_dq, theta)  # of a small motor, too


def test_a_window_of_one_electrical_period_cannot_be_judged():
    assert not steadiness.can_be_judged(angle(299, 50.0))
    assert steadiness.can_be_judged(angle(300, 50.0))
    assert steadiness.can_be_judged(np.zeros(400))  # at standstill time has to do
    assert not steadiness.can_be_judged(np.zeros(100))


def test_blocked_gates_do_not_switch():
    duty, on = np.full((1000, 3), 0.5), np.ones(1000, bool)
    on[500:] = False
    assert waveform.switching_frequency(duty, T_S, on) == pytest.approx(5e3)
    assert waveform.switching_frequency(duty, T_S, ~on | True) == pytest.approx(10e3)
    assert waveform.switching_frequency(duty, T_S, on & False) == 0.0


def make_window(n=2000, factor=5, seed=3):
    """A window of ten electrical periods with noise; the waveform within the periods is clean."""
    theta, fine = angle(n, 50.0), angle(n * factor, 50.0, factor)
    i_dq = 4j + np.random.default_rng(seed).normal(0, 0.1, (n, 2)) @ np.array([1, 1j])

    def abc(i_dq, theta):
        phases = theta[:, None] - 2 * math.pi / 3 * np.arange(3)
        return (i_dq[:, None] * np.exp(1j * phases)).real

    time = 0.1 + T_S * np.arange(n)
    return window.Window(
        begin=0.1,
        end=0.1 + n * T_S,
        time=time,
        theta=theta,
        i_abc=abc(i_dq, theta),
        i_dq=i_dq,
        lut_time=time[::2],
        i_dq_ref=np.full(n // 2, 4j),
        error=np.stack([i_dq.real, i_dq.imag - 4], axis=1)[::2],
        fine_time=0.1 + T_S / factor * np.arange(n * factor),
        fine_theta=fine,
        fine_abc=abc(np.full(n * factor, 4j), fine),
        fine_dq=np.full(n * factor, 4j),
        state_time=time,
        torque=np.full(n, 2.5),
    )


def test_parts_of_a_window_are_whole_electrical_periods():
    w = make_window()
    found = window.parts(w)
    assert [len(part.time) for part in found] == [200] * 10
    assert [len(part.fine_time) for part in found] == [1000] * 10
    assert [len(part.error) for part in found] == [100] * 10
    assert np.array_equal(np.concatenate([part.i_dq for part in found]), w.i_dq)


def test_scatter_tells_how_sure_a_figure_is():
    found = metrics.scatter(make_window())
    assert found["parts"] == 10
    assert found["mean"]["ripple_rms.d"] == pytest.approx(0.1, rel=0.05)
    # The standard deviation of a standard deviation of 200 normal samples.
    assert found["std"]["ripple_rms.d"] == pytest.approx(0.1 / math.sqrt(400), rel=0.7)
    assert found["mean"]["thd_percent.oversampled"] == pytest.approx(0.0, abs=1e-6)
    assert found["mean"]["torque_mean"] == 2.5
    assert "lut_error_max.q" in found["mean"]


def test_a_window_of_few_periods_has_no_parts():
    w = make_window(n=600)
    assert window.parts(w) == []
    assert metrics.scatter(w) == {"parts": 0, "mean": {}, "std": {}}


def drifting(shape: str, distortion: float, change: float, seed: int = 0):
    """1 A at 50 Hz over 0.2 s: noise and a sixth harmonic of `distortion`, and a slow `change`."""
    rng = np.random.default_rng(seed)
    theta = 2.0 * np.pi * 50.0 * np.arange(2000) * 1e-4
    x = np.linspace(0.0, 1.0, 2000)
    moves = {
        "ramp": x,
        "bend": 4.0 * x * (1.0 - x),
        "swing": 0.5 * np.sin(2.0 * np.pi * 1.3 * x),
        "settling": np.exp(-4.0 * x),
        "step": (x > 0.4).astype(float),
    }[shape]
    noise = rng.normal(size=(2, 2000)) / 2.0
    content = noise[0] + 1j * noise[1] + np.sqrt(0.5) * np.exp(6j * theta)
    return 1j * (1.0 + change * moves) + distortion * content, theta


SLOW = ("ramp", "bend", "swing", "settling", "step")


@pytest.mark.parametrize("shape", SLOW)
@pytest.mark.parametrize("distortion", [0.01, 0.03, 0.18])
def test_a_drift_that_would_count_as_distortion_is_not_steady(shape, distortion):
    """What passes changes the rms content by less than 5 %, whatever its shape."""
    for share in np.geomspace(0.02, 20.0, 40):
        change = share * distortion
        i_dq, theta = drifting(shape, distortion, change)
        without, _ = drifting(shape, distortion, 0.0)
        if steadiness.is_steady(i_dq, theta):
            assert waveform.ripple_rms(i_dq) < 1.05 * waveform.ripple_rms(without), change
            passed = change
    assert passed > 0.05 * distortion  # not everything is refused
    # a tenth, which is no distortion of one percent
    assert not steadiness.is_steady(*drifting(shape, distortion, max(0.1, distortion)))


@pytest.mark.parametrize("turns", [1.6, 2.0, 3.0, 10.0, 160.0])
@pytest.mark.parametrize("distortion", [0.001, 0.01, 0.2])
def test_noise_is_no_drift(turns, distortion):
    rng = np.random.default_rng(7)
    theta = 2.0 * np.pi * turns * np.arange(2000) / 2000.0
    for _ in range(50):
        noise = rng.normal(size=(2, 2000)) / np.sqrt(2.0)
        assert steadiness.is_steady(1j + distortion * (noise[0] + 1j * noise[1]), theta)


@pytest.mark.filterwarnings("error")
def test_the_rms_of_what_no_square_can_hold():
    x = np.random.default_rng(1).normal(0.0, 3.0, 1000)
    assert waveform.rms(x) == math.sqrt(float(np.mean(x * x)))
    assert waveform.rms(np.array([1e308, -1e308])) == pytest.approx(1e308)
    assert waveform.rms(np.array([3e-300, 4e-300])) == pytest.approx(math.sqrt(12.5) * 1e-300)
    assert waveform.rms(np.zeros(3)) == 0.0
    assert math.isnan(waveform.rms(np.array([1.0, math.nan])))
    assert waveform.rms(np.array([1.0, -math.inf])) == math.inf
