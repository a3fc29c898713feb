/*
 * An example: the controller in the interrupt of a PWM timer.
 *
 * The four functions at the top are yours: they stand for the registers of your microcontroller.
 * docs/real_drive.md of the project says what an inverter must do, and in which order to try it.
 */
#include <stdio.h>

#include "mfpcc.h"

/* Currents (A), mechanical angle (rad, 0 to 2 pi) and DC-link voltage (V), sampled by the timer. */
static void read_sensors(mfpcc_sample *sample)
{
    sample->i_a = 0;
    sample->i_b = 0;
    sample->i_c = 0;
    sample->encoder_angle = 1;
    sample->dc_voltage = $u_dc;
    sample->derating = 1; /* less when the inverter is hot, 0 when it has blocked its gates */
}

/* On-times of the upper switches for the period that begins with the next interrupt, 0..1. */
static void load_timer(const mfpcc_real duty[3])
{
    (void)duty;
}

static void gates_off(void)
{
}

static bool too_late(void)
{
    return false; /* whether the next period has begun already */
}

static mfpcc_controller drive;
static mfpcc_sample sample;
static mfpcc_command command;

/* Once in each PWM period, in the middle of a zero vector. */
static void on_pwm_period(void)
{
    read_sensors(&sample);
    mfpcc_step(&drive, &sample, &command, NULL);
    sample.period += 1U;
    if (!command.enable || too_late()) {
        gates_off();
    } else {
        load_timer(command.duty);
    }
}

int main(void)
{
    mfpcc_init(&drive);
    if (mfpcc_set_parameter(&drive, MFPCC_W_M_REF, 0) != MFPCC_OK) {
        return 1;
    }
    /* A drive waits for interrupts here; the example has ten. */
    for (int n = 0; n < 10; ++n) {
        on_pwm_period();
    }
    printf("%d periods, gates %s\n", (int)sample.period, command.enable ? "on" : "off");
    return 0;
}
